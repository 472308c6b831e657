"""What the bridge says and hears on the bus.

Zenoh's threads only put what they receive into queues; the thread that flies takes it from there.
"""

import contextlib
import queue
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import TypeVar

import zenoh

from autopilot_bridge.bell import Bell
from bus import messages as m
from bus import topics

HEALTH_WALL_S = 1.0
T = TypeVar("T")


class Ground:
    """The bus side of one vehicle's bridge."""

    def __init__(self, session: zenoh.Session, vehicle: str) -> None:
        self._session, self._name = session, vehicle
        self._event = topics.Publisher(session, vehicle, topics.EVENT)
        self._health = topics.Publisher(session, vehicle, topics.HEALTH)
        self.state = topics.Publisher(session, vehicle, topics.STATE)
        self.slot = topics.Publisher(session, vehicle, topics.SLOT)
        self.setpoint = topics.Publisher(session, vehicle, topics.SETPOINT)
        self.bell = Bell()
        """Rings when one of the queues below has something new."""
        self.actions: queue.SimpleQueue[m.Action] = queue.SimpleQueue()
        self.commands: queue.SimpleQueue[m.CommandName] = queue.SimpleQueue()
        self.changes: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        """Nodes that came (True) and went."""
        self.refused: Counter[str] = Counter()
        """Bad payloads per topic."""
        self.counters: Counter[str] = Counter()
        self.now: Callable[[], float] = lambda: 0.0
        """Vehicle time for events; the flight sets it."""
        self.objection: Callable[[m.CommandName], str] = lambda name: "the bridge is not up yet"
        """Why a command cannot be taken now, empty when it can; called on zenoh's thread."""
        self._health_at = 0.0

    @contextlib.contextmanager
    def served(self) -> Iterator[None]:
        """Subscribed, answering commands, and alive."""
        session, name = self._session, self._name
        held = (
            topics.subscribe(session, name, topics.ACTION, self._put(self.actions), self.refused),
            topics.watch_alive(session, name, lambda node, alive: self._put(self.changes)((node, alive))),
            topics.answer_commands(session, name, self._answer, self.refused),
            topics.declare_alive(session, name, "bridge"),
        )
        try:
            yield
        finally:
            for declared in held:
                declared.undeclare()

    @property
    def malformed_actions(self) -> int:
        return self.refused[topics.ACTION.name]

    def tell(self, kind: str, text: str, exit_code: int | None = None) -> None:
        """An event, on the bus and on our own output."""
        now = self.now()
        try:
            print(f"{now:9.2f} {kind}: {text}", flush=True)
        except (OSError, ValueError):  # a full disk, or letters that it has not, must not take the vehicle down
            self.counters["print_failed"] += 1
        self._event.send(m.MissionEvent(time_s=now, source="bridge", kind=kind, text=text, exit_code=exit_code))

    def publish_health(self, counters: Callable[[], Counter[str]], final: bool = False) -> None:
        """NodeHealth, at most once a second unless `final`."""
        wall = time.monotonic()
        if wall - self._health_at < HEALTH_WALL_S and not final:
            return
        self._health_at = wall
        self._health.send(topics.health("bridge", counters() + self.counters, self.refused))

    def _put(self, into: "queue.SimpleQueue[T]") -> Callable[[T], None]:
        """Puts things there and rings."""

        def put(what: T) -> None:
            into.put(what)
            self.bell.ring()

        return put

    def _answer(self, command: m.Command) -> m.CommandReply:
        reason = self.objection(command.name)
        if not reason:
            self._put(self.commands)(command.name)
        return m.CommandReply(accepted=not reason, reason=reason)
