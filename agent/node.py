"""The agent on the bus: one `Action` for every `ChannelState`, of one vehicle or several.

One thread decides for all, in the order in which channel states come: a decision takes a millisecond.
"""

import gc
import queue
import sys
import time
import traceback
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
import zenoh

from agent.decoding import PhysicalAction, RawActionError, decode
from agent.observation import Normalisation, ObservationError, observe_message
from agent.policies import make_policy
from agent.policy import Policy, PolicyConfig
from bus import messages as m
from bus import topics
from rf_model.scenario import Scenario
from rf_model.star_ris import IndependentTrc

NODE = "agent"
HEALTH_EVERY_S = 1.0

_Item = m.ChannelState | Literal["ended"]
_Inbox = queue.SimpleQueue[tuple["_Vehicle", _Item]]


@dataclass(frozen=True)
class Task:
    """What one vehicle is flown by."""

    policy: PolicyConfig
    scenario: Scenario
    seed: int


def run(tasks: Mapping[str, Task], session: zenoh.Session, *, until_ended: bool) -> int:
    """Answer the channel states of vehicles, by name, with actions; returns the exit code.

    The same channel states and seed give the same actions, also after a restart. `until_ended` ends the node when all
    flights have ended (`bus.topics.watch_end`); else it runs until interrupted. A channel state of other sizes than the
    scenario's, or a policy that gives no finite action, is counted and not answered: the bridge then holds. A vehicle
    on which the policy fails, which would be an error of ours, is left; the others go on, and the code is 1.
    Raises CheckpointError when a policy cannot be loaded, ValueError for a bad vehicle name.
    """
    torch.set_num_threads(1)
    deciders = {name: make_policy(task.policy, task.scenario, task.seed) for name, task in tasks.items()}
    gc.collect()
    gc.freeze()  # or going through all that is loaded takes 0.1 s in the middle of some slot
    inbox: _Inbox = queue.SimpleQueue()
    serving: list[_Vehicle] = []
    failed = False
    try:
        for name, task in tasks.items():
            serving.append(_Vehicle(name, deciders[name], task.scenario, session, inbox))
        next_health = time.monotonic()
        while serving:
            wait = next_health - time.monotonic()
            if wait <= 0:
                for vehicle in serving:
                    vehicle.report_health()
                next_health = time.monotonic() + HEALTH_EVERY_S
                continue
            try:
                vehicle, item = inbox.get(timeout=wait)
            except queue.Empty:
                continue
            if vehicle not in serving:
                continue
            try:
                over = vehicle.take(item) and until_ended
            except Exception:  # noqa: BLE001 - whatever is wrong with one vehicle, the others fly on
                print(f"agent: {vehicle.name} failed", file=sys.stderr)
                traceback.print_exc()
                failed = over = True
            if over:
                serving.remove(vehicle)
                vehicle.leave()
        return int(failed)
    finally:
        for vehicle in serving:
            vehicle.leave()


class _Vehicle:
    """One vehicle's agent on the bus."""

    def __init__(self, name: str, decide: Policy, scenario: Scenario, session: zenoh.Session, inbox: _Inbox) -> None:
        self.name = name
        self._decide, self._scenario, self._normalisation = decide, scenario, Normalisation.of(scenario)
        self._counters: Counter[str] = Counter(received=0, decided=0, wrong_size=0, not_finite=0)
        self._refused: Counter[str] = Counter()
        self._actions = topics.Publisher(session, name, topics.ACTION)
        self._health = topics.Publisher(session, name, topics.HEALTH)

        def put(item: _Item) -> None:
            inbox.put((self, item))

        self._held = [
            topics.subscribe(session, name, topics.CSI, put, self._refused),
            *topics.watch_end(session, name, lambda: put("ended")),
            topics.declare_alive(session, name, NODE),
        ]

    def take(self, item: _Item) -> bool:
        """Answer a channel state; whether the flight has ended instead."""
        if item == "ended":
            return True
        self._counters["received"] += 1
        try:
            raw = self._decide(observe_message(item, self._normalisation), item.slot)
            self._actions.send(_message(item, self._decide.name, raw, decode(raw.double(), self._scenario)))
            self._counters["decided"] += 1
        except ObservationError:
            self._counters["wrong_size"] += 1
        except RawActionError:
            self._counters["not_finite"] += 1
        return False

    def report_health(self) -> None:
        self._health.send(topics.health(NODE, self._counters, self._refused))

    def leave(self) -> None:
        """Say the last counters and go off the bus."""
        self.report_health()
        for declared in self._held:
            declared.undeclare()


def _message(csi: m.ChannelState, source: str, raw: torch.Tensor, action: PhysicalAction) -> m.Action:
    east, north, up = action.displacement_enu.tolist()
    return m.Action(
        slot=csi.slot,
        time_s=csi.time_s,
        source=source,
        displacement_enu=(east, north, up),
        theta_reflection=action.theta_reflection.tolist(),
        split_angle=action.split_angle.tolist(),
        sign=[1 if sign > 0 else -1 for sign in action.sign.tolist()],
        beamforming=torch.view_as_real(action.beamforming).tolist(),
        theta_transmission=(action.trc.theta_transmission.tolist() if isinstance(action.trc, IndependentTrc) else []),
        raw=raw.tolist(),
    )
