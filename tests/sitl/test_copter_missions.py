"""Missions, fence, goto, sticks and attitudes on the ArduCopter personality, over real UDP."""

import math

import pytest
from pymavlink.dialects.v20 import development as mavlink

from sitl.arducopter.parameters import TABLE
from sitl.arducopter.sticks import climb_rate
from sitl.parameters import Parameters
from tests.sitl.copter import AUTO, GUIDED, LAND, LOITER, RTL, STABILIZE, copter
from tests.sitl.plans import (
    CHANGE_SPEED,
    DO_JUMP,
    LOITER_TIME,
    NAN,
    RETURN,
    TAKEOFF,
    WAYPOINT,
    download,
    item,
    message,
    order,
    upload,
)
from tests.sitl.plans import LAND as LAND_ITEM
from tests.sitl.test_geofence import CIRCLE_OUTSIDE, SQUARE
from tests.sitl.test_goto import reposition_int
from tests.sitl.test_setpoints import attitude
from tests.sitl.test_sticks import flown, push

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
ARM, DO_SET_MODE, START, PAUSE = 400, 176, 300, 193
HOME = item(WAYPOINT, 0.0, 0.0, 489.4, frame=0)
FLIGHT = [HOME, item(TAKEOFF, up=8.0), item(WAYPOINT, 20.0, 0.0, 10.0), item(WAYPOINT, 20.0, 15.0, 10.0)]


@pytest.fixture
def ready():
    with copter() as vehicle:
        vehicle.boot()
        yield vehicle


@pytest.fixture
def hovering_copter():
    with copter() as vehicle:
        vehicle.take_off(10.0)
        yield vehicle


def reached(vehicle):
    return [m.seq for m in vehicle.messages if m.get_type() == "MISSION_ITEM_REACHED"]


def start(vehicle, plan):
    assert upload(vehicle, plan) == ACCEPTED
    assert vehicle.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    assert vehicle.command(ARM, 1) == ACCEPTED
    assert vehicle.command(START) == ACCEPTED


def near(vehicle, place, distance=2.2):
    return math.dist(vehicle.position, (place[0], place[1], -place[2])) < distance


# Missions


def test_item_0_is_home(ready):
    """ArduPilot keeps home at 0: what was uploaded there comes back as home."""
    elsewhere = [item(WAYPOINT, 500.0, 500.0, 30.0), *FLIGHT[1:]]
    assert upload(ready, elsewhere) == ACCEPTED
    back = download(ready)
    assert len(back) == 4
    assert back[0][:2] == (0, WAYPOINT)
    assert back[0][3:5] == pytest.approx(HOME[3:5], abs=2)
    assert back[0][5] == pytest.approx(489.4, abs=0.1)
    assert {i[0] for i in back[1:]} == {3}  # MAV_FRAME_GLOBAL_RELATIVE_ALT
    assert ready.command(512, 42) == ACCEPTED
    assert ready.latest["MISSION_CURRENT"].total == 3  # home is not counted
    ready.send(mavlink.MAVLink_param_request_read_message(1, 1, b"MIS_TOTAL", -1))
    ready.advance()
    assert ready.latest["PARAM_VALUE"].param_value == 4.0  # here it is


def test_auto_without_a_mission_fails(ready):
    """AUTOPILOT.md 3: FAILED: AUTO without mission. Home alone is none."""
    assert ready.command(DO_SET_MODE, 1, AUTO) == FAILED
    assert ready.command(512, 42) == ACCEPTED
    assert (ready.latest["MISSION_CURRENT"].total, ready.latest["MISSION_CURRENT"].mission_state) == (65535, 1)
    assert upload(ready, [HOME]) == ACCEPTED
    assert ready.command(DO_SET_MODE, 1, AUTO) == FAILED


def test_second_upload_is_denied(ready):
    ready.send(mavlink.MAVLink_mission_count_message(1, 1, 2, 0))
    ready.advance(20)
    ready.mav.srcComponent = 42
    ready.send(mavlink.MAVLink_mission_count_message(1, 1, 3, 0))
    ready.advance(20)
    assert (ready.latest["MISSION_ACK"].type, ready.latest["MISSION_ACK"].target_component) == (14, 42)
    ready.mav.srcComponent = 191
    for seq in range(2):
        ready.send(message(seq, FLIGHT[seq]))
        ready.advance(20)
    assert ready.latest["MISSION_ACK"].type == 0
    assert upload(ready, FLIGHT[:1] * 10_000) == 4  # NO_SPACE


