"""The ways to an autopilot: one object per URL scheme that sends frames and hands over what has come.

Datagrams come whole. A stream (TCP, serial) is cut into frames here, and is opened again when it breaks, so that the
link above it is one that falls silent and comes back, as it is with UDP.
"""

import select
import socket
import time
from collections.abc import Iterator
from functools import cache
from typing import Any, Protocol

from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.bell import Bell
from autopilot_bridge.url import Address, Serial, Tcp, Udp

RECEIVE_BUFFER = 4 * 1024 * 1024
"""[bytes] A lockstep step's telemetry waits here whole."""
CHUNK = 65536
MOST_AT_ONCE = 500
"""Datagrams of one `receive`: who floods us must not keep us from flying."""
CONNECT_WALL_S = 5.0
"""How long a TCP server may take to be there."""
REOPEN_WALL_S = 1.0
UNSENT_BYTES = 4096
"""A stream that is this far behind loses frames, whole ones."""

Sender = tuple[str, int] | None
"""Who sent a datagram; None on a stream."""


class WireError(RuntimeError):
    """The wire cannot be opened; the text says why."""


class Wire(Protocol):
    """One way to an autopilot."""

    port: int
    """Our UDP or TCP port; 0 on a serial line."""
    skipped: int
    """Runs of bytes on a stream that were no frame."""

    def receive(self, timeout_s: float) -> list[tuple[bytes, Sender]]:
        """What has come, a frame or a datagram each; waits up to `timeout_s` for the first or the bell."""

    def answer(self, sender: Sender) -> None:
        """Send to this sender from now on, where that is a choice."""

    def send(self, frame: bytes) -> bool:
        """Send a frame; False when there is nobody to send to. Raises OSError when it cannot be sent."""

    def close(self) -> None:
        """Release it."""


def open_wire(address: Address, bell: Bell | None = None) -> Wire:
    """Open it; `bell` ends a `receive` that waits. Raises WireError."""
    match address:
        case Udp():
            return UdpWire(address, bell)
        case Tcp():
            return StreamWire(TcpStream(address.host, address.port, bell))
        case Serial():
            return StreamWire(SerialStream(address.device, address.baud, bell))


class Readable(Protocol):
    """What `select` takes."""

    def fileno(self) -> int:
        """Its file descriptor."""


def _ready(source: Readable, bell: Bell | None, timeout_s: float) -> bool:
    """Wait for `source` or for the bell; whether there is something to read."""
    readable, _, _ = select.select([source] if bell is None else [source, bell], [], [], max(timeout_s, 0.0))
    if bell is not None and bell in readable:
        bell.silence()
    return source in readable


class UdpWire:
    """One UDP socket."""

    skipped = 0

    def __init__(self, address: Udp, bell: Bell | None) -> None:
        self._bell = bell
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        listens = address.scheme == "udpin"
        self._peer: Sender = None
        try:
            if listens:
                self._socket.bind((address.host, address.port))
            else:
                self._peer = (socket.gethostbyname(address.host), address.port)
                self._socket.bind(("", 0))
        except OSError as error:
            self._socket.close()
            raise WireError(f"cannot {'listen' if listens else 'send'} there: {error.strerror or error}") from error
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]

    def receive(self, timeout_s: float) -> list[tuple[bytes, Sender]]:
        came: list[tuple[bytes, Sender]] = []
        if not _ready(self._socket, self._bell, timeout_s):
            return came
        while len(came) < MOST_AT_ONCE:
            try:
                came.append(self._socket.recvfrom(CHUNK))
            except ConnectionRefusedError:  # nobody listens there yet, says the answer to what we sent
                continue
            except BlockingIOError:
                break
        return came

    def answer(self, sender: Sender) -> None:
        self._peer = sender

    def send(self, frame: bytes) -> bool:
        if self._peer is None:
            return False
        self._socket.sendto(frame, self._peer)
        return True

    def close(self) -> None:
        self._socket.close()


class Stream(Protocol):
    """Bytes in order, without boundaries."""

    def open(self) -> int:
        """Open it; our port. Raises OSError."""

    def read(self, timeout_s: float) -> bytes:
        """What has come; nothing after `timeout_s`. Raises OSError when the stream has ended."""

    def write(self, data: bytes) -> int:
        """How many bytes of it were taken, without waiting. Raises OSError."""

    def close(self) -> None:
        """Release it."""


