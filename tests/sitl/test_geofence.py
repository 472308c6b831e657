"""The geofence on PX4: limits by parameters, uploaded areas, what happens at a breach. Over real UDP."""

import math

import pytest

from tests.sitl.client import direct
from tests.sitl.plans import NAN, TAKEOFF, WAYPOINT, download, item, upload
from tests.sitl.test_goto import reposition_int

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
INCLUSION, EXCLUSION, CIRCLE_INSIDE, CIRCLE_OUTSIDE = 5001, 5002, 5003, 5004
LOITER, RTL, LANDING, OFFBOARD = (4, 3), (4, 5), (4, 6), (6, 0)
NONE, WARN, HOLD, RETURN, TERMINATE, LAND = range(6)


def area(command, corners):
    return [item(command, n, e, 0.0, p=(float(len(corners)), 0.0, 0.0, 0.0), frame=0) for n, e in corners]


SQUARE = area(INCLUSION, [(-15.0, -15.0), (-15.0, 15.0), (15.0, 15.0), (15.0, -15.0)])


def fly_north(vehicle, until, speed=4.0, limit_s=20.0):
    """Offboard to the north until the condition holds."""
    vehicle.offboard(speed, 0.0, 0.0)
    vehicle.until(lambda: vehicle.mode == OFFBOARD, 2, lambda: vehicle.setpoint(speed, 0.0, 0.0))
    vehicle.until(until, limit_s, lambda: vehicle.setpoint(speed, 0.0, 0.0))


def breached(vehicle):
    return any(text.startswith("Geofence:") for text in vehicle.texts())


def test_fence_upload_download_clear(vehicle):
    """AUTOPILOT.md 1: type 1 fence."""
    vehicle.boot()
    hole = [item(CIRCLE_OUTSIDE, 5.0, 5.0, 0.0, p=(2.5, 0.0, 0.0, 0.0), frame=0)]
    assert upload(vehicle, SQUARE + hole, kind=1) == ACCEPTED
    back = download(vehicle, kind=1)
    assert [(i[1], i[2][0]) for i in back] == [(INCLUSION, 4.0)] * 4 + [(CIRCLE_OUTSIDE, 2.5)]
    assert [i[3] for i in back] == [i[3] for i in SQUARE + hole]
    assert download(vehicle, kind=0) == []
    assert upload(vehicle, SQUARE[:3], kind=1) == 5  # a polygon cut short: MAV_MISSION_INVALID
    assert len(download(vehicle, kind=1)) == 5
    assert upload(vehicle, [], kind=1) == ACCEPTED
    assert download(vehicle, kind=1) == []


@pytest.mark.parametrize(
    ("action", "mode"), [(NONE, OFFBOARD), (WARN, OFFBOARD), (HOLD, LOITER), (RETURN, RTL), (LAND, LANDING)]
)
def test_breach_action(action, mode):
    """AUTOPILOT.md 2: GF_ACTION 2 = hold on breach; COM_FAIL_ACT_T 5 s hold before another action."""
    with direct(GF_ACTION=action) as vehicle:
        vehicle.take_off(499.4)
        assert upload(vehicle, SQUARE, kind=1) == ACCEPTED
        fly_north(vehicle, lambda: vehicle.position[0] > 15.5)
        crossed_ms = vehicle.time_ms
        vehicle.fly(1.5, lambda: vehicle.setpoint(4.0, 0.0, 0.0))
        assert breached(vehicle) == (action != NONE)
        assert any(text.startswith("Failsafe activated") for text in vehicle.texts()) == (action >= HOLD)
        if action in (RETURN, LAND):
            assert vehicle.mode == LOITER
            vehicle.until(lambda: vehicle.mode == mode, 10)
            assert vehicle.time_ms - crossed_ms == pytest.approx(5000, abs=1200)
            vehicle.until(lambda: not vehicle.armed, 90)
            assert (math.hypot(*vehicle.position[:2]) < 0.5) == (action == RETURN)
        else:
            assert vehicle.mode == mode
        if action == HOLD:
            vehicle.fly(5)
            assert 15 < vehicle.position[0] < 25
            assert math.hypot(*vehicle.velocity) < 0.2