def test_mission_flies_and_stays_in_auto(ready):
    """AUTOPILOT.md 1: AUTO 3; progress by MISSION_ITEM_REACHED. At the end ArduCopter stays in AUTO and holds."""
    start(ready, FLIGHT)
    ready.until(lambda: near(ready, (20, 0, 10)), 60)
    ready.until(lambda: near(ready, (20, 15, 10)), 60)
    ready.fly(10)
    assert reached(ready) == [1, 2, 3]
    assert ready.mode == AUTO
    assert ready.position == pytest.approx((20, 15, -10), abs=0.5)
    assert ready.armed


def test_a_mission_without_takeoff_is_refused_on_the_ground(ready):
    assert upload(ready, [HOME, item(WAYPOINT, 10.0, 0.0, 10.0)]) == ACCEPTED
    assert ready.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    assert ready.command(ARM, 1) == ACCEPTED
    assert ready.command(START) == FAILED
    assert "Auto: Missing Takeoff Cmd" in ready.texts()


def test_auto_waits_on_the_ground_for_mission_start(ready):
    """Without a raised throttle AUTO does not leave the ground; MISSION_START lets it (auto_armed)."""
    assert upload(ready, FLIGHT) == ACCEPTED
    assert ready.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    assert ready.command(ARM, 1) == ACCEPTED
    assert ready.command(DO_SET_MODE, 1, AUTO) == ACCEPTED
    ready.fly(5)
    assert ready.position[2] == 0.0
    assert ready.command(START, 1, 0) == DENIED
    assert ready.command(START) == ACCEPTED
    ready.until(lambda: ready.position[2] < -3, 15)


def test_auto_is_armable_by_option_only():
    with copter() as vehicle:
        vehicle.boot()
        assert upload(vehicle, FLIGHT) == ACCEPTED
        assert vehicle.command(DO_SET_MODE, 1, AUTO) == ACCEPTED
        assert vehicle.command(ARM, 1) == FAILED
        assert "Arm: AUTO mode not armable" in vehicle.texts()
    with copter(AUTO_OPTIONS=3) as vehicle:
        vehicle.boot()
        assert upload(vehicle, FLIGHT) == ACCEPTED
        assert vehicle.command(DO_SET_MODE, 1, AUTO) == ACCEPTED
        assert vehicle.command(ARM, 1) == ACCEPTED
        vehicle.until(lambda: near(vehicle, (20, 0, 10)), 60)


def test_speed_hold_jump_and_return(ready):
    start(
        ready,
        [HOME, item(TAKEOFF, up=6.0), order(CHANGE_SPEED, 1, 3.0), item(WAYPOINT, 25.0, 0.0, 6.0),
         item(LOITER_TIME, 25.0, 0.0, 6.0, p=(3.0, 0.0, 0.0, NAN)), order(DO_JUMP, 3, 1), order(RETURN)],
    )  # fmt: skip
    ready.until(lambda: ready.position[0] > 12, 60)
    assert ready.velocity[0] == pytest.approx(3.0, abs=0.3)
    assert ready.command(CHANGE_SPEED, 1, 5.0) == ACCEPTED
    ready.until(lambda: ready.velocity[0] > 4.0, 5)
    ready.until(lambda: not ready.armed, 120)
    assert reached(ready)[:4] == [1, 3, 4, 3]  # told of what is flown, not of orders
    assert ready.mode == AUTO  # RETURN_TO_LAUNCH in a mission does not change the mode
    assert ready.position == pytest.approx((0, 0, 0), abs=0.5)


def test_mission_lands_and_disarms(ready):
    start(ready, [HOME, item(TAKEOFF, up=5.0), item(LAND_ITEM, 6.0, 3.0, 0.0)])
    ready.until(lambda: not ready.armed, 90)
    assert ready.position == pytest.approx((6, 3, 0), abs=0.5)


