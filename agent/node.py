"""The agent on the bus: one `Action` for every `ChannelState`."""

import gc
import queue
import time
from collections import Counter
from typing import Literal

import torch
import zenoh

from agent.decoding import PhysicalAction, RawActionError, decode
from agent.observation import Normalisation, ObservationError, observe_message
from agent.policies import make_policy
from agent.policy import PolicyConfig
from bus import messages as m
from bus import topics
from rf_model.scenario import Scenario
from rf_model.star_ris import IndependentTrc

NODE = "agent"
HEALTH_EVERY_S = 1.0

Inbox = queue.SimpleQueue[m.ChannelState | Literal["ended"]]


def run(
    policy: PolicyConfig,
    scenario: Scenario,
    seed: int,
    vehicle: str,
    session: zenoh.Session,
    *,
    until_ended: bool,
) -> int:
    """Answer channel states with actions; returns the exit code.

    The same channel states and seed give the same actions, also after a restart. `until_ended` ends the node with
    the flight (`bus.topics.watch_end`); else it runs until interrupted. A channel state of other sizes
    than the scenario's, or a policy that gives no finite action, is counted and not answered: the bridge then holds.
    Raises CheckpointError when the policy cannot be loaded.
    """
    torch.set_num_threads(1)
    decide = make_policy(policy, scenario, seed)
    normalisation = Normalisation.of(scenario)
    gc.collect()
    gc.freeze()  # or going through all that is loaded takes 0.1 s in the middle of some slot
    counters: Counter[str] = Counter(received=0, decided=0, wrong_size=0, not_finite=0)
    refused: Counter[str] = Counter()
    inbox: Inbox = queue.SimpleQueue()

    actions = topics.Publisher(session, vehicle, topics.ACTION)
    health = topics.Publisher(session, vehicle, topics.HEALTH)
    held = [topics.subscribe(session, vehicle, topics.CSI, inbox.put, refused)]
    if until_ended:
        held += topics.watch_end(session, vehicle, lambda: inbox.put("ended"))
    held.append(topics.declare_alive(session, vehicle, NODE))

    def report_health() -> None:
        health.send(topics.health(NODE, counters, refused))

    next_health = time.monotonic()
    try:
        while True:
            wait = next_health - time.monotonic()
            if wait <= 0:
                report_health()
                next_health = time.monotonic() + HEALTH_EVERY_S
                continue
            try:
                item = inbox.get(timeout=wait)
            except queue.Empty:
                continue
            if item == "ended":
                return 0
            counters["received"] += 1
            try:
                raw = decide(observe_message(item, normalisation), item.slot)
                actions.send(_message(item, decide.name, raw, decode(raw.double(), scenario)))
                counters["decided"] += 1
            except ObservationError:
                counters["wrong_size"] += 1
            except RawActionError:
                counters["not_finite"] += 1
    finally:
        report_health()
        for declared in held:
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
