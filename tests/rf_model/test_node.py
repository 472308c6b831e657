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
from rf_model.node import World, run
from rf_model.ris_control import RisControl, RisControlError
from rf_model.scenario import preset
from rf_model.seeding import vehicle_seeds
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

    def ask(self, name, selector=""):
        """The one answer to a query, and whether it is a good one."""
        (reply,) = self.session.get(topics.key(self.vehicle, name) + selector, timeout=PATIENCE_S)
        return (reply.ok or reply.err).payload.to_bytes(), reply.ok is not None

    def end(self):
        self.event.send(MissionEvent(time_s=0.0, source="bridge", kind="ended", text="", exit_code=0))


@pytest.fixture
def benches():
    """Of two vehicles."""
    endpoint = free_endpoint()
    with open_session(listen=endpoint) as ours, open_session(connect=[endpoint]) as theirs:
        benches = [Bench(ours, f"t{uuid.uuid4().hex[:8]}") for _ in range(2)]
        for bench in benches:
            bench.theirs = theirs
        yield benches


@pytest.fixture
def bench(benches):
    return benches[0]


@contextmanager
def rf_node(*benches, ris="agent"):
    """A node in a thread of its own, ended at the latest on leaving; the first vehicle's seed is 1, and so on."""
    codes = []
    worlds = {bench.vehicle: World(SCENARIO, seed) for seed, bench in enumerate(benches, start=1)}
    control = RisControl(mode=ris, iterations=5)
    thread = threading.Thread(
        target=lambda: codes.append(
            run(worlds, benches[0].theirs, action_deadline_s=0.25, until_ended=True, ris=control)
        )
    )
    thread.start()
    for bench in benches:
        bench.wait_alive()
    try:
        yield codes
    finally:
        for bench in benches:
            bench.end()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()
        for bench in benches:
            bench.wait_alive(False)


def opened(slot, outcome="flown", closing=False, time_s=None):
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
        time_s=100.0 + slot if time_s is None else time_s,
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
    ask = bench.ask
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
        run({"a/b": World(SCENARIO, 1)}, bench.theirs, action_deadline_s=0.25, until_ended=True)


BY_ITSELF = ("closed_form", "optimised")


@pytest.mark.parametrize("mode", BY_ITSELF)
def test_surface_is_set_with_nobody_but_who_opens_the_slots(bench, mode):
    expected = SlotRadio(SCENARIO, 1, RisControl(mode=mode, iterations=5))
    with rf_node(bench, ris=mode):
        for k in range(3):
            slot = opened(k, "missing")
            bench.slot.send(slot)
            for message in expected.open(slot):
                assert topics.encode(bench.next(type(message))) == topics.encode(message)
        bench.slot.send(opened(3, "missing", closing=True))
        assert (bench.next(LinkReport).slot, bench.refused) == (2, Counter())
        bench.end()
        counters = bench.counters_when(lambda c: c.get("flights") == 1)
        assert counters[mode] == 3
    assert all(heard.empty() for heard in bench.heard.values())


@pytest.mark.parametrize("mode", BY_ITSELF)
def test_actions_only_move_the_vehicle_when_the_surface_is_set_without_them(bench, mode):
    with rf_node(bench, ris=mode):
        bench.state.send(state(100.0))
        bench.slot.send(opened(0))
        assert bench.next(RisConfiguration).source == mode
        bench.action.send(action(0))
        bench.action.send(action(0, theta_reflection=[]))
        bench.slot.send(opened(1, "flown"))  # in mode `agent` the node would wait for the action now
        assert (bench.next(LinkReport).configuration, bench.next(RisConfiguration).slot) == (mode, 1)
        bench.end()
        counters = bench.counters_when(lambda c: c.get(mode) == 2)
        assert not counters.keys() & {"applied", "rejected", "stray", "waited_in_vain"}
    assert bench.heard[RisConfiguration].empty()


def test_late_joiners_and_readers_are_answered_also_without_an_agent(bench):
    with rf_node(bench, ris="closed_form"):
        sent = []
        for k in range(2):
            bench.slot.send(opened(k, "missing"))
            sent.append(bench.next(RisConfiguration))
        report = bench.next(LinkReport)
        joined = queue.Queue()
        subscriber = topics.subscribe(bench.session, bench.vehicle, topics.CONFIGURATION, joined.put, bench.refused)
        assert topics.encode(joined.get(timeout=PATIENCE_S)) == topics.encode(sent[1])
        subscriber.undeclare()
        assert bench.ask("ris/configuration") == (topics.encode(sent[1]), True)
        assert bench.ask("ris/configuration", "?slot=0") == (topics.encode(sent[0]), True)
        assert bench.ask("rf/link") == (topics.encode(report), True)


