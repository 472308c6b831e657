"""A TCP port: a link for every client that connects, as on ArduCopter's 5760.

What a client sends beyond its budget stays in the kernel and holds the client back; what it does not read is kept up
to a limit, and whole frames are dropped after that.
"""

import socket
from collections import Counter

from sitl.links.budget import Budget
from sitl.links.frames import Frame, split
from sitl.links.link import Link, PortError
from sitl.links.udp import NewLink

CLIENTS_MAX = 16
UNSENT_MAX = 1 << 18
"""Bytes kept for a client that does not read."""


class _Client:
    """A connection."""

    def __init__(self, connection: socket.socket, new_link: NewLink, now_ms: int) -> None:
        self.connection = connection
        self.budget = Budget(now_ms)
        self.pending = b""
        """The beginning of a frame whose end has not come."""
        self._unsent = bytearray()
        self.link = new_link(self._put, now_ms)
        self.link.heard = True

    def _put(self, raw: bytes) -> bool:
        if len(self._unsent) + len(raw) > UNSENT_MAX:
            return False
        self._unsent += raw
        return True

    def flush(self) -> bool:
        """Send what waits; False when the connection is gone."""
        if not self._unsent:
            return True
        try:
            sent = self.connection.send(self._unsent)
        except BlockingIOError:
            return True
        except OSError:
            return False
        del self._unsent[:sent]
        return True

    def read(self, now_ms: int) -> bytes | None:
        """What has come, within the budget; None when the connection is gone."""
        allowed = self.budget.left(now_ms)
        if allowed <= 0:
            self.link.counters["over budget"] += 1
            return b""
        try:
            data = self.connection.recv(allowed)
        except BlockingIOError:
            return b""
        except OSError:
            return None
        if not data:
            return None
        self.budget.take(len(data), now_ms)
        return data


class TcpPort:
    """Listens on loopback."""

    def __init__(self, name: str, port: int, new_link: NewLink) -> None:
        """Raises PortError when the port is taken."""
        self.name = name
        self.counters: Counter[str] = Counter()
        self._new_link = new_link
        self._clients: list[_Client] = []
        self.links: list[Link] = []
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._listener.bind(("127.0.0.1", port))
        except (OSError, OverflowError) as error:
            self._listener.close()
            raise PortError(f"{name} link: TCP port 127.0.0.1:{port} cannot be bound ({error})") from error
        self._listener.listen(CLIENTS_MAX)
        self._listener.setblocking(False)

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._listener.getsockname()[1])

    def describe(self) -> str:
        """As printed at start."""
        return f"{self.name} 127.0.0.1:{self.port}"

    def receive(self, now_ms: int) -> list[tuple[Link, Frame]]:
        """The good frames that have come."""
        self._accept(now_ms)
        received: list[tuple[Link, Frame]] = []
        for client in tuple(self._clients):
            data = client.read(now_ms)
            if data is None:
                self._drop(client)
            elif data:
                frames, client.pending = split(client.pending + data, client.link.counters)
                client.link.counters["received"] += len(frames)
                received.extend((client.link, frame) for frame in frames)
        return received

    def _accept(self, now_ms: int) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            if len(self._clients) >= CLIENTS_MAX:
                self.counters["turned away"] += 1
                connection.close()
                continue
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            client = _Client(connection, self._new_link, now_ms)
            self._clients.append(client)
            self.links.append(client.link)

    def _drop(self, client: _Client) -> None:
        client.connection.close()
        self._clients.remove(client)
        self.links.remove(client.link)

    def lost(self) -> dict[Link | None, int]:
        """Nothing: TCP holds the sender back."""
        return {}

    def flush(self) -> None:
        """Send what waits; clients that are gone are dropped."""
        for client in tuple(self._clients):
            if not client.flush():
                self._drop(client)

    def close(self) -> None:
        for client in self._clients:
            client.connection.close()
        self._listener.close()
