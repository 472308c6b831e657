"""The rf node: the simulated radio world of one vehicle on the bus.

Inputs `SlotOpened`, `Action` and `VehicleState` are queued by zenoh's threads in the order in which they come and
handled here by one thread; `slot_radio.SlotRadio` decides what they mean.

    SlotOpened(k) --> is Action(k-1) still on its way?  yes: wait for it, at most 1 s of wall clock
                         | no, or it came, or waited long enough
                         v
                      RisConfiguration(k-1) if still due, LinkReport(k-1), ChannelState(k)
    Action(k)     --> RisConfiguration(k), at once unless the newest VehicleState is past the deadline: then
                      SlotOpened(k+1), where the bridge says whether it got it in time, settles it
"""

import queue
import time
from collections import Counter
from typing import Literal

import torch
import zenoh

from bus import topics
from bus.messages import (
    Action,
    ChannelState,
    LinkReport,
    Message,
    MissionEvent,
    RisConfiguration,
    SlotOpened,
    VehicleState,
)
from rf_model.history import History
from rf_model.scenario import Scenario
from rf_model.slot_radio import SlotRadio

NODE = "rf"
ACTION_WAIT_S = 1.0
"""Wall clock that an action known to be on its way is waited for."""
HEALTH_PERIOD_S = 1.0


_Item = SlotOpened | Action | VehicleState | Literal["ended"]


def run(
    scenario: Scenario,
    seed: int,
    vehicle: str,
    session: zenoh.Session,
    *,
    action_deadline_s: float,
    until_ended: bool,
) -> int:
    """Serve one vehicle until the flight has ended (`until_ended`) or for ever; returns exit code 0.

    `action_deadline_s` [s of vehicle time after a slot's opening] is when an action seems late. `bus.topics.watch_end`
    says when the flight has ended. Raises ValueError for a bad vehicle name.
    """
    torch.set_num_threads(1)  # tensors of one slot are small; the other cores are for the other nodes
    return _RfNode(scenario, seed, vehicle, session, action_deadline_s).serve(until_ended)


class _RfNode:
    def __init__(
        self, scenario: Scenario, seed: int, vehicle: str, session: zenoh.Session, action_deadline_s: float
    ) -> None:
        self._radio = SlotRadio(scenario, seed)
        self._deadline_s = action_deadline_s
        self._vehicle_time_s = float("-inf")
        self._inbox: queue.SimpleQueue[_Item] = queue.SimpleQueue()
        self._refused: Counter[str] = Counter()
        self._waiting: tuple[SlotOpened, float] | None = None
        """A slot that waits for the last one's action, and until when on the monotonic clock."""

        self._csi = topics.Publisher(session, vehicle, topics.CSI)
        self._configuration = topics.Publisher(session, vehicle, topics.CONFIGURATION)
        self._link = topics.Publisher(session, vehicle, topics.LINK)
        self._event = topics.Publisher(session, vehicle, topics.EVENT)
        self._health = topics.Publisher(session, vehicle, topics.HEALTH)
        self._configurations = History(session, vehicle, topics.CONFIGURATION)
        self._links = History(session, vehicle, topics.LINK)
        self._declarations: list[topics.Declared] = [
            self._configurations,
            self._links,
            topics.subscribe(session, vehicle, topics.ACTION, self._inbox.put, self._refused),
            topics.subscribe(session, vehicle, topics.STATE, self._inbox.put, self._refused),
            topics.subscribe(session, vehicle, topics.SLOT, self._inbox.put, self._refused),
            *topics.watch_end(session, vehicle, lambda: self._inbox.put("ended")),
            topics.declare_alive(session, vehicle, NODE),
        ]

    def serve(self, until_ended: bool) -> int:
        try:
            next_health = time.monotonic()
            while True:
                now = time.monotonic()
                if now >= next_health:
                    self._send_health()
                    next_health = now + HEALTH_PERIOD_S
                wake = next_health if self._waiting is None else min(next_health, self._waiting[1])
                try:
                    item = self._inbox.get(timeout=max(0.0, wake - now))
                except queue.Empty:
                    self._give_up_waiting()
                    continue
                if self._handle(item) and until_ended:
                    return 0
        finally:
            self._send_health()
            for declaration in self._declarations:
                declaration.undeclare()

    def _handle(self, item: _Item) -> bool:
        """Take one item in; whether it ended the flight."""
        match item:
            case VehicleState():
                self._vehicle_time_s = item.time_s
            case Action():
                slot = self._radio.slot
                late = slot is not None and self._vehicle_time_s > slot.time_s + self._deadline_s
                self._publish(self._radio.apply(item, late))
                if self._waiting is not None and not self._radio.must_wait(self._waiting[0]):
                    self._open_waiting()
            case SlotOpened():
                self._open_waiting()
                if self._radio.must_wait(item):
                    self._waiting = (item, time.monotonic() + ACTION_WAIT_S)
                else:
                    self._publish(self._radio.open(item))
            case "ended":
                self._open_waiting()
                return True
        self._give_up_waiting()
        return False

    def _give_up_waiting(self) -> None:
        if self._waiting is not None and time.monotonic() >= self._waiting[1]:
            self._radio.counters["waited_in_vain"] += 1
            self._open_waiting()

    def _open_waiting(self) -> None:
        if self._waiting is not None:
            opened, _ = self._waiting
            self._waiting = None
            self._publish(self._radio.open(opened))

    def _publish(self, messages: list[Message]) -> None:
        """Send what the radio world says, and why it rejected actions."""
        for message in messages:
            match message:
                case RisConfiguration():
                    self._configurations.keep(message)
                    self._configuration.send(message)
                case LinkReport():
                    self._links.keep(message)
                    self._link.send(message)
                case ChannelState():
                    self._csi.send(message)
        for reason in self._radio.rejections:
            self._event.send(MissionEvent(time_s=self._radio.time_s, source=NODE, kind="rejected", text=reason))
        self._radio.rejections.clear()

    def _send_health(self) -> None:
        counters = {**self._radio.counters, "refused": sum(self._refused.values())}
        self._health.send(topics.health(NODE, counters, self._refused))
