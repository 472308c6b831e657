"""DO_REPOSITION and DO_CHANGE_SPEED on PX4, over real UDP; what is not done is refused at once."""

import math

import pytest
from pymavlink.dialects.v20 import development as mavlink

from tests.sitl.plans import NAN, ORIGIN

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
REPOSITION, CHANGE_SPEED = 192, 178
LOITER = (4, 3)
ALTITUDE = ORIGIN.altitude


def reposition_int(vehicle, north, east, altitude, yaw=NAN, speed=-1.0, flags=1.0, frame=5):
    """COMMAND_INT as MAVSDK's goto_location sends it; the result."""
    latitude, longitude = ORIGIN.globe(north, east)
    vehicle.send(
        mavlink.MAVLink_command_int_message(
            1, 1, frame, REPOSITION, 0, 0, speed, flags, 0.0, yaw,
            round(latitude * 1e7), round(longitude * 1e7), altitude,
        )
    )  # fmt: skip
    vehicle.advance(50)
    vehicle.advance(50)
    assert vehicle.latest["COMMAND_ACK"].command == REPOSITION
    return vehicle.latest["COMMAND_ACK"].result


def test_goto_flies_there_and_holds(hovering):
    """AUTOPILOT.md 1: goto (CMD 192)."""
    assert reposition_int(hovering, 12.0, -8.0, ALTITUDE + 15.0, yaw=math.pi / 2) == ACCEPTED
    hovering.fly(25)
    assert hovering.position == pytest.approx((12.0, -8.0, -15.0), abs=0.3)
    assert hovering.mode == LOITER
    assert hovering.latest["ATTITUDE"].yaw == pytest.approx(math.pi / 2, abs=0.05)


def test_goto_by_command_long_keeps_what_is_left_open(hovering):
    assert hovering.command(REPOSITION, -1, 1, 0, NAN, NAN, NAN, ALTITUDE + 14.0) == ACCEPTED
    hovering.fly(12)
    assert hovering.position == pytest.approx((0.0, 0.0, -14.0), abs=0.3)
    latitude, longitude = ORIGIN.globe(6.0, 3.0)
    assert hovering.command(REPOSITION, -1, 1, 0, NAN, latitude, longitude, NAN) == ACCEPTED
    hovering.fly(12)
    assert hovering.position == pytest.approx((6.0, 3.0, -14.0), abs=0.6)  # float32 degrees


def test_goto_with_altitude_above_home(hovering):
    assert reposition_int(hovering, 5.0, 0.0, 12.0, frame=6) == ACCEPTED
    hovering.fly(12)
    assert hovering.position == pytest.approx((5.0, 0.0, -12.0), abs=0.3)


def test_goto_faces_where_it_flies_and_obeys_the_speed(hovering):
    assert reposition_int(hovering, 0.0, 40.0, ALTITUDE + 10.0, speed=3.0) == ACCEPTED
    hovering.until(lambda: hovering.position[1] > 15, 30)
    assert hovering.velocity[1] == pytest.approx(3.0, abs=0.3)
    assert hovering.latest["ATTITUDE"].yaw == pytest.approx(math.pi / 2, abs=0.1)
    assert hovering.command(CHANGE_SPEED, 1, 6.0) == ACCEPTED
    hovering.until(lambda: hovering.velocity[1] > 5.1, 10)  # above MPC_XY_CRUISE
    hovering.until(lambda: abs(hovering.position[1] - 40) < 0.5, 20)


def test_goto_that_is_refused(hovering):
    """Only MAV_DO_REPOSITION_FLAGS_CHANGE_MODE is known to PX4; nonsense is denied; the vehicle stays."""
    assert reposition_int(hovering, 5.0, 0.0, ALTITUDE + 10.0, flags=0.0) == UNSUPPORTED
    assert reposition_int(hovering, 5.0, 0.0, NAN, flags=3.0) == UNSUPPORTED
    assert hovering.command(REPOSITION, -1, 1, 0, NAN, 91.0, 8.0, 500.0) == DENIED
    assert hovering.command(REPOSITION, -1, 1, 0, NAN, 47.0, 8.0, math.inf) == DENIED
    assert hovering.command(CHANGE_SPEED, 1, NAN) == DENIED
    hovering.fly(2)
    assert hovering.position == pytest.approx((0.0, 0.0, -10.0), abs=0.3)


def test_goto_on_the_ground_changes_the_mode_only(vehicle):
    vehicle.boot()
    assert vehicle.command(176, 1, 6) == ACCEPTED
    assert reposition_int(vehicle, 5.0, 0.0, ALTITUDE + 10.0) == ACCEPTED
    vehicle.fly(1)
    assert vehicle.mode == LOITER
    assert vehicle.position == pytest.approx((0, 0, 0), abs=0.01)


@pytest.mark.parametrize(
    "number",
    [
        34,  # DO_ORBIT
        32,  # DO_FOLLOW
        193,  # DO_PAUSE_CONTINUE: ArduPilot's
        195, 197, 201,  # ROI
        203, 205, 206,  # camera and mount
        530, 2000, 2500,  # camera mode, pictures, video
        1000, 1001,  # gimbal manager
    ],
)  # fmt: skip
def test_what_is_not_done_is_refused_at_once(vehicle, number):
    """AUTOPILOT.md 1: orbit, follow, gimbal, camera: UNSUPPORTED, at once (the ACK comes within 100 ms)."""
    vehicle.boot()
    assert vehicle.command(number) == UNSUPPORTED


def test_follow_me_is_refused(vehicle):
    """AUTOPILOT.md 1: follow: MAVSDK asks for AUTO.FOLLOW_TARGET (4, 8)."""
    vehicle.boot()
    assert vehicle.command(176, 1, 4, 8) == UNSUPPORTED