def test_restarted_node_sets_the_open_slot_s_surface_again(bench):
    with rf_node(bench, ris="optimised"):
        for k in range(3):
            bench.slot.send(opened(k, "missing"))
            before = bench.next(RisConfiguration)
    with rf_node(bench, ris="optimised"):
        assert topics.encode(bench.next(RisConfiguration)) == topics.encode(before)


@pytest.mark.parametrize("mode", ["agent", "closed_form"])
def test_each_vehicle_has_the_world_that_it_would_have_alone(benches, mode):
    control = RisControl(mode=mode, iterations=5)
    alone = [SlotRadio(SCENARIO, seed, control) for seed in (1, 2)]
    with rf_node(*benches, ris=mode):
        for k in range(3):
            for bench in benches:
                bench.slot.send(opened(k))
            for bench, radio in zip(benches, alone, strict=True):
                for message in radio.open(opened(k)):
                    assert topics.encode(bench.next(type(message))) == topics.encode(message)
            for bench, radio in zip(benches, alone, strict=True):
                bench.action.send(action(k))
                for message in radio.apply(action(k)) if mode == "agent" else []:
                    assert topics.encode(bench.next(type(message))) == topics.encode(message)
        for bench in benches:
            assert json.loads(bench.ask("ris/configuration")[0])["slot"] == 2
    first, second = (topics.encode(radio.open(opened(0, time_s=500.0))[-1]) for radio in alone)
    assert first != second


def test_what_is_wrong_with_one_vehicle_s_messages_does_not_touch_the_other(benches):
    troubled, sound = benches
    with rf_node(*benches):
        for bench in benches:
            bench.slot.send(opened(0))
            bench.next(ChannelState)
        for topic in ("slot", "agent/action", "state"):
            troubled.session.put(topics.key(troubled.vehicle, topic), b"not a message")
        troubled.action.send(action(0, theta_reflection=[0.0]))
        assert troubled.next(RisConfiguration).source == "default"
        troubled.slot.send(opened(1, "flown"))
        troubled.slot.send(opened(2, "flown"))  # whose action never comes: waited for, while the other flies on
        for k in range(3):
            sound.action.send(action(k))
            assert sound.next(RisConfiguration).source == "action"
            sound.slot.send(opened(k + 1))
            assert sound.next(LinkReport).slot == k
        counters = troubled.counters_when(lambda c: c.get("refused") == 3 and c.get("waited_in_vain") == 1)
        assert counters["rejected"] == 1
        counters = sound.counters_when(lambda c: c.get("applied") == 3)
        assert counters["refused"] == 0
        assert not counters.keys() & {"rejected", "waited_in_vain"}


def test_a_vehicle_whose_flight_ends_leaves_the_others_flying(benches):
    first, second = benches
    with rf_node(*benches) as codes:
        first.end()
        first.wait_alive(False)
        second.slot.send(opened(0))
        assert second.next(ChannelState).slot == 0
        assert codes == []
        second.end()
        second.wait_alive(False)
        for bench in benches:  # once more for the one who ends the node
            bench.alive.put(("rf", False))
    assert codes == [0]


def test_a_vehicle_that_fails_leaves_the_bus_and_the_others_flying(benches, monkeypatch, capsys):
    """No message was found that makes one fail: the fault is injected."""
    failing, sound = benches
    opens = SlotRadio.opening

    def broken(radio, slot):
        if slot.slot == 7:
            raise ArithmeticError("injected")
        return opens(radio, slot)

    monkeypatch.setattr(SlotRadio, "opening", broken)
    with rf_node(*benches) as codes:
        failing.slot.send(opened(7, "missing"))
        failing.wait_alive(False)
        sound.slot.send(opened(0))
        assert sound.next(ChannelState).slot == 0
        failing.alive.put(("rf", False))  # once more for the one who ends the node
    assert codes == [1]
    text = capsys.readouterr().err
    assert f"rf: {failing.vehicle} failed" in text
    assert "ArithmeticError: injected" in text


def test_seeds_of_vehicles_are_the_mission_s_for_the_first_and_do_not_hang_on_the_order_of_the_others():
    assert vehicle_seeds(7, ["a"]) == {"a": 7}
    seeds = vehicle_seeds(7, ["a", "b", "c"])
    assert seeds["a"] == 7
    assert len(set(seeds.values())) == 3
    assert all(0 <= seed < 2**63 for seed in seeds.values()), "what a mission's seed may be"
    assert vehicle_seeds(7, ["a", "c", "b"]) == seeds
    assert vehicle_seeds(8, ["a", "b", "c"])["b"] != seeds["b"]


def test_mode_that_the_scenario_does_not_allow_is_refused(bench):
    by_amplitude = preset("physical_small", sinr="amplitude")
    with pytest.raises(RisControlError, match=r"ris\.mode: 'closed_form'"):
        run(
            {bench.vehicle: World(by_amplitude, 1)},
            bench.theirs,
            action_deadline_s=0.25,
            until_ended=True,
            ris=RisControl(mode="closed_form"),
        )