class StreamWire:
    """Frames on a stream."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._unread = b""
        self._unsent = b""
        self._open = True
        self._closed_at = 0.0
        self.skipped = 0
        try:
            self.port = stream.open()
        except OSError as error:
            raise WireError(f"cannot be opened: {error.strerror or error}") from error

    def receive(self, timeout_s: float) -> list[tuple[bytes, Sender]]:
        if not self._open and not self._reopened():
            time.sleep(timeout_s)
            return []
        try:
            self._flush()
            data = self._stream.read(timeout_s)
        except OSError:
            self._broken()
            return []
        found, self._unread, skipped = split(self._unread + data)
        self.skipped += skipped
        return [(frame, None) for frame in found]

    def answer(self, sender: Sender) -> None:
        """There is one at the other end."""

    def send(self, frame: bytes) -> bool:
        if not self._open:
            return False
        if len(self._unsent) + len(frame) > UNSENT_BYTES:
            raise BlockingIOError("the stream is full")
        self._unsent += frame
        try:
            self._flush()
        except OSError:
            self._broken()
            raise
        return True

    def close(self) -> None:
        self._stream.close()

    def _flush(self) -> None:
        if self._unsent:
            self._unsent = self._unsent[self._stream.write(self._unsent) :]

    def _broken(self) -> None:
        self._stream.close()
        self._open, self._closed_at = False, time.monotonic()
        self._unread = self._unsent = b""

    def _reopened(self) -> bool:
        if time.monotonic() - self._closed_at < REOPEN_WALL_S:
            return False
        try:
            self.port = self._stream.open()
        except OSError:
            self._closed_at = time.monotonic()
            return False
        self._open = True
        return True


class TcpStream:
    """A TCP connection of ours to a server."""

    def __init__(self, host: str, port: int, bell: Bell | None) -> None:
        self._address, self._bell = (host, port), bell
        self._patience_s = CONNECT_WALL_S
        self._socket: socket.socket

    def open(self) -> int:
        deadline = time.monotonic() + self._patience_s
        while True:
            try:
                self._socket = socket.create_connection(self._address, timeout=max(self._patience_s, 0.2))
                break
            except ConnectionRefusedError:  # an autopilot that was started with us may take a moment
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.05)
        self._patience_s = 0.0  # in flight there is no time to wait
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)
        return int(self._socket.getsockname()[1])

    def read(self, timeout_s: float) -> bytes:
        if not _ready(self._socket, self._bell, timeout_s):
            return b""
        try:
            data = self._socket.recv(CHUNK)
        except BlockingIOError:  # select may be wrong
            return b""
        if not data:
            raise ConnectionResetError("closed by the other end")
        return data

    def write(self, data: bytes) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        self._socket.close()


class SerialStream:
    """A serial line."""

    def __init__(self, device: str, baud: int, bell: Bell | None) -> None:
        self._device, self._baud, self._bell = device, baud, bell
        self._line: Any

    def open(self) -> int:
        import serial  # who flies over a network needs none of it

        try:
            self._line = serial.Serial(self._device, self._baud, timeout=0, write_timeout=0, exclusive=True)
        except ValueError as error:
            raise OSError(str(error)) from error
        return 0

    def read(self, timeout_s: float) -> bytes:
        return bytes(self._line.read(CHUNK)) if _ready(self._line, self._bell, timeout_s) else b""

    def write(self, data: bytes) -> int:
        return int(self._line.write(data) or 0)

    def close(self) -> None:
        self._line.close()


def split(data: bytes) -> tuple[list[bytes], bytes, int]:
    """Frames in a stream, the unfinished rest, and how many runs of bytes were no frame.

    A start whose checksum does not hold is none: the search goes on one byte further, so that noise costs no frame
    behind it. A message that neither PX4's nor ArduPilot's dialect has cannot be checked, so it is none either.
    """
    found: list[bytes] = []
    skipped, start, noise = 0, 0, False
    while start < len(data):
        size = _frame_size(data, start)
        if size is None:
            break
        if size and start + size > len(data):
            break
        if size and _intact(data[start : start + size]):
            found.append(data[start : start + size])
            start, noise = start + size, False
        else:
            skipped += not noise
            start, noise = start + 1, True
    return found, data[start:], skipped


def _frame_size(data: bytes, start: int) -> int | None:
    """Of the frame that begins there; 0 when none does; None when too little is there to tell."""
    if data[start] == mavlink.PROTOCOL_MARKER_V1:
        return None if start + 2 > len(data) else 8 + data[start + 1]
    if data[start] != mavlink.PROTOCOL_MARKER_V2:
        return 0
    if start + 3 > len(data):
        return None
    flags = data[start + 2]
    if flags & ~mavlink.MAVLINK_IFLAG_SIGNED:
        return 0
    return 12 + data[start + 1] + (13 if flags & mavlink.MAVLINK_IFLAG_SIGNED else 0)


def _intact(frame: bytes) -> bool:
    """Whether the checksum is known and holds."""
    if frame[0] == mavlink.PROTOCOL_MARKER_V2:
        end, number = 10 + frame[1], int.from_bytes(frame[7:10], "little")
    else:
        end, number = 6 + frame[1], frame[5]
    extra = _checksum_extras().get(number)
    if extra is None:
        return False
    checksum = mavlink.x25crc(frame[1:end])
    checksum.accumulate(bytes([extra]))
    return bool(checksum.crc == int.from_bytes(frame[end : end + 2], "little"))


@cache
def _checksum_extras() -> dict[int, int]:
    """Message id -> CRC_EXTRA, of ArduPilot's dialect, which holds the common one."""
    from pymavlink.dialects.v20 import ardupilotmega

    return {number: message.crc_extra for number, message in ardupilotmega.mavlink_map.items()}


def header(frame: bytes) -> tuple[int, int, int]:
    """System, component and message id of a whole frame."""
    if frame[0] == mavlink.PROTOCOL_MARKER_V2:
        return frame[5], frame[6], int.from_bytes(frame[7:10], "little")
    return frame[3], frame[4], frame[5]


def frames(data: bytes) -> Iterator[bytes]:
    """The MAVLink 1 and 2 frames of a datagram; what follows an incomplete or unknown start is left."""
    start = 0
    while start + 8 <= len(data):
        if data[start] == 0xFD and start + 12 <= len(data):
            size = 12 + data[start + 1] + (13 if data[start + 2] & mavlink.MAVLINK_IFLAG_SIGNED else 0)
        elif data[start] == 0xFE:
            size = 8 + data[start + 1]
        else:
            return
        if start + size > len(data):
            return
        yield data[start : start + size]
        start += size
