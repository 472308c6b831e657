"""What wakes the thread that flies while it waits for its autopilot: an action must not wait for the next telemetry."""

import contextlib
import socket


class Bell:
    """A pair of sockets, so that one `select` waits for the autopilot and for the bus alike."""

    def __init__(self) -> None:
        self._heard, self._rope = socket.socketpair()
        self._heard.setblocking(False)
        self._rope.setblocking(False)

    def fileno(self) -> int:
        """Readable once it has rung."""
        return self._heard.fileno()

    def ring(self) -> None:
        """From any thread; to ring twice is to ring once."""
        with contextlib.suppress(OSError):  # full: it rings already; closed: nobody waits any more
            self._rope.send(b"\0")

    def silence(self) -> None:
        """It has been heard."""
        with contextlib.suppress(BlockingIOError):
            while self._heard.recv(4096):
                pass

    def close(self) -> None:
        """Waits on it must have ended."""
        self._heard.close()
        self._rope.close()
