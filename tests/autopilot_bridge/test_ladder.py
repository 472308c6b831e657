"""Flights on the deadman ladder, in lockstep, on both autopilots: who flies, what is on the wire, what is told."""

import time
from functools import partial

import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge import node
from autopilot_bridge.link import Link
from tests.autopilot_bridge.on_the_wire import asked, of_vehicle, read_log, setpoints

HOLD_MODE = {"px4": "AUTO.LOITER", "arducopter": "BRAKE"}
RETURN_MODE = {"px4": "AUTO.RTL", "arducopter": "RTL"}
LAND_MODE = {"px4": "AUTO.LAND", "arducopter": "LAND"}
SILENT_FROM = 3


@pytest.fixture(params=["px4", "arducopter"])
def autopilot(request, sitl):
    started = sitl("--lockstep", "--personality", request.param)
    started.personality = request.param
    return started


def silent_until(slot):
    """An agent that says nothing from slot 3 on, up to this one."""

    def decide(opened):
        time.sleep(0.005)
        return None if SILENT_FROM <= opened.slot < slot else (0.5 if opened.slot % 2 else -0.5, 0.0, 0.0)

    return decide


def modes_in(flight, first, last):
    """Modes told between two slots' openings."""
    opened = {o.slot: o.time_s for o in flight.slots}
    return {s.mode for s in flight.states if opened[first] <= s.time_s < opened[last]}


def rungs(flight):
    return [text.split(":")[0] for text in flight.told("ladder")]


def test_the_autopilots_hold_mode_and_back(autopilot, fly, bridge_config, tmp_path):
    config = bridge_config(autopilot, slots=18, action_wait_wall_s=0.02)
    flight = fly(config, silent_until(12), tlog=tmp_path / "flight.tlog")
    assert flight.wait() == 0
    assert rungs(flight)[:3] == ["FLY -> HOLD", "HOLD -> HOLD_MODE", "HOLD_MODE -> FLY"]
    assert "no good action for 5 s" in flight.told("ladder")[1]
    outcomes = [flown.outcome for flown in flight.flown]
    assert set(outcomes[:3]) <= {"flown", "clipped"}
    assert outcomes[3:12] == ["missing"] * 9
    assert outcomes[12] == "rejected"  # the sign of life, for which control is taken again
    assert "the autopilot holds in" in flight.flown[12].reasons[0]
    assert set(outcomes[13:]) <= {"flown", "clipped"}
    assert modes_in(flight, 9, 12) == {HOLD_MODE[autopilot.personality]}
    assert HOLD_MODE[autopilot.personality] not in modes_in(flight, 14, 18)
    assert not flight.told("mode")  # nobody else's

    log = read_log(tmp_path / "flight.tlog")
    sent = [m.time_boot_ms / 1000 for m in setpoints(log)]
    opened = {o.slot: o.time_s for o in flight.slots}
    quiet = [t for t in sent if opened[9] <= t < opened[12]]
    assert quiet == []
    for slot in (4, 14):  # and a full stream before and after
        assert len([t for t in sent if opened[slot] <= t < opened[slot + 1]]) == 20


def test_up_to_the_return(autopilot, fly, bridge_config):
    config = bridge_config(autopilot, slots=60, action_wait_wall_s=0.02, grace_s=8.0)
    flight = fly(config, silent_until(1000))
    assert flight.wait() == 3
    assert rungs(flight) == ["FLY -> HOLD", "HOLD -> HOLD_MODE", "HOLD_MODE -> RETURN"]
    assert flight.told("failsafe") == ["no good action for 8 s"]
    assert flight.phases[-2:] == ["holding", "returning"]
    modes = list(dict.fromkeys(state.mode for state in flight.states))
    assert modes.index(HOLD_MODE[autopilot.personality]) < modes.index(RETURN_MODE[autopilot.personality])
    flight.until(lambda: not flight.states[-1].armed, "word of the disarming")


def test_a_return_that_takes_too_long_lands(autopilot, fly, bridge_config):
    config = bridge_config(autopilot, slots=60, action_wait_wall_s=0.02, grace_s=3.0, return_s=4.0)
    flight = fly(config, silent_until(1000))
    assert flight.wait() == 3
    assert rungs(flight)[-2:] == ["HOLD -> RETURN", "RETURN -> LAND"]
    assert flight.told("ladder")[-1].endswith("not on the ground 4 s after it was sent home")
    assert flight.phases[-2:] == ["returning", "landing"]
    assert LAND_MODE[autopilot.personality] in {state.mode for state in flight.states}
    flight.until(lambda: not flight.states[-1].armed, "word of the disarming")


def test_slots_that_end_in_the_hold_mode(autopilot, fly, bridge_config, tmp_path):
    """The flight is over as planned, and nobody takes control again for it."""
    config = bridge_config(autopilot, slots=11, action_wait_wall_s=0.02)
    flight = fly(config, silent_until(1000), tlog=tmp_path / "flight.tlog")
    assert flight.wait() == 0
    assert len(flight.flown) == 11
    last = setpoints(read_log(tmp_path / "flight.tlog"))[-1].time_boot_ms / 1000
    assert last < flight.slots[-1].time_s - 2.0


