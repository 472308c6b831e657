"""A link: one channel to one client, with its own streams, rates, sequence numbers and counters."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from heapq import heapify, heappop, heappush

from sitl.links.frames import SIGNED, Payload, frame
from sitl.links.signing import Signing

INTERVAL_MIN_MS, INTERVAL_MAX_MS = 10.0, 1.8e6
QUEUE_MAX = 256
"""Streams that were replaced stay in the queue until they would have been due, so many at the most."""
AUTOPILOT = 1
"""MAV_COMP_ID_AUTOPILOT1."""


class PortError(OSError):
    """A port could not be bound; the text says which."""


class Stream:
    """A message sent at a steady rate."""

    __slots__ = ("due_ms", "interval_ms")

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
    """What the services answer on. `put` hands a frame to the socket and says whether it took it."""

    def __init__(
        self,
        name: str,
        rates_hz: Mapping[str, float],
        system: int,
        signing: Signing,
        put: Callable[[bytes], bool],
        *,
        talks_first: bool = True,
        now_ms: int = 0,
    ) -> None:
        """A link that does not talk first sends only heartbeats until somebody speaks on it."""
        self.name = name
        self.system = system
        self.signing = signing
        self.number = signing.new_link_id()
        """The link id of its signatures."""
        self.heard = False
        """Whether somebody speaks on this link."""
        self.counters: Counter[str] = Counter()
        self.sent = 0
        """Frames handed to the socket."""
        self.default_rates_hz = rates_hz
        self.streams: dict[str, Stream] = {}
        self.parameters_pending: int | None = None
        """Index of the next parameter of a list under way."""
        self._put = put
        self._talks_first = talks_first
        self._sequence = 0
        self._queue: list[tuple[float, int, str, Stream]] = []
        """Streams by when they were due, then by age; one that is not in `streams` any more is passed over."""
        self._entered = 0
        self.reset_streams(now_ms)

    @property
    def streaming(self) -> bool:
        """Whether telemetry other than heartbeats is sent, STATUSTEXT included (a stream like the others on PX4)."""
        return self._talks_first or self.heard

    def reset_streams(self, now_ms: int) -> None:
        """All streams back to their usual rates."""
        self.streams.clear()
        self._queue.clear()
        for name, rate in self.default_rates_hz.items():
            self._schedule(name, Stream(1000.0 / rate, now_ms))

    def _schedule(self, name: str, stream: Stream) -> None:
        self.streams[name] = stream
        if len(self._queue) > QUEUE_MAX + 2 * len(self.streams):  # a client that sets one interval without end
            self._queue = [entry for entry in self._queue if self.streams.get(entry[2]) is entry[3]]
            heapify(self._queue)
        self._entered += 1
        heappush(self._queue, (stream.due_ms, self._entered, name, stream))

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
        self._schedule(name, Stream(min(max(interval_us / 1000.0, INTERVAL_MIN_MS), INTERVAL_MAX_MS), now_ms))

    def interval_us(self, name: str) -> int:
        """MESSAGE_INTERVAL.interval_us: -1 when not sent."""
        stream = self.streams.get(name)
        return -1 if stream is None else round(stream.interval_ms * 1000.0)

    def due(self, now_ms: int) -> Iterator[str]:
        """The messages to stream now, by name."""
        if not self.streaming:
            beat = self.streams.get("HEARTBEAT")
            if beat is not None and beat.take_due(now_ms):
                yield "HEARTBEAT"
            return
        queue = self._queue
        while queue and queue[0][0] <= now_ms:
            _, age, name, stream = heappop(queue)
            if self.streams.get(name) is not stream:
                continue
            if stream.take_due(now_ms):
                yield name
            heappush(queue, (stream.due_ms, age, name, stream))

    def send(self, payload: Payload) -> None:
        """Frame, sign if need be, and send; nobody listening is no error."""
        signing = self.signing
        raw = frame(payload, self._sequence & 0xFF, self.system, AUTOPILOT, SIGNED if signing.active else 0)
        if signing.active:
            raw = signing.sign(raw, self.number)
        self._sequence += 1
        self._hand_over(raw)

    def forward(self, raw: bytes) -> None:
        """Pass a frame of somebody else on."""
        self.counters["forwarded"] += 1
        self._hand_over(raw)

    def _hand_over(self, raw: bytes) -> None:
        if self._put(raw):
            self.sent += 1
        else:
            self.counters["send failed"] += 1
