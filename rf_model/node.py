"""The rf node: the simulated radio worlds of one vehicle or several on the bus.

Inputs `SlotOpened`, `Action` and `VehicleState` are queued by zenoh's threads in the order in which they come and
handled here by one thread, whichever vehicle they are for; `slot_radio.SlotRadio` decides what they mean.

    SlotOpened(k) --> is Action(k-1) still on its way?  yes: wait for it, at most 1 s of wall clock
                         | no, or it came, or waited long enough
                         v
                      RisConfiguration(k-1) if still due, LinkReport(k-1), ChannelState(k)
    Action(k)     --> RisConfiguration(k), at once unless the newest VehicleState is past the deadline: then
                      SlotOpened(k+1), where the bridge says whether it got it in time, settles it

When `ris.mode` sets the surface without the agent, nothing waits: SlotOpened(k) --> LinkReport(k-1),
RisConfiguration(k), ChannelState(k), and actions are not listened to.
"""

import gc
import queue
import sys
import time
import traceback
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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
from rf_model.ris_control import RisControl
from rf_model.scenario import Scenario
from rf_model.slot_radio import AGENT, SlotRadio, rehearse

NODE = "rf"
ACTION_WAIT_S = 1.0
"""Wall clock that an action known to be on its way is waited for."""
HEALTH_PERIOD_S = 1.0


_Item = SlotOpened | Action | VehicleState | Literal["ended"]
_Inbox = queue.SimpleQueue[tuple["_Vehicle", _Item]]


@dataclass(frozen=True)
class World:
    """What one vehicle's radio world is made of."""

    scenario: Scenario
    seed: int


def run(
    worlds: Mapping[str, World],
    session: zenoh.Session,
    *,
    action_deadline_s: float,
    until_ended: bool,
    ris: RisControl = AGENT,
) -> int:
    """Serve vehicles by name, each with a world of its own; returns the exit code.

    Ends when all their flights have ended (`until_ended`; `bus.topics.watch_end` says when), or never. One that fails,
    which would be an error of ours, leaves the bus; the others go on. The code is 0, or 1 if one failed; then it also
    ends when all have. `action_deadline_s` [s of vehicle time after a slot's opening] is when an action seems late.
    Raises ValueError for a bad vehicle name, RisControlError for a mode that the scenario does not allow.
    """
    torch.set_num_threads(1)  # tensors of one slot are small; the other cores are for the other nodes
    rehearse(next(iter(worlds.values())).scenario, ris)
    gc.collect()
    gc.freeze()  # or going through all that is loaded takes 0.1 s in the middle of some slot
    inbox: _Inbox = queue.SimpleQueue()
    serving: list[_Vehicle] = []
    failed = False
    try:
        for name, world in worlds.items():
            radio = SlotRadio(world.scenario, world.seed, ris)
            serving.append(_Vehicle(name, radio, session, inbox, action_deadline_s))
        while serving:
            addressee, item = _next(inbox, min(vehicle.wakes_s for vehicle in serving))
            for vehicle in list(serving):
                try:
                    over = vehicle.step(item if vehicle is addressee else None) and until_ended
                except Exception:  # noqa: BLE001 - whatever is wrong with one vehicle, the others fly on
                    print(f"rf: {vehicle.name} failed", file=sys.stderr)
                    traceback.print_exc()
                    failed = over = True
                if over:
                    serving.remove(vehicle)
                    vehicle.leave()
        return int(failed)
    finally:
        for vehicle in serving:
            vehicle.leave()


def _next(inbox: _Inbox, until_s: float) -> "tuple[_Vehicle, _Item] | tuple[None, None]":
    """What comes first, or nothing until then (monotonic clock)."""
    try:
        return inbox.get(timeout=max(0.0, until_s - time.monotonic()))
    except queue.Empty:
        return None, None


class _Vehicle:
    """One vehicle's world on the bus."""

    def __init__(
        self, name: str, radio: SlotRadio, session: zenoh.Session, inbox: _Inbox, action_deadline_s: float
    ) -> None:
        self.name = name
        self._radio = radio
        self._deadline_s = action_deadline_s
        self._vehicle_time_s = float("-inf")
        self._refused: Counter[str] = Counter()
        self._waiting: tuple[SlotOpened, float] | None = None
        """A slot that waits for the last one's action, and until when on the monotonic clock."""
        self._next_health = time.monotonic()

        def put(item: _Item) -> None:
            inbox.put((self, item))

        self._csi = topics.Publisher(session, name, topics.CSI)
        self._configuration = topics.Publisher(session, name, topics.CONFIGURATION)
        self._link = topics.Publisher(session, name, topics.LINK)
        self._event = topics.Publisher(session, name, topics.EVENT)
        self._health = topics.Publisher(session, name, topics.HEALTH)
        self._configurations = History(session, name, topics.CONFIGURATION)
        self._links = History(session, name, topics.LINK)
        self._declarations: list[topics.Declared] = [self._configurations, self._links]
        if radio.needs_actions:
            self._declarations += [
                topics.subscribe(session, name, topics.ACTION, put, self._refused),
                topics.subscribe(session, name, topics.STATE, put, self._refused),
            ]
        self._declarations += [
            topics.subscribe(session, name, topics.SLOT, put, self._refused),
            *topics.watch_end(session, name, lambda: put("ended")),
            topics.declare_alive(session, name, NODE),
        ]

    @property
    def wakes_s(self) -> float:
        """When `step` is due although nothing came (monotonic clock)."""
        return self._next_health if self._waiting is None else min(self._next_health, self._waiting[1])

    def step(self, item: _Item | None) -> bool:
        """Take one item in, if there is one, and do what is due by the clock; whether it ended the flight."""
        if time.monotonic() >= self._next_health:
            self._send_health()
            self._next_health = time.monotonic() + HEALTH_PERIOD_S
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
                    self._publish(self._radio.opening(item))
            case "ended":
                self._open_waiting()
                return True
        if self._waiting is not None and time.monotonic() >= self._waiting[1]:
            self._radio.counters["waited_in_vain"] += 1
            self._open_waiting()
        return False

    def leave(self) -> None:
        """Say the last counters and go off the bus."""
        self._send_health()
        for declaration in self._declarations:
            declaration.undeclare()

    def _open_waiting(self) -> None:
        if self._waiting is not None:
            opened, _ = self._waiting
            self._waiting = None
            self._publish(self._radio.opening(opened))

    def _publish(self, messages: Iterable[Message]) -> None:
        """Send what the radio world says, and why it did not set what it should have."""
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
