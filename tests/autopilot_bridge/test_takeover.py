"""Pilots are never fought: whatever the bridge is doing, once a HEARTBEAT has told a mode that is not ours nothing that
flies is sent any more, on both autopilots, in lockstep."""

import math
import time
from functools import partial

import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge import node
from autopilot_bridge.link import Link
from tests.autopilot_bridge.on_the_wire import OFFBOARD, asked, heard_mode, of_vehicle, read_log

TALL = {"x": (-50, 50), "y": (-50, 50), "z": (8, 90)}
ALT_HOLD = 2
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
MODES = {
    "px4": {name: (1, 4, sub) for name, sub in (("hold", 3), ("return", 5), ("land", 6))},
    "arducopter": {name: (1, number) for name, number in (("hold", 17), ("return", 6), ("land", 9), ("loiter", 5))},
}
CUSTOM = {
    "px4": {name: 4 << 16 | sub << 24 for name, sub in (("hold", 3), ("return", 5), ("land", 6))},
    "arducopter": {"hold": 17, "return": 6, "land": 9, "loiter": 5},
}


class Case:
    """A flight and its pilot."""

    def __init__(self, personality, sitl, fly, bridge_config, tlog, **changes):
        self.personality, self.px4 = personality, personality == "px4"
        self.autopilot = sitl("--lockstep", "--personality", personality)
        self.tlog = tlog
        self.silent = False
        config = bridge_config(self.autopilot, **({"slots": 2000} | changes))
        self.flight = fly(config, self.decide, tlog=tlog)

    def decide(self, opened):
        time.sleep(0.02)
        return None if self.silent else (0.2 if opened.slot % 2 else -0.2, 0.0, 0.0)

    def until_mode(self, *names):
        wanted = {"hold": ("AUTO.LOITER", "BRAKE"), "return": ("AUTO.RTL", "RTL"), "land": ("AUTO.LAND", "LAND")}
        allowed = {mode for name in names for mode in wanted[name]}
        self.flight.until(lambda: self.flight.states[-1].mode in allowed, f"mode {names}")

    def pilot(self, mode):
        self.autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, *MODES[self.personality][mode])

    def log_after(self, mode):
        """What was on the wire from the HEARTBEAT on that told the pilot's mode (PX4 hovers in the same at first)."""
        log = read_log(self.tlog)
        began = heard_mode(log, OFFBOARD[mavlink.MAV_AUTOPILOT_PX4]) if mode == "hold" and self.px4 else 0
        return log[began:][heard_mode(log[began:], CUSTOM[self.personality][mode]) :]


@pytest.fixture(params=["px4", "arducopter"])
def case(request, sitl, fly, bridge_config, tmp_path):
    return lambda **changes: Case(request.param, sitl, fly, bridge_config, tmp_path / "flight.tlog", **changes)


def lands_by_the_pilot(case):
    """From here to the ground, by the pilot's hand alone."""
    case.pilot("land")
    assert case.flight.wait() == 3
    assert case.flight.phases[-1] == "yielded"
    assert len(case.flight.told("mode")) == 1
    assert asked(case.log_after("land")) == []
    case.flight.until(lambda: not case.flight.states[-1].armed, "word of the disarming")


def test_in_the_takeoff(case):
    case = case(takeoff_altitude_m=80.0, box=TALL)
    case.flight.until(lambda: case.flight.states and case.flight.states[-1].position_enu[2] > 3.0, "the climb")
    assert case.flight.phases[-1] == "takeoff"
    lands_by_the_pilot(case)


def test_a_hold_in_the_takeoff(case):
    """On PX4 that is the mode in which a takeoff ends, on ArduCopter it is BRAKE."""
    case = case(takeoff_altitude_m=80.0, box=TALL)
    case.flight.until(lambda: case.flight.states and case.flight.states[-1].position_enu[2] > 3.0, "the climb")
    case.pilot("hold")
    case.flight.until_phase("yielded")
    height_m = case.flight.states[-1].position_enu[2]
    assert height_m < 70.0
    case.pilot("land")
    assert case.flight.wait() == 3
    log = read_log(case.tlog)
    takeoff = max(i for i, m in enumerate(log) if m.get_type() == "COMMAND_LONG" and m.command == 22)
    assert asked(log[takeoff + 1 :]) == []


def test_on_the_way_to_the_start(case):
    case = case(start_position_enu=(0.0, 0.0, 39.0))
    case.flight.until_phase("transit")
    lands_by_the_pilot(case)
    assert "slots" not in case.flight.phases


def test_in_the_slots(case):
    case = case()
    case.flight.until_slot(2)
    lands_by_the_pilot(case)


def test_in_a_hold_by_command(case):
    case = case()
    case.flight.until_slot(2)
    assert case.flight.command("hold").accepted
    case.flight.until_phase("holding")
    lands_by_the_pilot(case)


def test_in_the_autopilots_hold_mode_while_the_agent_comes_back(case):
    """Its actions would lead back to OFFBOARD if the mode were still ours."""
    case = case(grace_s=3600.0, action_wait_wall_s=0.1)
    case.flight.until_slot(2)
    case.silent = True
    case.until_mode("hold")
    case.pilot("land")
    case.flight.until_phase("yielded")
    case.silent = False
    assert case.flight.wait() == 3
    assert asked(case.log_after("land")) == []


