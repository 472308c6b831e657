"""One UDP link: a bound socket, one peer, the streams that run on it."""

import socket
from collections import Counter

from sitl.frames import Message, Payload, frame, unpack

Address = tuple[str, int]

RECEIVE_BUFFER = 4 << 20
"""Bytes; a paused lockstep vehicle must not lose what its clients send meanwhile."""
PEER_SILENT_MS = 10_000
"""A learned peer that is silent for so long is forgotten for the configured one."""


class PortError(OSError):
    """A port could not be bound; the text says which."""


class Stream:
    """A message sent at a steady rate."""

    def __init__(self, interval_ms: float, now_ms: int) -> None:
        self.interval_ms = interval_ms
        self.due_ms = now_ms + interval_ms

    def take_due(self, now_ms: int) -> bool:
        """Whether the message is due now; if so the next one is scheduled, on the same grid."""
        if now_ms < self.due_ms:
            return False
        self.due_ms += self.interval_ms
        if self.due_ms <= now_ms:
            self.due_ms = now_ms + self.interval_ms
        return True


class Link:
    """Sends one frame per datagram to a configured peer, or to whoever spoke last on this link."""

    def __init__(
        self,
        name: str,
        bind_port: int,
        peer_port: int,
        rates_hz: dict[str, float],
        system: int,
        talks_first: bool = True,
    ) -> None:
        """A link that does not talk first sends only heartbeats until somebody speaks on it.

        Raises PortError when the port is taken.
        """
        self.name = name
        self._talks_first = talks_first
        self.default_rates_hz = rates_hz
        self.streams: dict[str, Stream] = {}
        self.reset_streams(0)
        self.counters: Counter[str] = Counter()
        self.sent = 0
        self.parameters_pending: int | None = None
        """Index of the next parameter of a list under way."""
        self.system = system
        self._configured: Address = ("127.0.0.1", peer_port)
        self.peer = self._configured
        self._heard_ms = 0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        self.socket.setblocking(False)
        try:
            self.socket.bind(("127.0.0.1", bind_port))
        except (OSError, OverflowError) as error:
            self.socket.close()
            raise PortError(f"{name} link: UDP port 127.0.0.1:{bind_port} cannot be bound ({error})") from error

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self.socket.getsockname()[1])

    @property
    def heard(self) -> bool:
        """Whether somebody speaks on this link."""
        return self._heard_ms > 0

    @property
    def streaming(self) -> bool:
        """Whether telemetry other than heartbeats is sent."""
        return self._talks_first or self.heard

    def reset_streams(self, now_ms: int) -> None:
        """All streams back to their usual rates."""
        self.streams = {name: Stream(1000.0 / rate, now_ms) for name, rate in self.default_rates_hz.items()}

    def set_interval(self, name: str, interval_us: float, now_ms: int) -> None:
        """SET_MESSAGE_INTERVAL: -1 stops, 0 restores the usual rate, else microseconds (10 ms to half an hour)."""
        if interval_us < 0:
            self.streams.pop(name, None)
            return
        if interval_us == 0:
            usual = self.default_rates_hz.get(name)
            if usual is None:
                self.streams.pop(name, None)
                return
            interval_us = 1e6 / usual
        self.streams[name] = Stream(min(max(interval_us / 1000.0, 10.0), 1.8e6), now_ms)

    def interval_us(self, name: str) -> int:
        """MESSAGE_INTERVAL.interval_us: -1 when not sent."""
        stream = self.streams.get(name)
        return -1 if stream is None else round(stream.interval_ms * 1000.0)

    def send(self, payload: Payload) -> None:
        """Frame and send to the peer; nobody listening is no error."""
        self._put(frame(payload, self.sent & 0xFF, self.system, 1))

    def forward(self, raw: bytes) -> None:
        """Pass a frame of somebody else on."""
        self._put(raw)

    def _put(self, raw: bytes) -> None:
        try:
            self.socket.sendto(raw, self.peer)
        except OSError:
            self.counters["send failed"] += 1
            return
        self.sent += 1

    def receive(self, now_ms: int) -> list[tuple[Message, bytes]]:
        """Everything that waits, oldest first; learns the peer from good frames."""
        messages: list[tuple[Message, bytes]] = []
        while True:
            try:
                datagram, address = self.socket.recvfrom(65535)
            except BlockingIOError:
                break
            except OSError:  # a port unreachable message of an earlier send
                continue
            good = unpack(datagram, self.counters)
            if good:
                self.peer = address
                self._heard_ms = max(now_ms, 1)
                messages.extend(good)
        if self.heard and now_ms - self._heard_ms > PEER_SILENT_MS:
            self.peer = self._configured
            self._heard_ms = 0
        self.counters["received"] += len(messages)
        return messages

    def close(self) -> None:
        self.socket.close()
