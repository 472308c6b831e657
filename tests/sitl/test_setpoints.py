"""Setpoints besides SET_POSITION_TARGET_LOCAL_NED: global positions, attitudes and rates. Over real UDP."""

import math

import pytest
from pymavlink.dialects.v20 import development as mavlink

from tests.sitl.plans import NAN, ORIGIN

ACCEPTED, TEMPORARILY_REJECTED = 0, 1
DO_SET_MODE = 176
OFFBOARD = (6, 0)
POSITION_ONLY = 0b110111111000


def quaternion(roll, pitch, yaw):
    """Product of the three half-angle rotations, yaw first."""

    def product(a, b):
        return (
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        )

    x = (math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0)
    y = (math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0)
    z = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    return product(z, product(y, x))


def attitude(vehicle, roll, pitch, yaw, thrust, mask=7):
    """As MAVSDK's offboard.set_attitude sends it."""
    q = quaternion(roll, pitch, yaw)
    vehicle.send(mavlink.MAVLink_set_attitude_target_message(vehicle.time_ms, 1, 1, mask, q, 0.0, 0.0, 0.0, thrust))


def rates(vehicle, roll, pitch, yaw, thrust, mask=128):
    vehicle.send(
        mavlink.MAVLink_set_attitude_target_message(vehicle.time_ms, 1, 1, mask, (1, 0, 0, 0), roll, pitch, yaw, thrust)
    )


def enter(vehicle, each):
    for _ in range(4):
        each()
        vehicle.advance()
    assert vehicle.command(DO_SET_MODE, 1, 6) == ACCEPTED


def go(vehicle, north, east, altitude, frame, mask=POSITION_ONLY, velocity=(0.0, 0.0, 0.0)):
    latitude, longitude = ORIGIN.globe(north, east)
    vehicle.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, frame, mask, round(latitude * 1e7), round(longitude * 1e7), altitude, *velocity, 0, 0, 0, 0.0, 0.0
        )
    )


@pytest.mark.parametrize(("frame", "altitude"), [(5, ORIGIN.altitude + 12.0), (6, 12.0)])
def test_global_positions(hovering, frame, altitude):
    """MAVSDK's offboard.set_position_global."""

    def each():
        go(hovering, 6.0, -4.0, altitude, frame)

    enter(hovering, each)
    hovering.fly(20, each)
    assert hovering.position == pytest.approx((6.0, -4.0, -12.0), abs=0.3)


def test_velocities_in_a_global_message_and_other_frames(hovering):
    def each():
        go(hovering, 0, 0, 0.0, 6, 2503, (0.0, 2.0, 0.0))

    enter(hovering, each)
    hovering.fly(6, each)
    assert hovering.velocity[1] == pytest.approx(1.8, abs=0.3)
    go(hovering, 0, 0, 0.0, 10)
    hovering.advance(100)
    assert hovering.texts()[-1] == "SET_POSITION_TARGET_GLOBAL_INT coordinate frame 10 unsupported"
    go(hovering, 0, 0, NAN, 6)
    go(hovering, 0, 0, 0.0, 6, 0xDFF)
    hovering.advance(100)
    assert hovering.texts()[-1] == "SET_POSITION_TARGET_GLOBAL_INT invalid"


def test_attitude_is_held_and_thrust_carries(hovering):
    """Issue 4, item 9: MAVSDK-Python's offboard attitude example."""
    roll, pitch, yaw = math.radians(10), math.radians(-15), math.radians(40)

    def each():
        attitude(hovering, roll, pitch, yaw, 0.55)

    enter(hovering, each)
    hovering.fly(3, each)
    assert hovering.mode == OFFBOARD
    flown = hovering.latest["ATTITUDE"]
    assert (flown.roll, flown.pitch) == pytest.approx((roll, pitch), abs=0.03)
    assert flown.yaw == pytest.approx(yaw, abs=0.1)
    target = hovering.latest["ATTITUDE_TARGET"]
    assert target.thrust == pytest.approx(0.55)
    assert list(target.q) == pytest.approx(list(quaternion(roll, pitch, yaw)), abs=1e-5)
    assert math.hypot(*hovering.velocity[:2]) > 2.0


def test_body_rates(hovering):
    def each():
        rates(hovering, 0.0, 0.0, 0.5, 0.5)

    enter(hovering, each)
    hovering.fly(3, each)
    assert hovering.latest["ATTITUDE"].yawspeed == pytest.approx(0.5, abs=0.05)
    assert abs(hovering.latest["ATTITUDE"].roll) < 0.05


def test_attitude_loss_is_a_stream_loss_like_any_other(hovering):
    def each():
        attitude(hovering, 0.0, 0.0, 0.0, 0.5)

    enter(hovering, each)
    hovering.fly(2, each)
    hovering.fly(1.5)
    assert "Failsafe activated" in hovering.texts()


@pytest.mark.parametrize("thrust", [NAN, math.inf])
def test_bad_attitudes_do_not_keep_the_stream_alive(hovering, thrust):
    for _ in range(5):
        attitude(hovering, 0.0, 0.0, 0.0, thrust)
        hovering.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, (0, 0, 0, 0), 0, 0, 0, 0.5))
        hovering.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, (NAN,) * 4, 0, 0, 0, 0.5))
        attitude(hovering, 0.0, 0.0, 0.0, 0.5, mask=64 | 7)  # without thrust
        hovering.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 135, (1, 0, 0, 0), 0, 0, 0, 0.5))
        hovering.advance()
    assert hovering.texts()[-1] == "SET_ATTITUDE_TARGET invalid"
    assert hovering.command(DO_SET_MODE, 1, 6) == TEMPORARILY_REJECTED


def test_takeoff_by_attitude_and_huge_thrust_is_cut(vehicle):
    vehicle.boot()

    def each():
        attitude(vehicle, 0.0, 0.0, 0.0, 50.0)

    enter(vehicle, each)
    assert vehicle.command(400, 1) == ACCEPTED
    vehicle.fly(2.5, each)
    assert vehicle.position[2] < -2.0
    assert vehicle.latest["ATTITUDE_TARGET"].thrust <= 1.0
