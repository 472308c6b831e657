"""A UDP port: the configured peer and everybody else who speaks on it, each with a link of its own.

Who is known has a socket of its own, connected to that address alone: Linux hands a datagram to the connected socket
that fits it, so that a stranger who floods the port fills the strangers' receive buffer and nobody else's.
"""

import socket
import struct
from collections import Counter
from collections.abc import Callable

from sitl.links.budget import PACKET_OVERHEAD, Budget
from sitl.links.frames import Frame, split_datagram
from sitl.links.link import Link, PortError

Address = tuple[str, int]
NewLink = Callable[[Callable[[bytes], bool], int], Link]
"""Makes a link of what sends its frames and the time in milliseconds."""

RECEIVE_BUFFER = 4 << 20
"""Bytes; a paused lockstep vehicle must not lose what its clients send meanwhile."""
SILENT_MS = 10_000
"""A peer that was not configured and is silent for so long is forgotten."""
PEERS_MAX = 16
PORT_MAX = 65535
READS_MAX = 4096
"""Datagrams taken from one socket in one go; what is left waits, and is dropped by the kernel when it gets too much."""


SO_MEMINFO = 55
"""Linux: nine counters of a socket, the last one how many datagrams it dropped."""


def _dropped(one: socket.socket) -> int:
    try:
        return int(struct.unpack("=9I", one.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 36))[8])
    except (OSError, struct.error):
        return 0


class _Peer:
    """Somebody on the other side."""

    def __init__(self, address: Address, link: Link, inbox: socket.socket | None, now_ms: int) -> None:
        self.address = address
        self.link = link
        self.inbox = inbox
        self.budget = Budget(now_ms)
        self.heard_ms = now_ms


class UdpPort:
    """Sends one frame per datagram."""

    def __init__(
        self, name: str, bind_port: int, peer_port: int, new_link: NewLink, silent_ms: int = SILENT_MS
    ) -> None:
        """Raises PortError when the port is taken, or the peer's is none."""
        if peer_port > PORT_MAX:
            raise PortError(f"{name} link: UDP port 127.0.0.1:{peer_port} cannot be sent to, {PORT_MAX} is the last")
        self.name = name
        self.counters: Counter[str] = Counter()
        """What came from addresses that are no peers."""
        self._new_link = new_link
        self._silent_ms = silent_ms
        self._strangers = Budget(0)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self._socket.setblocking(False)
        try:
            self._socket.bind(("127.0.0.1", bind_port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise PortError(f"{name} link: UDP port 127.0.0.1:{bind_port} cannot be bound ({error})") from error
        self._peers: dict[Address, _Peer] = {}
        self.links: list[Link] = []
        self._configured = self._open(("127.0.0.1", peer_port), 0)

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self._socket.getsockname()[1])

    @property
    def peer(self) -> Address:
        """Who is configured."""
        return self._configured.address

    @property
    def configured(self) -> Link:
        """The link to the configured peer."""
        return self._configured.link

    def describe(self) -> str:
        """As printed at start."""
        return f"{self.name} 127.0.0.1:{self.port} -> 127.0.0.1:{self.peer[1]}"

    def _open(self, address: Address, now_ms: int) -> _Peer:
        def put(raw: bytes) -> bool:
            try:
                self._socket.sendto(raw, address)
            except OSError:
                return False
            return True

        peer = self._peers[address] = _Peer(address, self._new_link(put, now_ms), self._inbox(address), now_ms)
        self.links.append(peer.link)
        return peer

    def _inbox(self, address: Address) -> socket.socket | None:
        """A socket on our port that gets only what comes from one address; None where the system does not do that.

        SO_REUSEADDR is set for this moment only: at all other times a second process is told that the port is taken.
        """
        inbox = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        inbox.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        inbox.setblocking(False)
        both = (self._socket, inbox)
        try:
            for one in both:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            inbox.bind(self._socket.getsockname())
            inbox.connect(address)
        except OSError:
            inbox.close()
            return None
        finally:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        inbox.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        return inbox

    def receive(self, now_ms: int) -> list[tuple[Link, Frame]]:
        """The good frames that wait, in the order of their coming from each peer; who sends one becomes a peer."""
        received: list[tuple[Link, Frame]] = []
        known = list(self._peers.values())
        self._read(self._socket, now_ms, received)
        for peer in known:
            if peer.inbox is not None:
                self._read(peer.inbox, now_ms, received)
        for peer in known:
            if now_ms - peer.heard_ms > self._silent_ms:
                self._forget(peer)
        return received

    def _read(self, source: socket.socket, now_ms: int, received: list[tuple[Link, Frame]]) -> None:
        for _ in range(READS_MAX):
            try:
                datagram, address = source.recvfrom(65535)
            except BlockingIOError:
                return
            except OSError:  # a port unreachable message of an earlier send
                continue
            peer = self._peers.get(address)
            counters = self.counters if peer is None else peer.link.counters
            budget = self._strangers if peer is None else peer.budget
            if (peer is None and len(self._peers) >= PEERS_MAX) or not budget.take(
                len(datagram) + PACKET_OVERHEAD, now_ms
            ):
                counters["over budget"] += 1
                continue
            frames = split_datagram(datagram, counters)
            if not frames:
                continue
            if peer is None:
                peer = self._open(address, now_ms)
            peer.heard_ms = now_ms
            peer.link.heard = True
            peer.link.counters["received"] += len(frames)
            received.extend((peer.link, frame) for frame in frames)

    def _forget(self, peer: _Peer) -> None:
        """A silent peer is gone; the configured one is only not heard any more."""
        if peer is self._configured:
            peer.link.heard = False
            return
        if peer.inbox is not None:
            peer.inbox.close()
        del self._peers[peer.address]
        self.links.remove(peer.link)

    def lost(self) -> dict[Link | None, int]:
        """Datagrams the kernel had no room for, of each peer and (None) of strangers; empty where it does not tell."""
        sockets: dict[Link | None, socket.socket] = {None: self._socket}
        sockets.update({peer.link: peer.inbox for peer in self._peers.values() if peer.inbox is not None})
        return {link: lost for link, one in sockets.items() if (lost := _dropped(one))}

    def flush(self) -> None:
        """Every frame was a datagram, and has gone."""

    def close(self) -> None:
        for peer in self._peers.values():
            if peer.inbox is not None:
                peer.inbox.close()
        self._socket.close()