def test_pause_and_continue(ready):
    """DO_PAUSE_CONTINUE brakes inside AUTO."""
    start(ready, [HOME, item(TAKEOFF, up=6.0), item(WAYPOINT, 60.0, 0.0, 6.0)])
    assert ready.command(PAUSE, 2) == DENIED
    ready.until(lambda: ready.position[0] > 15, 60)
    assert ready.command(PAUSE, 0) == ACCEPTED
    ready.fly(8)
    held = ready.position
    assert math.hypot(*ready.velocity) < 0.2
    assert ready.mode == AUTO
    ready.fly(3)
    assert ready.position == pytest.approx(held, abs=0.2)
    assert ready.command(PAUSE, 1) == ACCEPTED
    ready.until(lambda: near(ready, (60, 0, 6)), 30)
    assert ready.command(DO_SET_MODE, 1, LOITER) == ACCEPTED
    assert ready.command(PAUSE, 0) == FAILED


# Fence and goto


def fenced(**parameters):
    return copter(FENCE_ENABLE=1, **parameters)


def test_destinations_outside_the_fence_are_naked():
    """AUTOPILOT.md 3: fence violations of destinations are NAKed."""
    with fenced(FENCE_RADIUS=30.0, FENCE_ALT_MAX=20.0) as vehicle:
        vehicle.take_off(10.0)
        assert reposition_int(vehicle, 60.0, 0.0, 499.4) == DENIED
        assert reposition_int(vehicle, 5.0, 0.0, 489.4 + 30) == DENIED
        assert reposition_int(vehicle, 8.0, 0.0, 489.4 + 12) == ACCEPTED
        vehicle.fly(12)
        assert vehicle.position == pytest.approx((8.0, 0.0, -12.0), abs=0.5)
        assert vehicle.mode == GUIDED


@pytest.mark.parametrize("speed", [2.0, 8.0])
def test_velocity_is_only_bent(speed):
    """AUTOPILOT.md 3: ... velocity only bent: it stops before the fence and slides along it."""
    with fenced(FENCE_RADIUS=30.0) as vehicle:
        vehicle.take_off(10.0)
        vehicle.stream(20, speed, 0.0, 0.0)
        assert vehicle.position[0] < 29.0
        assert vehicle.position[0] > 22.0
        assert vehicle.mode == GUIDED
        vehicle.stream(3, speed, 2.0, 0.0)
        assert vehicle.position[1] > 1.0


@pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, RTL), (2, LAND)])
def test_breach(action, mode):
    """FENCE_ACTION, with avoidance off (AVOID_ENABLE 0)."""
    with fenced(FENCE_RADIUS=30.0, FENCE_ACTION=action, AVOID_ENABLE=0) as vehicle:
        vehicle.take_off(10.0)
        vehicle.until(lambda: vehicle.position[0] > 31, 30, lambda: vehicle.setpoint(6.0, 0.0, 0.0))
        vehicle.fly(2)
        assert vehicle.mode == mode
        assert any("fence breached" in text for text in vehicle.texts())


def test_uploaded_areas_and_fence_enable(hovering_copter):
    """DO_FENCE_ENABLE; the areas act once it is on. All inclusion areas must hold."""
    vehicle = hovering_copter
    hole = [item(CIRCLE_OUTSIDE, 8.0, 0.0, 0.0, p=(3.0, 0.0, 0.0, 0.0), frame=0)]
    assert upload(vehicle, SQUARE + hole, kind=1) == ACCEPTED
    assert len(download(vehicle, kind=1)) == 5
    assert vehicle.command(207, 1) == ACCEPTED
    assert reposition_int(vehicle, 8.0, 0.0, 499.4) == DENIED
    assert reposition_int(vehicle, 20.0, 0.0, 499.4) == DENIED
    assert reposition_int(vehicle, -8.0, 0.0, 499.4) == ACCEPTED
    assert vehicle.command(207, 0) == ACCEPTED
    assert reposition_int(vehicle, 20.0, 0.0, 499.4) == ACCEPTED


