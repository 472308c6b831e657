"""Whole flights at the envelope's edges: polygon and cylinder fences, the battery, yaw, the open loop."""

import math

import numpy as np
import pytest
from pymavlink import mavutil

from autopilot_bridge.energy import Endurance

SHAPES = [
    {"polygon": [(-14, -13), (30, -13), (30, 20), (12, 13), (-14, 13)], "altitude": (5, 20)},
    {"centre": (0, 0), "radius": 18, "altitude": (5, 20)},
]


@pytest.mark.parametrize("fence", SHAPES)
def test_an_agent_that_pushes_outward_stays_in_any_fence(sitl, fly, bridge_config, fence):
    box = {"x": (-10, 10), "y": (-10, 10), "z": (8, 16)}
    config = bridge_config(sitl("--lockstep"), slots=16, box=box, fence=fence)
    flight = fly(config, lambda opened: (8.0, 5.0, -2.0) if opened.slot < 8 else (-8.0, -5.0, 3.0))
    assert flight.wait() == 0
    points = np.array([track.position_enu for flown in flight.flown for track in flown.track])
    assert all(config.slot_fence.holds(point[None, :2]) for point in points)
    assert points[:, 2].min() > 5
    assert points[:, 2].max() < 20


def test_it_returns_when_the_battery_holds_just_the_way_home(sitl, fly, bridge_config):
    """A pack that is said to be so small that a few per cent of the real one are its last."""
    endurance = Endurance(pack_j=7e3, margin=0.3, return_altitude_m=12.0)
    autopilot = sitl("--lockstep", "--param", "BAT1_CAPACITY=700")
    flight = fly(bridge_config(autopilot, slots=1000, endurance=endurance), lambda opened: (0.5, 0.0, 0.0))
    assert flight.wait() == 3
    (why,) = flight.told("failsafe")
    assert "the way home needs" in why
    assert flight.phases[-1] == "returning"
    assert 3 < len(flight.flown) < 100


def test_a_battery_too_low_for_the_way_is_no_flight(sitl, fly, bridge_config):
    endurance = Endurance(pack_j=3e3, return_altitude_m=12.0)
    flight = fly(bridge_config(sitl("--lockstep"), endurance=endurance))
    assert flight.wait() == 1
    assert "arming" not in flight.phases
    assert "battery: 3.0 kJ are left, the way home from the start needs" in flight.told("error")[0]


def setpoint_yaws(path):
    log = mavutil.mavlink_connection(str(path))
    while (message := log.recv_match(type="SET_POSITION_TARGET_LOCAL_NED")) is not None:
        yield math.remainder(math.pi / 2 - message.yaw, math.tau)


def test_the_panel_faces_the_users(sitl, fly, bridge_config, tmp_path):
    config = bridge_config(sitl("--lockstep"), slots=6, face_enu=(0.0, 30.0))
    flight = fly(config, lambda opened: (1.5, 0.0, 0.0), tlog=tmp_path / "flight.tlog")
    assert flight.wait() == 0
    yaws = list(setpoint_yaws(tmp_path / "flight.tlog"))
    assert yaws[0] == pytest.approx(math.pi / 2, abs=0.1)
    opened = flight.slots[-1]
    east, north = np.subtract((0.0, 30.0), opened.position_enu[:2])
    assert yaws[-1] == pytest.approx(math.atan2(north, east), abs=0.1)
    assert opened.attitude_rad[2] == pytest.approx(yaws[-1], abs=0.15)  # and the vehicle turned there


def test_without_tracking_the_same_plan_is_flown_worse(sitl, fly, bridge_config):
    lost = {}
    for tracking in ("position", "none"):
        config = bridge_config(sitl("--lockstep"), slots=10, tracking=tracking)
        flight = fly(config, lambda opened: (4.0, 0.0, 0.0) if opened.slot < 3 else (0.0, 3.0, 0.0))
        assert flight.wait() == 0
        plan, track = flight.flown[-1].plan[-1], flight.flown[-1].track[-1]
        lost[tracking] = math.dist(plan.position_enu, track.position_enu)
    assert lost["none"] > 2 * lost["position"]
