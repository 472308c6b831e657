"""Whole flights: a real SITL process, real UDP, a real zenoh session."""

import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge import flight as flight_module
from autopilot_bridge import mavlink_vehicle
from autopilot_bridge.clock import Lockstep
from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.link import Link
from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle
from autopilot_bridge.vehicle import Mode
from bus import topics

PATIENT = ("--param", "COM_OF_LOSS_T=10")
"""So that a busy machine's stalls, many times as long at speed, do not pass for a lost stream."""
AUTO_LOITER, AUTO_RTL, AUTO_LAND = (1, 4, 3), (1, 4, 5), (1, 4, 6)


def random_moves(seed, count, v_max):
    """Evenly in direction and in length."""
    rng = np.random.default_rng(seed)
    moves = []
    for _ in range(count):
        length, sine, azimuth = v_max * rng.random(), rng.uniform(-1, 1), rng.uniform(0, 2 * math.pi)
        across = length * math.sqrt(1 - sine**2)
        moves.append((across * math.cos(azimuth), across * math.sin(azimuth), length * sine))
    return moves


def to_and_fro(opened):
    """Short moves at a pace that a test's commands can keep up with."""
    time.sleep(0.02)
    return (0.2 if opened.slot % 2 else -0.2, 0.0, 0.0)


def read_log(path):
    log = mavutil.mavlink_connection(str(path))
    messages = []
    while (message := log.recv_match()) is not None:
        messages.append(message)
    return messages


