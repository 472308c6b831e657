"""The rf node over real zenoh sessions."""

import json
import math
import queue
import threading
import time
import uuid
from collections import Counter
from contextlib import contextmanager

import pytest

from bus import topics
from bus.messages import (
    Action,
    ChannelState,
    FlownSlot,
    LinkReport,
    MissionEvent,
    NodeHealth,
    RisConfiguration,
    SlotOpened,
    VehicleState,
)
from bus.session import free_endpoint, open_session
from rf_model.node import run
from rf_model.scenario import preset
from rf_model.slot_radio import SlotRadio

SCENARIO = preset("physical_small")
N, M, J = SCENARIO.elements, SCENARIO.antennas, SCENARIO.users
PATIENCE_S = 20.0  # how long a test waits for what must come; only a failing test waits that long
ZERO = (0.0, 0.0, 0.0)


class Bench:
    """The other nodes of one vehicle: plays bridge and agent, and hears what the rf node says."""

    def __init__(self, session, vehicle):
        self.session, self.vehicle = session, vehicle
        self.refused = Counter()
        self.heard = {ChannelState: queue.Queue(), RisConfiguration: queue.Queue(), LinkReport: queue.Queue()}
        self.health, self.events = queue.Queue(), queue.Queue()
        self.slot = topics.Publisher(session, vehicle, topics.SLOT)
        self.action = topics.Publisher(session, vehicle, topics.ACTION)
        self.state = topics.Publisher(session, vehicle, topics.STATE)
        self.event = topics.Publisher(session, vehicle, topics.EVENT)
        self.alive = queue.Queue()
        sinks = [
            (topics.CSI, self.heard[ChannelState]),
            (topics.CONFIGURATION, self.heard[RisConfiguration]),
            (topics.LINK, self.heard[LinkReport]),
            (topics.HEALTH, self.health),
            (topics.EVENT, self.events),
        ]
        self.kept = [topics.subscribe(session, vehicle, topic, sink.put, self.refused) for topic, sink in sinks]
        self.kept.append(topics.watch_alive(session, vehicle, lambda node, alive: self.alive.put((node, alive))))

    def next(self, kind):
        return self.heard[kind].get(timeout=PATIENCE_S)

    def wait_alive(self, state=True):
        while self.alive.get(timeout=PATIENCE_S) != ("rf", state):
            pass

    def counters_when(self, condition):
        """The node's counters as soon as they meet a condition."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            health: NodeHealth = self.health.get(timeout=PATIENCE_S)
            if condition(health.counters):
                return health.counters
        raise AssertionError(f"never so: {health.counters}")

    def end(self):
        self.event.send(MissionEvent(time_s=0.0, source="bridge", kind="ended", text="", exit_code=0))


@pytest.fixture
def bench():
    endpoint = free_endpoint()
    with open_session(listen=endpoint) as ours, open_session(connect=[endpoint]) as theirs:
        bench = Bench(ours, f"t{uuid.uuid4().hex[:8]}")
        bench.theirs = theirs
        yield bench


@contextmanager
def rf_node(bench, seed=1, until_ended=True):
    """A node in a thread of its own, ended at the latest on leaving."""
    codes = []
    thread = threading.Thread(
        target=lambda: codes.append(
            run(SCENARIO, {bench.vehicle: seed}, bench.theirs, action_deadline_s=0.25, until_ended=until_ended)
        )
    )
    thread.start()
    bench.wait_alive()
    try:
        yield codes
    finally:
        bench.end()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
        bench.wait_alive(False)


def opened(slot, outcome="flown", closing=False):
    flown = FlownSlot(
        slot=max(slot - 1, 0),
        outcome=outcome,
        reasons=[],
        commanded_enu=ZERO,
        planned_enu=ZERO,
        flown_enu=ZERO,
        track=[],
        plan=[],
    )
    return SlotOpened(
        slot=slot,
        slots=30,
        time_s=100.0 + slot,
        position_enu=(float(slot), 0.0, 60.0),
        velocity_enu=ZERO,
        attitude_rad=ZERO,
        closing=closing,
        flown=flown if slot else None,
    )


def action(slot, **changes):
    fields = {
        "slot": slot,
        "time_s": 100.0 + slot,
        "source": "test",
        "displacement_enu": ZERO,
        "theta_reflection": [0.01 * slot] * N,
        "split_angle": [0.5] * N,
        "sign": [-1] * N,
        "beamforming": [[(0.1, 0.0)] * J] * M,
        "raw": [],
    }
    return Action(**(fields | changes))


def state(time_s):
    return VehicleState(
        time_s=time_s,
        position_enu=ZERO,
        velocity_enu=ZERO,
        attitude_rad=ZERO,
        mode="OFFBOARD",
        armed=True,
        landed=False,
        battery_remaining=None,
        home_lat_lon_alt=None,
        phase="slots",
    )


def test_good_slots_then_the_end(bench):
    expected = SlotRadio(SCENARIO, 1)
    with rf_node(bench) as codes:
        for k in range(3):
            bench.slot.send(opened(k))
            for message in expected.open(opened(k)):
                assert topics.encode(bench.next(type(message))) == topics.encode(message)
            bench.action.send(action(k))
            (configuration,) = expected.apply(action(k))
            assert topics.encode(bench.next(RisConfiguration)) == topics.encode(configuration)
        bench.slot.send(opened(3, closing=True))
        assert bench.next(LinkReport).slot == 2
        bench.end()
        counters = bench.counters_when(lambda c: c.get("flights") == 1)
        assert (counters["applied"], counters["refused"]) == (3, 0)
    assert codes == [0]
    assert all(heard.empty() for heard in bench.heard.values())


def test_missing_action_is_held(bench):
    with rf_node(bench):
        bench.slot.send(opened(0))
        bench.next(ChannelState)
        bench.action.send(action(0))
        assert bench.next(RisConfiguration).source == "action"
        bench.slot.send(opened(1))
        bench.next(LinkReport)
        bench.slot.send(opened(2, "missing"))
        held, report = bench.next(RisConfiguration), bench.next(LinkReport)
        assert (held.slot, held.source, report.configuration) == (1, "held", "held")


def test_bad_actions_are_counted_and_told(bench):
    with rf_node(bench):
        bench.slot.send(opened(0))
        bench.next(ChannelState)
        # No number on the wire: JSON has no NaN, msgspec writes null, every reader refuses.
        bench.action.send(action(0, split_angle=[math.nan] * N))
        bench.action.send(action(0, theta_reflection=[0.0] * 3))
        assert bench.next(RisConfiguration).source == "default"
        bench.session.put(topics.key(bench.vehicle, "agent/action"), b"not a message")
        counters = bench.counters_when(lambda c: c.get("refused") == 2 and c.get("rejected") == 1)
        assert counters["refused agent/action"] == 2
        event = bench.events.get(timeout=PATIENCE_S)
        assert (event.source, event.kind) == ("rf", "rejected")
        assert "theta_reflection: shape [3], the surface has 16 elements" in event.text


def test_action_that_comes_after_the_next_opening_is_still_applied_if_the_bridge_got_it(bench):
    with rf_node(bench):
        bench.slot.send(opened(0))
        bench.next(ChannelState)
        bench.slot.send(opened(1, "clipped"))
        bench.action.send(action(0))
        configuration, report = bench.next(RisConfiguration), bench.next(LinkReport)
        assert (configuration.slot, configuration.source, report.configuration) == (0, "action", "action")
        assert bench.next(ChannelState).slot == 1


def test_action_that_never_comes_is_waited_for_and_then_held(bench):
    with rf_node(bench):
        bench.slot.send(opened(0))
        bench.next(ChannelState)
        bench.slot.send(opened(1, "flown"))
        assert bench.next(RisConfiguration).source == "default"
        assert bench.next(LinkReport).slot == 0
        assert bench.next(ChannelState).slot == 1
        bench.action.send(action(0))
        counters = bench.counters_when(lambda c: c.get("stray") == 1)
        assert counters["waited_in_vain"] == 1


def test_late_action_is_held_when_the_bridge_calls_it_late(bench):
    with rf_node(bench):
        bench.state.send(state(102.3))
        for k in range(3):  # two slots without actions, so that the state has surely come
            bench.slot.send(opened(k, "missing"))
            bench.next(ChannelState)
        bench.action.send(action(2))
        counters = bench.counters_when(lambda c: c.get("doubtful") == 1)
        assert "applied" not in counters
        bench.slot.send(opened(3, "late"))
        assert [bench.next(RisConfiguration).source for _ in range(3)] == ["default"] * 3
        assert [bench.next(LinkReport).configuration for _ in range(3)] == ["default"] * 3
        bench.counters_when(lambda c: c.get("late") == 1)


def test_restarted_node_takes_up_the_open_slot_with_the_same_channels(bench):
    with rf_node(bench):
        for k in range(3):
            bench.slot.send(opened(k, "missing"))
            before = bench.next(ChannelState)
    with rf_node(bench):
        assert topics.encode(bench.next(ChannelState)) == topics.encode(before)  # from the cached SlotOpened


def test_queryables_answer_the_latest_and_any_slot(bench):
    def ask(name, selector=""):
        (reply,) = bench.session.get(topics.key(bench.vehicle, name) + selector, timeout=PATIENCE_S)
        return (reply.ok or reply.err).payload.to_bytes(), reply.ok is not None

    with rf_node(bench):
        assert ask("rf/link") == (b"slot: nothing kept for any slot yet", False)
        reports = []
        for k in range(3):
            bench.slot.send(opened(k, "missing"))
            bench.next(ChannelState)
            if k:
                reports.append(bench.next(LinkReport))
        assert ask("rf/link") == (topics.encode(reports[1]), True)
        assert ask("rf/link", "?slot=0") == (topics.encode(reports[0]), True)
        configuration, good = ask("ris/configuration", "?slot=1")
        assert good
        assert json.loads(configuration)["slot"] == 1
        assert ask("rf/link", "?slot=7") == (b"slot: nothing kept for 7", False)
        assert ask("rf/link", "?slot=first") == (b"slot: 'first' is not a slot number", False)


def test_late_joiner_gets_the_last_configuration(bench):
    with rf_node(bench):
        bench.slot.send(opened(0))
        bench.next(ChannelState)
        bench.action.send(action(0))
        bench.next(RisConfiguration)
        joined = queue.Queue()
        subscriber = topics.subscribe(bench.session, bench.vehicle, topics.CONFIGURATION, joined.put, bench.refused)
        assert joined.get(timeout=PATIENCE_S).slot == 0
        subscriber.undeclare()


def test_ends_when_the_bridge_is_gone(bench):
    bridge = topics.declare_alive(bench.session, bench.vehicle, "bridge")
    with rf_node(bench) as codes:
        bridge.undeclare()
        bench.wait_alive(False)
        bench.alive.put(("rf", False))  # once more for the one who ends the node
    assert codes == [0]


def test_bad_vehicle_name_is_refused(bench):
    with pytest.raises(ValueError, match="vehicle: 'a/b'"):
        run(SCENARIO, {"a/b": 1}, bench.theirs, action_deadline_s=0.25, until_ended=True)
