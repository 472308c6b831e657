"""The control socket: a TCP line protocol, by which one client owns the clock (docs/architecture.md)."""

import selectors
import socket

from sitl.links.link import PortError

LINE_MAX = 4096
ADVANCE_MAX_MS = 60_000
CLIENTS_MAX = 16


class ControlClient:
    """A connection that asks line by line."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.gone = False
        self._pending = b""

    def lines(self) -> list[str]:
        """Requests that have come."""
        try:
            data = self.connection.recv(LINE_MAX)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data or len(self._pending) > LINE_MAX:
            self.gone = True
            return []
        *complete, self._pending = (self._pending + data).split(b"\n")
        return [line.decode("utf-8", "replace").strip() for line in complete]

    def answer(self, line: str) -> None:
        """Send one answer; who does not read its answers must not hold up the vehicle, and is dropped."""
        raw = line.encode() + b"\n"
        try:
            self.gone |= self.connection.send(raw) != len(raw)
        except OSError:
            self.gone = True


class ControlSocket:
    """Listens on loopback. The first client that says `hello` or `advance` owns the clock until it leaves."""

    def __init__(self, port: int) -> None:
        """Raises PortError when the port is taken."""
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            self._listener.close()
            raise PortError(f"control socket: TCP port 127.0.0.1:{port} cannot be bound ({error})") from error
        self._listener.listen(4)
        self._listener.setblocking(False)  # who knocked may have gone before we open
        self._clients: list[ControlClient] = []
        self.owner: ControlClient | None = None
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)

    @property
    def port(self) -> int:
        return int(self._listener.getsockname()[1])

    def describe(self) -> str:
        """As printed at start."""
        return f"control 127.0.0.1:{self.port}"

    def requests(self, timeout_s: float) -> list[tuple[ControlClient, str]]:
        """Requests that came, waiting at most so long for one; clients that left are dropped."""
        requests: list[tuple[ControlClient, str]] = []
        for key, _ in self._selector.select(timeout_s):
            client = key.data
            if client is None:
                self._accept()
                continue
            requests.extend((client, line) for line in client.lines())
            self.drop_gone()
        return requests

    def _accept(self) -> None:
        """Take a client that knocks. One that is gone already is no client."""
        try:
            connection, _ = self._listener.accept()
        except OSError:
            return
        try:
            connection.setblocking(False)
            if len(self._clients) >= CLIENTS_MAX:
                connection.send(b"error too many control clients are connected\n")
                connection.close()
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError:
            connection.close()
            return
        client = ControlClient(connection)
        self._clients.append(client)
        self._selector.register(connection, selectors.EVENT_READ, client)

    def owns(self, client: ControlClient) -> bool:
        """Whether the clock is this client's; a clock that is nobody's becomes so."""
        if self.owner is None and not client.gone:
            self.owner = client
        return self.owner is client

    def drop_gone(self) -> None:
        """Forget who has left."""
        for client in [client for client in self._clients if client.gone]:
            self._selector.unregister(client.connection)
            client.connection.close()
            self._clients.remove(client)
            if client is self.owner:
                self.owner = None

    def close(self) -> None:
        for client in self._clients:
            client.connection.close()
        self._selector.close()
        self._listener.close()


def read_advance(argument: str) -> int:
    """Milliseconds of an `advance` request. Raises ValueError with the reason."""
    if not (argument.isascii() and argument.isdigit()) or not 1 <= int(argument[:9]) <= ADVANCE_MAX_MS:
        raise ValueError(f"advance: {argument!r} is not a whole number of milliseconds in 1 to {ADVANCE_MAX_MS}")
    return int(argument)
