"""The control socket: a TCP line protocol by which one client owns the vehicle's clock (docs/architecture.md)."""

import socket

from sitl.link import PortError

LINE_MAX = 4096
ADVANCE_MAX_MS = 60_000


class ControlSocket:
    """Listens on loopback for one client at a time; others are told so and closed."""

    def __init__(self, port: int) -> None:
        """Raises PortError when the port is taken."""
        self.listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self.listener.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            self.listener.close()
            raise PortError(f"control socket: TCP port 127.0.0.1:{port} cannot be bound ({error})") from error
        self.listener.listen(4)
        self.listener.setblocking(False)  # who knocked may have gone before we open
        self.client: socket.socket | None = None
        self._pending = b""

    @property
    def port(self) -> int:
        return int(self.listener.getsockname()[1])

    @property
    def connected(self) -> bool:
        """Whether there is a client."""
        return self.client is not None

    def accept(self) -> socket.socket | None:
        """Take a client that knocks, or turn it away; the client if taken. One that is gone already is no client."""
        try:
            client, _ = self.listener.accept()
        except OSError:
            return None
        try:
            if self.client is not None:
                client.sendall(b"error another control client is connected\n")
                client.close()
                return None
            client.setblocking(True)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError:
            client.close()
            return None
        self.client = client
        self._pending = b""
        return client

    def lines(self) -> list[str]:
        """Requests that have come; a client that left is dropped."""
        if self.client is None:
            return []
        try:
            data = self.client.recv(LINE_MAX)
        except OSError:
            data = b""
        if not data or len(self._pending) > LINE_MAX:
            self.drop()
            return []
        *complete, self._pending = (self._pending + data).split(b"\n")
        return [line.decode("utf-8", "replace").strip() for line in complete]

    def answer(self, line: str) -> None:
        """Send one answer; a client that is gone is dropped."""
        if self.client is None:
            return
        try:
            self.client.sendall(line.encode() + b"\n")
        except OSError:
            self.drop()

    def drop(self) -> None:
        """Forget the client."""
        if self.client is not None:
            self.client.close()
            self.client = None

    def close(self) -> None:
        self.drop()
        self.listener.close()


def read_advance(argument: str) -> int:
    """Milliseconds of an `advance` request. Raises ValueError with the reason."""
    if not (argument.isascii() and argument.isdigit()) or not 1 <= int(argument[:9]) <= ADVANCE_MAX_MS:
        raise ValueError(f"advance: {argument!r} is not a whole number of milliseconds in 1 to {ADVANCE_MAX_MS}")
    return int(argument)
