"""Faults on request: `inject` on the control socket, MAV_CMD_INJECT_FAILURE over MAVLink."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.injection import INJECTIONS, inject
from sitl.requests import VEHICLE_REQUESTS
from tests.sitl.client import direct, lockstep
from tests.sitl.copter import copter
from tests.sitl.process import sitl_process

ACCEPTED, DENIED, UNSUPPORTED = 0, 2, 3
INJECT_FAILURE = 420
GYRO, GPS, BATTERY, MOTOR, SERVO, RC_SIGNAL, MAVLINK_SIGNAL = 0, 4, 100, 101, 102, 104, 105
OK, OFF, STUCK = 0, 1, 2


def test_by_the_control_socket_of_a_process():
    """Issue 4, item 3: "injectable by a `sitl` control channel"."""
    with sitl_process(lockstep=True) as sitl, lockstep(sitl) as client:
        assert client.ask("inject battery 0.145") == "injected battery 0.145"
        assert client.ask("inject gps_loss 10") == "injected gps_loss 10"
        assert client.ask("vehicle 1 inject wind 1,2,0 5") == "injected wind 1,2,0 5"
        assert client.ask("inject bad weather").startswith("error inject: 'bad weather' is not one of gps_loss, ")
        client.advance(1000)
        client.fly(2)
        assert client.latest["SYS_STATUS"].battery_remaining == 15
        assert client.latest["GPS_RAW_INT"].fix_type < 2


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", ["gps_loss", "motor", "wind"]),
        ("gremlins", ["gremlins"]),
        ("gps_loss soon", ["gps_loss", "soon", "0 to 1e+06"]),
        ("gps_loss -1", ["-1"]),
        ("gcs_loss 1 2", ["seconds"]),
        ("motor 5 fail", ["motor", "'5'", "1, 2, 3, 4 and all"]),
        ("motor 1.5 fail", ["motor", "'1.5'", "1, 2, 3, 4 and all"]),
        ("motor 1", ["fail"]),
        ("motor 1 nan", ["nan"]),
        ("battery 1.5", ["battery", "0 to 1"]),
        ("battery", ["remaining"]),
        ("wind 1,2", ["north"]),
        ("wind 1,2,99", ["99", "-10 to 10"]),
        ("wind 1,2,x", ["x"]),
        ("wind 1,2,3 -4", ["-4", "0 to 30"]),
        ("ok now", ["now"]),
    ],
)
def test_bad_requests_say_what_is_allowed_and_change_nothing(vehicle, line, words):
    with pytest.raises(ValueError, match=r"^inject") as error:
        inject(vehicle.autopilot, line)
    assert all(word in str(error.value) for word in words)
    assert vehicle.autopilot.vehicle.parameters.changes == 0
    assert vehicle.commander.battery.remaining == 1.0
    assert vehicle.autopilot.vehicle.model.faults.motors == [1.0] * 4


@settings(max_examples=50, deadline=None)
@given(st.sampled_from([*INJECTIONS, "x"]), st.text(max_size=30))
def test_any_line_is_answered_or_refused(what, rest):
    with direct() as vehicle:
        try:
            answer = VEHICLE_REQUESTS["inject"](vehicle.autopilot, f"{what} {rest}")
        except ValueError:
            return
        assert answer.startswith(f"injected {what}")


def test_everything_can_be_taken_back(hovering):
    for what in ("gps_loss", "estimator_loss", "gcs_loss", "sticks_loss", "motor 1 0.9", "ok"):
        assert inject(hovering.autopilot, what) == f"injected {what}"
    hovering.fly(8)
    assert hovering.mode == (4, 3)
    assert hovering.position == pytest.approx((0, 0, -10), abs=0.3)


def test_a_weak_motor_is_flown_with(hovering):
    """80 % of the thrust of one motor: the integrators make up for it."""
    inject(hovering.autopilot, "motor 1 0.8")
    hovering.fly(10)
    assert hovering.position == pytest.approx((0, 0, -10), abs=0.3)
    motors = hovering.autopilot.vehicle.model.controller.commands
    assert motors[0] == pytest.approx(max(motors))


@pytest.mark.parametrize(
    ("unit", "kind", "instance", "result"),
    [
        (GPS, OFF, 0, ACCEPTED),
        (MOTOR, OFF, 2, ACCEPTED),
        (MOTOR, OFF, 5, UNSUPPORTED),
        (MOTOR, OFF, math.nan, UNSUPPORTED),
        (BATTERY, OFF, 0, ACCEPTED),
        (RC_SIGNAL, OFF, 0, ACCEPTED),
        (MAVLINK_SIGNAL, OFF, 0, ACCEPTED),
        (GPS, STUCK, 0, UNSUPPORTED),
        (GYRO, OFF, 0, UNSUPPORTED),
        (SERVO, OFF, 1, UNSUPPORTED),
        (math.nan, OFF, 0, UNSUPPORTED),
        (GPS, math.inf, 0, UNSUPPORTED),
    ],
)
def test_by_mavlink(vehicle, unit, kind, instance, result):
    """Issue 4, item 3: "and by MAVLink FAILURE injection"; what PX4's simulators cannot fail is UNSUPPORTED."""
    vehicle.boot()
    assert vehicle.command(INJECT_FAILURE, unit, kind, instance) == result


def test_what_mavlink_injects_is_noticed_and_can_be_taken_back(vehicle):
    vehicle.boot()
    assert vehicle.command(INJECT_FAILURE, GPS, OFF) == ACCEPTED
    assert vehicle.command(INJECT_FAILURE, BATTERY, OFF) == ACCEPTED
    assert vehicle.command(INJECT_FAILURE, MOTOR, OFF, 3) == ACCEPTED
    vehicle.fly(0.5)
    assert vehicle.latest["GPS_RAW_INT"].fix_type < 2
    assert vehicle.latest["SYS_STATUS"].battery_remaining == 0
    assert vehicle.autopilot.vehicle.model.faults.motors == [1.0, 1.0, 0.0, 1.0]
    assert vehicle.command(INJECT_FAILURE, GPS, OK) == ACCEPTED
    assert vehicle.command(INJECT_FAILURE, BATTERY, OK) == ACCEPTED
    assert vehicle.command(INJECT_FAILURE, MOTOR, OK, 0) == ACCEPTED
    vehicle.fly(0.5)
    assert vehicle.latest["GPS_RAW_INT"].fix_type == 3
    assert vehicle.latest["SYS_STATUS"].battery_remaining == 100
    assert vehicle.autopilot.vehicle.model.faults.motors == [1.0] * 4


def test_px4_wants_it_enabled():
    """SYS_FAILURE_EN 0: denied, with the reason."""
    with direct(SYS_FAILURE_EN=0) as vehicle:
        vehicle.boot()
        assert vehicle.command(INJECT_FAILURE, GPS, OFF) == DENIED
        assert "SYS_FAILURE_EN" in vehicle.texts()[-1]
        vehicle.fly(0.5)
        assert vehicle.latest["GPS_RAW_INT"].fix_type == 3


def test_arducopter_does_not_know_it():
    with copter() as vehicle:
        vehicle.until(lambda: "HEARTBEAT" in vehicle.latest, 3)
        assert vehicle.command(INJECT_FAILURE, GPS, OFF) == UNSUPPORTED