def test_on_the_return(case):
    case = case(start_position_enu=(0.0, 0.0, 39.0))
    case.flight.until_slot(1)
    assert case.flight.command("return").accepted
    case.until_mode("return")
    case.pilot("hold")
    case.flight.until_phase("yielded")
    case.pilot("land")
    assert case.flight.wait() == 3
    assert asked(case.log_after("hold")) == []


def test_on_the_landing(case):
    case = case(start_position_enu=(0.0, 0.0, 39.0))
    case.flight.until_slot(1)
    assert case.flight.command("land").accepted
    case.until_mode("land")
    case.pilot("return")
    case.flight.until_phase("yielded")
    assert case.flight.wait() == 3
    assert asked(case.log_after("return")) == []


def test_resume_takes_it_back_and_nothing_else_does(case):
    case = case(slots=400)
    case.flight.until_slot(2)
    case.pilot("hold")
    case.flight.until_phase("yielded")
    reached = case.flight.slots[-1].slot
    case.flight.until_slot(reached + 10)  # good actions all the while
    assert asked(case.log_after("hold")) == []
    assert case.flight.command("resume").accepted
    case.flight.until_slot(case.flight.slots[-1].slot + 5)
    case.flight.until(lambda: case.flight.flown[-1].outcome == "flown", "a slot that is flown")
    assert case.flight.command("land").accepted
    assert case.flight.wait() == 3


class Cut:
    """A link that is dead for `dead_s` of vehicle time from `since_s` on; HEARTBEATs take `silent_s` to be back."""

    def __init__(self, dead_s, silent_s):
        self.dead_s, self.silent_s, self.since_s, self.time_s = dead_s, silent_s, math.inf, 0.0

    def inward(self, datagram):
        kind = int.from_bytes(datagram[7:10], "little")
        if kind == mavlink.MAVLINK_MSG_ID_ATTITUDE:
            self.time_s = int.from_bytes(datagram[10:14], "little") / 1000
        lost_s = self.silent_s if kind == mavlink.MAVLINK_MSG_ID_HEARTBEAT else self.dead_s
        return () if 0.0 <= self.time_s - self.since_s < lost_s else (datagram,)

    def outward(self, datagram):
        return () if 0.0 <= self.time_s - self.since_s < self.dead_s else (datagram,)


@pytest.mark.parametrize(("dead_s", "silent_s"), [(2.0, 2.0), (1.2, 1.45)], ids=["dead", "heartbeats come last"])
def test_px4_would_give_itself_back_to_a_stream(sitl, fly, bridge_config, tmp_path, monkeypatch, dead_s, silent_s):
    """The stream was lost, the failsafe flies home, the link is back: nothing is sent, so OFFBOARD stays left."""
    cut = Cut(dead_s, silent_s)
    monkeypatch.setattr(node, "Link", partial(Link, tamper_in=cut.inward, tamper_out=cut.outward))

    def decide(opened):
        if opened.slot == 3:
            cut.since_s = opened.time_s
        return (0.2, 0.0, 0.0)

    flight = fly(bridge_config(sitl("--lockstep"), slots=300), decide, tlog=tmp_path / "flight.tlog")
    assert flight.wait() == 3
    assert any("telemetry is back" in text for text in flight.told("stall"))
    assert any("AUTO.RTL was chosen" in text for text in flight.told("mode"))
    log = read_log(tmp_path / "flight.tlog")
    home = heard_mode(log, CUSTOM["px4"]["return"])
    assert asked(log[home:]) == []
    flying = [m for i, m in of_vehicle(log, "HEARTBEAT") if i > home and m.base_mode & ARMED]
    assert all(m.custom_mode != OFFBOARD[m.autopilot] for m in flying)


def test_a_second_mode_of_the_pilots_while_control_is_taken_again(sitl, fly, bridge_config, tmp_path, monkeypatch):
    """To us both are just somebody else's; `resume` was for the first. Our asking is lost, so that he is in time."""
    autopilot, lost = sitl("--lockstep", "--personality", "arducopter"), []

    def out(frame):
        command = mavlink.MAVLink(None).decode(bytearray(frame))
        if lost and command.get_type() == "COMMAND_LONG" and command.command == mavlink.MAV_CMD_DO_SET_MODE:
            autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, 1, ALT_HOLD)
            return ()
        return (frame,)

    monkeypatch.setattr(node, "Link", partial(Link, tamper_out=out))
    tlog = tmp_path / "flight.tlog"
    flight = fly(bridge_config(autopilot, slots=2000), lambda opened: (0.2, 0.0, 0.0), tlog=tlog)
    flight.until_slot(2)
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, *MODES["arducopter"]["loiter"])
    flight.until_phase("yielded")
    lost.append("our asking")
    assert flight.command("resume").accepted
    flight.until(lambda: len(flight.told("mode")) == 2, "the second taking over")
    assert flight.phases[-1] == "yielded"
    lost.clear()
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, *MODES["arducopter"]["land"])
    assert flight.wait() == 3
    log = read_log(tlog)
    assert asked(log[heard_mode(log, ALT_HOLD) :]) == []