def test_a_guided_mission_item_is_flown_to(hovering_copter):
    """MISSION_ITEM with current = 2, as MAVProxy's `guided` sends it; the mission stays as it is."""
    vehicle = hovering_copter
    assert upload(vehicle, FLIGHT) == ACCEPTED
    vehicle.send(message(0, item(WAYPOINT, 6.0, -3.0, 12.0), current=2, integer=False))
    vehicle.advance(50)
    assert vehicle.latest["MISSION_ACK"].type == 0
    vehicle.fly(12)
    assert vehicle.position == pytest.approx((6.0, -3.0, -12.0), abs=0.6)  # float32 degrees
    assert vehicle.mode == GUIDED
    assert len(download(vehicle)) == 4
    vehicle.send(message(0, item(TAKEOFF, 6.0, -3.0, 12.0), current=2))
    vehicle.advance(50)
    assert vehicle.latest["MISSION_ACK"].type == UNSUPPORTED


# Sticks


def test_loiter_by_sticks_and_back_to_the_simulated_radio(hovering_copter):
    vehicle = hovering_copter
    push(vehicle)
    assert vehicle.command(DO_SET_MODE, 1, LOITER) == ACCEPTED
    flown(vehicle, 4.0, forward=0.5)
    assert vehicle.velocity[0] > 3.0
    assert vehicle.position[2] == pytest.approx(-10, abs=0.6)
    flown(vehicle, 3.0, throttle=0.9)
    assert vehicle.velocity[2] == pytest.approx(-2.5 * (0.8 - 0.1) / 0.9, abs=0.3)  # PILOT_SPEED_UP
    vehicle.fly(8)  # no sticks: RC_OVERRIDE_TIME 3 s, then the radio's, in the middle
    place = vehicle.position
    vehicle.fly(3)
    assert vehicle.position == pytest.approx(place, abs=0.3)
    assert vehicle.mode == LOITER


def test_throttle_stick_to_climb_rate():
    """PILOT_SPEED_UP and PILOT_SPEED_DN (0: as up) beyond THR_DZ."""
    p = Parameters(TABLE)
    assert [climb_rate(stick, p) for stick in (-1.0, -0.55, -0.1, 0.0, 0.1, 0.55, 1.0)] == pytest.approx(
        [-2.5, -1.25, 0.0, 0.0, 0.0, 1.25, 2.5]
    )
    p.set("PILOT_SPEED_DN", 100.0)
    assert climb_rate(-1.0, p) == pytest.approx(-1.0)
    assert climb_rate(1.0, p) == pytest.approx(2.5)


def test_takeoff_and_landing_by_sticks_in_stabilize(ready):
    """RC_CHANNELS_OVERRIDE in STABILIZE: throttle is thrust, sticks are a lean."""

    def radio(throttle, pitch=1500):
        ready.send(mavlink.MAVLink_rc_channels_override_message(1, 1, 1500, pitch, throttle, 1500, 0, 0, 0, 0))

    assert ready.command(DO_SET_MODE, 1, STABILIZE) == ACCEPTED
    radio(1100)
    assert ready.command(ARM, 1) == ACCEPTED
    ready.fly(3, lambda: radio(1650))
    assert ready.position[2] < -2.0
    ready.fly(2, lambda: radio(1500, pitch=1300))
    assert ready.latest["ATTITUDE"].pitch == pytest.approx(-math.radians(30) * (0.5 - 0.05) / 0.95, abs=0.06)
    assert ready.velocity[0] > 2.0
    ready.until(lambda: not ready.armed, 60, lambda: radio(1400 if ready.position[2] < -0.2 else 1100))
    assert ready.position[2] == 0.0


def test_guided_attitude_climbs_by_thrust_and_times_out(hovering_copter):
    """SET_ATTITUDE_TARGET in GUIDED: thrust 0.5 holds the height (GUID_OPTIONS bit 3 clear)."""
    vehicle = hovering_copter
    lean = math.radians(-10)
    vehicle.fly(4, lambda: attitude(vehicle, 0.0, lean, 0.0, 0.5))
    assert vehicle.latest["ATTITUDE"].pitch == pytest.approx(lean, abs=0.03)
    assert vehicle.position[2] == pytest.approx(-10, abs=0.8)
    assert vehicle.velocity[0] > 2.0
    vehicle.fly(4, lambda: attitude(vehicle, 0.0, 0.0, 0.0, 0.75))
    assert vehicle.velocity[2] == pytest.approx(-1.25, abs=0.2)  # half of WPNAV_SPEED_UP
    vehicle.fly(9)
    assert math.hypot(*vehicle.velocity) < 0.3
    assert vehicle.mode == GUIDED
