"""The flight log: a `.tlog`, per frame 8 bytes of big-endian microseconds since 1970, then the frame."""

import contextlib
import os
import struct
from pathlib import Path


class FlightLog:
    """Whole records only, whatever the disk does. Raises OSError when the file cannot be made."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        self._size = 0
        """Of what is whole [bytes]."""
        self._due: list[bytes] = []

    def add(self, stamp_us: int, frame: bytes) -> None:
        """For the next `write`."""
        self._due.append(struct.pack(">Q", stamp_us) + frame)

    def write(self) -> int:
        """Hand all that is due to the kernel, where it outlives us; how many records could not be, and are lost."""
        if not self._due:
            return 0
        data, count = b"".join(self._due), len(self._due)
        self._due.clear()
        try:
            written = self._file.write(data)
        except OSError:
            written = 0
        if written == len(data):
            self._size += written
            return 0
        with contextlib.suppress(OSError):  # a torn record would hide all that follow when there is room again
            os.ftruncate(self._file.fileno(), self._size)
            self._file.seek(self._size)
        return count

    def close(self) -> None:
        self._file.close()