def test_flies_as_planned(sitl, fly, bridge_config, tmp_path):
    autopilot = sitl("--lockstep")
    moves = [(1.5, 0.0, 0.0), (2.0, 1.0, 0.3), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)]
    flight = fly(bridge_config(autopilot), lambda opened: moves[opened.slot], tlog=tmp_path / "flight.tlog")
    assert flight.wait() == 0
    assert flight.phases == [
        "connecting",
        "preflight",
        "ready",
        "arming",
        "takeoff",
        "transit",
        "slots",
        "landing",
    ]
    assert flight.events[-1].kind == "ended"
    assert flight.events[-1].exit_code == 0
    assert autopilot.process.wait(10) == 0  # was told to quit

    assert [o.slot for o in flight.slots] == [0, 1, 2, 3, 4]
    assert [o.closing for o in flight.slots] == [False] * 4 + [True]
    assert np.diff([o.time_s for o in flight.slots]) == pytest.approx([1.0] * 4)
    assert flight.slots[0].position_enu == pytest.approx((0, 0, 12), abs=0.31)
    for before, after, move in zip(flight.slots, flight.slots[1:], moves, strict=False):
        flown = after.flown
        assert flown.commanded_enu == move
        assert len(flown.track) == len(flown.plan) == 10
        assert flown.track[0].position_enu == before.position_enu
        assert flown.flown_enu == pytest.approx(np.subtract(after.position_enu, before.position_enu), abs=1e-9)
    *states, last = flight.states
    assert (states[-1].phase, last.phase, last.armed, last.landed) == ("landing", "ended", False, True)
    stamps = np.array([state.time_s for state in states])
    assert np.diff(stamps) == pytest.approx(np.full(len(stamps) - 1, 0.1))

    assert any("COM_OBL_RC_ACT was 0" in text and "set to 3" in text for text in flight.told("parameter"))

    log = read_log(tmp_path / "flight.tlog")
    setpoints = [m for m in log if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    assert {m.type_mask for m in setpoints} == {2503}
    assert {round(m.yaw, 6) for m in setpoints} == {round(math.pi / 2, 6)}  # the panel faces east
    spacing = np.diff([m._timestamp for m in setpoints])
    assert spacing == pytest.approx(np.full(len(spacing), 0.05), abs=1e-5)
    assert len({m.get_srcSystem() for m in log}) > 1  # both directions


def test_the_same_flight_twice(sitl, fly, bridge_config):
    moves = random_moves(seed=3, count=6, v_max=5.0)
    flights = []
    for _ in range(2):
        flight = fly(bridge_config(sitl("--lockstep"), slots=6), lambda opened: moves[opened.slot])
        assert flight.wait() == 0
        flights.append(flight)
    assert flights[0].slots == flights[1].slots
    # `state` may drop: what both heard must agree
    first, second = ({s.time_s: s for s in flight.states} for flight in flights)
    assert all(first[t] == second[t] for t in first.keys() & second.keys())


@pytest.mark.parametrize(("v_max", "rms_m"), [(5.0, 0.8), (10.0, 1.2)])
def test_tracks_random_slots(sitl, fly, bridge_config, v_max, rms_m):
    """Issue 5's bounds for 60 random slots, with SIH's drag."""
    moves = random_moves(seed=1, count=60, v_max=v_max)
    config = bridge_config(
        sitl("--lockstep"),
        slots=60,
        v_max_mps=v_max,
        start_position_enu=(0, 0, 60),
        box={"x": (-100, 100), "y": (-100, 100), "z": (30, 120)},
    )
    flight = fly(config, lambda opened: moves[opened.slot])
    assert flight.wait() == 0
    error = [
        np.subtract(track.position_enu, plan.position_enu)
        for flown in flight.flown
        for track, plan in zip(flown.track, flown.plan, strict=True)
    ]
    assert np.sqrt(np.mean(np.sum(np.square(error), axis=1))) <= rms_m


def test_an_agent_that_pushes_outward_never_leaves_the_fence(sitl, fly, bridge_config):
    box = {"x": (-10, 10), "y": (-10, 10), "z": (8, 16)}
    config = bridge_config(sitl("--lockstep"), slots=20, box=box)
    flight = fly(config, lambda opened: (8.0, 5.0, -2.0) if opened.slot < 10 else (-8.0, -5.0, 3.0))
    assert flight.wait() == 0
    points = np.array([track.position_enu for flown in flight.flown for track in flown.track])
    low, high = np.array(config.slot_fence.spans).T
    assert (points >= low).all()
    assert (points <= high).all()
    plans = np.array([plan.position_enu for flown in flight.flown for plan in flown.plan])
    low, high = np.array(config.box.spans).T
    assert (plans >= low - 1e-3).all()
    assert (plans <= high + 1e-3).all()
    assert any("box" in flown.reasons for flown in flight.flown)


def test_a_silent_agent_is_waited_for_held_for_and_left(sitl, fly, bridge_config):
    config = bridge_config(sitl("--lockstep"), slots=30, grace_s=3.0, action_wait_wall_s=0.1)
    flight = fly(config, lambda opened: (1.0, 0.0, 0.0) if opened.slot < 2 else None)
    assert flight.wait() == 3
    outcomes = [flown.outcome for flown in flight.flown]
    assert outcomes[:2] != ["missing", "missing"]
    assert outcomes[2:] == ["missing"] * len(outcomes[2:])
    assert flight.phases[-2:] == ["holding", "returning"]
    assert flight.told("failsafe") == ["no good action for 3 s"]
    assert np.linalg.norm(flight.slots[-1].velocity_enu) < 0.5  # it held


def test_a_dead_agent_is_not_waited_for_when_nobody_restarts_it(sitl, fly, bridge_config):
    config = bridge_config(
        sitl("--lockstep"), slots=30, grace_s=3.0, action_wait_wall_s=60.0, await_restart=False, autostart=False
    )
    flight = fly(config, lambda opened: (1.0, 0.0, 0.0) if opened.slot < 2 else None)
    agent, mission = (topics.declare_alive(flight.ground, "test", node) for node in ("agent", "mission"))
    flight.until_phase("ready")
    assert flight.command("start").accepted
    flight.until_slot(2)
    mission.undeclare()  # the loop outlives it
    agent.undeclare()
    assert flight.wait(timeout_s=40) == 3
    assert "agent node is gone" in flight.told("node_lost")


def test_bad_and_missing_actions_are_held_and_the_next_good_one_is_flown(sitl, fly, bridge_config, make_action):
    moves = {0: (math.nan, 0, 0), 1: (math.inf, 0, 0), 2: (11.0, 0, 0), 3: (1.0, 0, 0), 4: None, 5: (0.5, 0, 0)}

    def decide(opened):
        move = moves[opened.slot]
        return None if move is None else make_action(opened.slot, move)

    flight = fly(bridge_config(sitl("--lockstep"), slots=6, action_wait_wall_s=1.0), decide)
    assert flight.wait() == 0
    assert [flown.outcome for flown in flight.flown] == ["rejected"] * 3 + ["flown", "missing", "flown"]
    assert [flown.reasons for flown in flight.flown[:2]] == [["malformed action"]] * 2
    assert "at most 10 m" in flight.flown[2].reasons[0]
    assert [flown.commanded_enu for flown in flight.flown[:3]] == [(0.0, 0.0, 0.0)] * 3
    expected = {"refused agent/action": 2, "slots_rejected": 3, "slots_missing": 1, "slots_flown": 2}
    flight.until(lambda: expected.items() <= flight.healths[-1].counters.items(), "the last counters")


def test_start_hold_and_resume(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep"), slots=60, autostart=False), to_and_fro)
    flight.until_phase("ready")
    assert "nothing to hold in phase ready" in flight.command("hold").reason
    assert "nothing to resume" in flight.command("resume").reason
    assert "arming" not in flight.phases
    assert flight.command("start").accepted
    flight.until_slot(5)
    assert flight.command("start").reason == "already started"
    assert flight.command("hold").accepted
    flight.until_phase("holding")
    reached = flight.slots[-1].slot
    flight.until_slot(reached + 4)
    assert flight.command("resume").accepted
    assert flight.wait() == 0
    held = [flown for flown in flight.flown if flown.outcome == "rejected"]
    assert held
    assert {reason for flown in held for reason in flown.reasons} == {"held by command"}
    assert flight.flown[-1].outcome == "flown"


def test_returns_when_told_in_the_slots(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep"), slots=1000), to_and_fro)
    flight.until_slot(3)
    assert flight.command("return").accepted
    assert flight.wait() == 3
    assert flight.phases[-1] == "returning"
    assert flight.states[-1].landed


def test_lands_when_told_on_the_way_to_the_start(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep"), start_position_enu=(0, 0, 39)))
    flight.until_phase("transit")
    assert flight.command("land").accepted
    assert flight.wait() == 3
    assert flight.phases[-1] == "landing"
    assert "slots" not in flight.phases


def test_a_land_before_the_start_ends_it_on_the_ground(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep", "--param", "COM_OBL_RC_ACT=4"), autostart=False))
    flight.until_phase("ready")
    told = flight.told("parameter")
    assert not any(
        "COM_OBL_RC_ACT" in text for text in told
    )  # landing on the loss of our stream is safe: left as it is
    assert flight.command("land").accepted
    assert flight.wait() == 3
    assert "arming" not in flight.phases


def test_a_pilot_who_brings_it_home_ends_the_flight(sitl, fly, bridge_config):
    autopilot = sitl("--lockstep")
    flight = fly(bridge_config(autopilot, slots=1000), to_and_fro)
    flight.until_slot(3)
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, *AUTO_RTL)
    assert flight.wait() == 3
    assert flight.phases[-1] == "yielded"
    assert flight.states[-1].landed
    assert any("disarmed" in text for text in flight.told("failsafe"))


def test_a_refusal_to_arm_is_shown(sitl, fly, bridge_config, monkeypatch):
    monkeypatch.setattr(mavlink_vehicle, "ARMABLE_S", 5.0)
    autopilot = sitl("--lockstep", "--param", "BAT1_CAPACITY=1")
    link = Link(f"udpin://127.0.0.1:{autopilot.port}", 1)
    clock = Lockstep(autopilot.control, 50)
    vehicle = PymavlinkVehicle(link, dialects("px4"), 1, clock, lambda: clock.step(vehicle))
    vehicle.connect()
    vehicle.await_armable()
    vehicle.arm()
    vehicle.takeoff(2.0)  # empties the battery
    vehicle.set_mode(Mode.LAND)
    while vehicle.telemetry.armed:
        clock.step(vehicle)
    clock.close(over=False)
    vehicle.close()

    flight = fly(bridge_config(autopilot))
    assert flight.wait() == 1
    (error,) = flight.told("error")
    assert "arm: TEMPORARILY_REJECTED" in error
    assert "Arming denied: low battery" in error


def test_no_setpoint_is_sent_once_a_pilots_mode_can_be_known(sitl, fly, bridge_config, tmp_path):
    """Counted from the autopilot's own word at the pilot's command, not from the HEARTBEAT that we act on."""
    autopilot = sitl("--lockstep")
    flight = fly(bridge_config(autopilot, slots=1000), to_and_fro, tlog=tmp_path / "flight.tlog")
    flight.until_slot(3)
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, *AUTO_LAND)
    assert flight.wait() == 3
    log = read_log(tmp_path / "flight.tlog")
    (taken,) = (m._timestamp for m in log if m.get_type() == "STATUSTEXT" and "Landing at current" in m.text)
    last = max(m._timestamp for m in log if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED")
    assert last - taken < 0.2


def test_a_hold_is_taken_also_while_held_for_lack_of_an_action(sitl, fly, bridge_config):
    silent = True

    def decide(opened):
        return None if silent and opened.slot > 1 else (1.0, 0.0, 0.0)

    flight = fly(bridge_config(sitl("--lockstep"), slots=1000, action_wait_wall_s=0.1, grace_s=600.0), decide)
    flight.until_phase("holding")
    assert flight.command("hold").accepted
    silent = False
    flight.until(lambda: flight.flown[-1].reasons == ["held by command"], "an action that is not flown")
    assert flight.command("land").accepted
    assert flight.wait() == 3
    assert {flown.outcome for flown in flight.flown[2:]} == {"missing", "rejected"}


def test_a_pilot_is_obeyed_until_resume(sitl, fly, bridge_config, tmp_path):
    autopilot = sitl("--lockstep")
    flight = fly(bridge_config(autopilot, slots=60), to_and_fro, tlog=tmp_path / "flight.tlog")
    flight.until_slot(3)
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, *AUTO_LOITER)
    flight.until_phase("yielded")
    yielded = flight.slots[-1].slot
    flight.until_slot(yielded + 5)
    assert flight.command("resume").accepted
    assert flight.wait() == 0
    reasons = {reason for flown in flight.flown for reason in flown.reasons if flown.outcome == "rejected"}
    assert reasons == {"control yielded to AUTO.LOITER"}

    log = read_log(tmp_path / "flight.tlog")
    offboard = None
    taken = 0
    for message in log:
        if message.get_type() == "HEARTBEAT" and message.get_srcSystem() == 1:
            was, offboard = offboard, message.custom_mode == 6 << 16
            taken += bool(was and not offboard)
        if taken == 1 and message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            resumed = message._timestamp
            break
        if taken == 1 and was and not offboard:
            released, was = message._timestamp, False
    assert resumed - released > 4.0  # no setpoint between the pilot's mode and `resume`


def test_a_pilot_during_takeoff_is_obeyed(sitl, fly, bridge_config):
    autopilot = sitl("--lockstep")
    flight = fly(
        bridge_config(autopilot, takeoff_altitude_m=80, box={"x": (-50, 50), "y": (-50, 50), "z": (8, 90)})
    )  # long enough to be met in it
    flight.until(lambda: "Takeoff detected" in "".join(flight.told("statustext")), "the takeoff")
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, *AUTO_LAND)
    assert flight.wait() == 3
    assert "transit" not in flight.phases


def test_plans_inside_the_autopilots_limits(sitl, fly, bridge_config):
    autopilot = sitl("--lockstep")
    config = bridge_config(autopilot, slots=8, parameters={"MPC_XY_VEL_MAX": 2.0})
    flight = fly(config, lambda opened: (5.0, 0.0, 0.0))
    assert flight.wait() == 0
    assert "MPC_XY_VEL_MAX was 12: set to 2" in flight.told("parameter")
    speeds = [np.hypot(*plan.velocity_enu[:2]) for flown in flight.flown for plan in flown.plan]
    assert max(speeds) == pytest.approx(2.0)
    assert "speed" in flight.flown[-1].reasons


def test_an_autopilot_that_never_answers_is_told(fly, bridge_config, sitl, monkeypatch):
    monkeypatch.setattr(mavlink_vehicle, "CONNECT_WALL_S", 0.3)
    autopilot = sitl("--lockstep")
    config = bridge_config(autopilot, clock={"kind": "paced"})  # nobody advances it
    flight = fly(config)
    assert flight.wait() == 1
    assert "never answered (no HEARTBEAT" in flight.told("error")[0]
    assert config.autopilot in flight.told("error")[0]


def test_a_foreign_system_is_not_taken_for_ours(fly, bridge_config, sitl, monkeypatch):
    monkeypatch.setattr(mavlink_vehicle, "CONNECT_WALL_S", 0.5)
    flight = fly(bridge_config(sitl("--lockstep", "--system-id", "7")))
    assert flight.wait() == 1
    assert "no HEARTBEAT of system 1" in flight.told("error")[0]


def test_a_sitl_that_dies_is_told(sitl, fly, bridge_config):
    autopilot = sitl("--lockstep")
    flight = fly(bridge_config(autopilot, slots=1000))
    flight.until_slot(2)
    autopilot.process.kill()
    assert flight.wait() == 1
    assert "control 127.0.0.1" in flight.told("error")[0]


def test_a_mission_that_goes_before_the_start_ends_it(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep"), autostart=False))
    token = topics.declare_alive(flight.ground, "test", "mission")
    flight.until_phase("ready")
    time.sleep(0.2)
    token.undeclare()
    assert flight.wait() == 1
    assert "the mission is gone before the start" in flight.told("error")[0]


def test_paced(sitl, fly, bridge_config):
    moves = [(1.0, 0.0, 0.0), (1.0, 0.0, 0.0), None, (-1.0, 0.0, 0.0), (0.0, 0.5, 0.0)]
    config = bridge_config(sitl("--speed", "8", *PATIENT), clock={"kind": "paced", "speed": 8.0}, slots=5)
    flight = fly(config, lambda opened: moves[opened.slot])
    assert flight.wait() == 0
    assert np.diff([o.time_s for o in flight.slots]) == pytest.approx(np.ones(5))
    assert flight.flown[2].outcome == "missing"
    # on a busy machine an action may be late, but then it must be told so and not be flown
    for flown, move in zip(flight.flown, moves, strict=True):
        assert flown.commanded_enu == (move if flown.outcome in ("flown", "clipped") else (0.0, 0.0, 0.0))


def test_late_actions_are_told_apart_from_missing_ones(sitl, fly, bridge_config, make_action):
    flight = None

    def late(opened):
        if opened.slot == 1:
            flight.until(lambda: flight.states[-1].time_s > opened.time_s + 0.4, "half a slot")
        return (0.5, 0.0, 0.0)

    config = bridge_config(
        sitl("--speed", "10", *PATIENT), clock={"kind": "paced", "speed": 10.0}, slots=3, autostart=False
    )
    flight = fly(config, late)
    flight.until_phase("ready")
    flight.command("start")
    assert flight.wait() == 0
    assert flight.flown[1].outcome == "late"
    assert flight.flown[1].planned_enu != (0.5, 0.0, 0.0)


def test_a_dead_link_is_left_to_the_autopilot(sitl, fly, bridge_config, monkeypatch):
    monkeypatch.setattr(flight_module, "LINK_BACK_WALL_S", 0.5)
    autopilot = sitl("--speed", "10", *PATIENT)
    flight = fly(bridge_config(autopilot, clock={"kind": "paced", "speed": 10.0}, slots=1000))
    flight.until_slot(1)
    autopilot.process.kill()
    assert flight.wait() == 1
    assert any("no telemetry for 3 s" in text for text in flight.told("failsafe"))


def test_a_frozen_autopilot_that_comes_back_is_obeyed(sitl, fly, bridge_config):
    """Frozen for longer than the silence: on waking it has lost our stream and flies its own failsafe home."""
    autopilot = sitl("--speed", "10", *PATIENT)
    flight = fly(bridge_config(autopilot, clock={"kind": "paced", "speed": 10.0}, slots=1000))
    flight.until_slot(1)
    autopilot.process.send_signal(signal.SIGSTOP)
    flight.until_phase("yielded")
    autopilot.process.send_signal(signal.SIGCONT)
    assert flight.wait() == 3
    assert flight.states[-1].landed


def test_a_port_in_use_is_told(sitl, fly, bridge_config):
    autopilot = sitl("--lockstep")
    first = fly(bridge_config(autopilot, autostart=False))
    first.until_phase("ready")
    second = fly(bridge_config(autopilot))
    assert second.wait() == 1
    assert "cannot listen there" in second.told("error")[0]
    assert first.command("land").accepted
    assert first.wait() == 3


def test_ctrl_c_lands(sitl, bridge_config, tmp_path):
    config = bridge_config(sitl("--lockstep"), slots=100000)
    program = """
import sys
from pathlib import Path
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.node import run
from bus.session import open_session
session = open_session()
code = run(BridgeConfig.model_validate_json(sys.argv[1]), "test", session, Path(sys.argv[2]))
session.close()
sys.exit(code)
"""
    config = config.model_copy(update={"action_wait_wall_s": 0.05, "grace_s": 3600.0})
    process = subprocess.Popen(
        [sys.executable, "-c", program, config.model_dump_json(), str(tmp_path / "flight.tlog")],
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    for line in process.stdout:
        if "phase: slots" in line:
            break
    process.send_signal(signal.SIGINT)
    rest = process.stdout.read()
    assert process.wait(60) == 3
    assert "phase: landing" in rest
    assert any(m.get_type() == "STATUSTEXT" for m in read_log(tmp_path / "flight.tlog"))