def test_terminate_stops_the_motors():
    with direct(GF_ACTION=TERMINATE, GF_MAX_HOR_DIST=10.0) as vehicle:
        vehicle.take_off(499.4)
        fly_north(vehicle, lambda: vehicle.position[0] > 10.5)
        vehicle.fly(3)
        assert not vehicle.armed
        assert vehicle.position[2] == 0.0


def test_distance_and_height_limits():
    """GF_MAX_HOR_DIST and GF_MAX_VER_DIST are measured from home."""
    with direct(GF_MAX_HOR_DIST=20.0, GF_MAX_VER_DIST=15.0) as vehicle:
        vehicle.take_off(499.4)
        vehicle.offboard(0.0, 0.0, -2.0)
        vehicle.fly(1.2, lambda: vehicle.setpoint(0.0, 0.0, -2.0))
        vehicle.until(lambda: vehicle.mode == LOITER, 20, lambda: vehicle.setpoint(0.0, 0.0, -2.0))
        assert -19 < vehicle.position[2] < -15
        assert "Geofence: exceeding maximum altitude above Home" in vehicle.texts()
        assert vehicle.command(192, -1, 1, 0, NAN, NAN, NAN, 489.4 + 12.0) == ACCEPTED
        vehicle.fly(8)
        fly_north(vehicle, lambda: vehicle.position[0] > 20.5)
        vehicle.until(lambda: vehicle.mode == LOITER, 2)
        assert "Geofence: approaching or outside geofence" in vehicle.texts()


def test_exclusion_and_circle(hovering):
    hole = area(EXCLUSION, [(8.0, -5.0), (8.0, 5.0), (20.0, 0.0)])
    ring = [item(CIRCLE_INSIDE, 0.0, 0.0, 0.0, p=(100.0, 0.0, 0.0, 0.0), frame=0)]
    assert upload(hovering, hole + ring, kind=1) == ACCEPTED
    fly_north(hovering, lambda: hovering.mode == LOITER, speed=3.0)
    assert 8.0 < hovering.position[0] < 14


def test_after_the_breach_the_pilot_may_fly_on(hovering):
    """The action comes once per breach, and the user's mode is taken."""
    assert upload(hovering, SQUARE, kind=1) == ACCEPTED
    fly_north(hovering, lambda: hovering.mode == LOITER)
    hovering.fly(1.2)
    assert hovering.latest["HEARTBEAT"].system_status == 5  # critical
    hovering.offboard(-3.0, 0.0, 0.0)
    hovering.fly(6, lambda: hovering.setpoint(-3.0, 0.0, 0.0))
    assert hovering.mode == OFFBOARD
    assert hovering.position[0] < 14
    fly_north(hovering, lambda: hovering.mode == LOITER)  # a second breach acts again
    assert hovering.texts().count("Geofence: approaching or outside geofence") == 2


def test_destinations_outside_are_not_flown_to(hovering):
    """PX4: "Reposition is outside geofence", and it holds."""
    assert upload(hovering, SQUARE, kind=1) == ACCEPTED
    assert reposition_int(hovering, 40.0, 0.0, 499.4) == ACCEPTED
    hovering.fly(5)
    assert "Reposition is outside geofence" in hovering.texts()
    assert hovering.position == pytest.approx((0, 0, -10), abs=0.3)
    assert not breached(hovering)


def test_missions_that_leave_the_fence_are_not_flown(vehicle):
    vehicle.boot()
    plan = [item(TAKEOFF, up=5.0), item(WAYPOINT, 10.0, 0.0, 5.0), item(WAYPOINT, 30.0, 0.0, 5.0)]
    assert upload(vehicle, SQUARE, kind=1) == ACCEPTED
    assert upload(vehicle, plan) == ACCEPTED
    vehicle.advance()
    assert vehicle.texts() == ["Geofence violation for waypoint 3"]  # told at once
    assert vehicle.command(176, 1, 4, 4) == TEMPORARILY_REJECTED
    assert vehicle.command(300) == DENIED
    assert vehicle.texts()[-1] == "Mission start denied! No valid mission"
    assert upload(vehicle, plan[:2]) == ACCEPTED
    assert vehicle.command(176, 1, 4, 4) == ACCEPTED


def test_fence_enable_is_unknown_to_px4(vehicle):
    vehicle.boot()
    assert vehicle.command(207, 1) == UNSUPPORTED