class Lost:
    """Takes messages of some kinds, or all, out of what comes in, from one slot's opening for a while."""

    def __init__(self, *kinds):
        self.kinds, self.on = kinds, False

    def __call__(self, datagram):
        wanted = not self.kinds or int.from_bytes(datagram[7:10], "little") in self.kinds
        return () if self.on and wanted else (datagram,)


POSITION, HEARTBEAT = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED, mavlink.MAVLINK_MSG_ID_HEARTBEAT


@pytest.fixture
def lost(monkeypatch):
    """`lost(kind)`: a fault, off at first, on the next flight's link."""

    def arrange(*kinds):
        fault = Lost(*kinds)
        monkeypatch.setattr(node, "Link", partial(Link, tamper_in=fault))
        return fault

    return arrange


def losing(fault, first, last):
    def decide(opened):
        time.sleep(0.005)
        fault.on = first <= opened.slot < last
        return (0.5 if opened.slot % 2 else -0.5, 0.0, 0.0)

    return decide


def test_positions_that_stop_are_not_steered_by(autopilot, fly, bridge_config, lost, tmp_path):
    """While all else goes on, as PX4 does without an estimate; and come back."""
    fault = lost(POSITION)
    flight = fly(bridge_config(autopilot, slots=14), losing(fault, 3, 7), tlog=tmp_path / "flight.tlog")
    assert flight.wait() == 0
    assert rungs(flight)[:2] == ["FLY -> HOLD_MODE", "HOLD_MODE -> FLY"]
    assert flight.told("ladder")[0].endswith("no position for 1 s")
    assert any("telemetry is back" in text for text in flight.told("stall"))
    opened = {o.slot: o.time_s for o in flight.slots}
    sent = [m.time_boot_ms / 1000 for m in setpoints(read_log(tmp_path / "flight.tlog"))]
    lost_s = max(t for t in sent if t < opened[5]) - opened[3]
    assert 0.3 < lost_s < 0.7
    assert [t for t in sent if opened[3] + 0.7 <= t < opened[7]] == []
    assert modes_in(flight, 5, 7) == {HOLD_MODE[autopilot.personality]}
    assert {s.position_age_s for s in flight.states if s.time_s < opened[3]} == {0.0}
    assert min(s.position_age_s for s in flight.states if opened[5] <= s.time_s < opened[7]) > 1.0
    outcomes = [flown.outcome for flown in flight.flown]
    assert len(outcomes) == 14  # slots went on
    assert set(outcomes[9:]) <= {"flown", "clipped"}


def test_positions_that_stay_away_send_it_home(autopilot, fly, bridge_config, lost):
    fault = lost(POSITION)
    flight = fly(bridge_config(autopilot, slots=60, grace_s=6.0), losing(fault, 3, 1000))
    assert flight.wait() == 3
    assert rungs(flight) == ["FLY -> HOLD_MODE", "HOLD_MODE -> RETURN"]
    assert flight.told("failsafe") == ["no position for 6 s"]
    flight.until(lambda: not flight.states[-1].armed, "word of the disarming")


def test_nothing_is_asked_for_in_the_dark(autopilot, fly, bridge_config, lost, tmp_path):
    """What we hear is lost, what we say would arrive: PX4's failsafe has its way, ArduCopter brakes and stays ours."""
    fault = lost()
    flight = fly(bridge_config(autopilot, slots=14), losing(fault, 3, 7), tlog=tmp_path / "flight.tlog")
    px4 = autopilot.personality == "px4"
    assert flight.wait() == (3 if px4 else 0)
    opened = {o.slot: o.time_s for o in flight.slots}
    log = read_log(tmp_path / "flight.tlog")
    sent = [i for i, m in enumerate(log) if m in setpoints(log)]
    last = max(i for i in sent if log[i].time_boot_ms / 1000 < opened[5])
    assert 0.3 < log[last].time_boot_ms / 1000 - opened[3] < 0.7
    back = next(i for i, m in of_vehicle(log, "HEARTBEAT") if i > last)
    assert asked(log[last + 1 : back]) == []
    assert bool([text for text in flight.told("mode") if "AUTO.RTL was chosen" in text]) == px4


def test_a_mode_that_is_not_told_is_not_flown_on(sitl, fly, bridge_config, lost, tmp_path):
    """HEARTBEATs are lost, all else comes: the stream ends, the failsafe acts, and is obeyed once it is heard of."""
    fault = lost(HEARTBEAT)
    flight = fly(bridge_config(sitl("--lockstep"), slots=30), losing(fault, 3, 8), tlog=tmp_path / "flight.tlog")
    assert flight.wait() == 3
    opened = {o.slot: o.time_s for o in flight.slots}
    last = setpoints(read_log(tmp_path / "flight.tlog"))[-1].time_boot_ms / 1000
    assert opened[3] + 1.3 < last < opened[3] + 1.7
    assert any("AUTO.RTL was chosen" in text for text in flight.told("mode"))
    assert flight.phases[-1] == "yielded"
