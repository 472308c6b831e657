"""Flying by sticks (MANUAL_CONTROL) on PX4: modes, presence, loss, take-over. Over real UDP."""

import math

import pytest
from pymavlink.dialects.v20 import development as mavlink

from tests.sitl.client import direct

ACCEPTED, TEMPORARILY_REJECTED = 0, 1
ARM, DO_SET_MODE = 400, 176
ALTCTL, POSCTL, LOITER, RTL, LANDING, OFFBOARD, STABILIZED = (2, 0), (3, 0), (4, 3), (4, 5), (4, 6), (6, 0), (7, 0)


def push(vehicle, forward=0.0, right=0.0, throttle=0.5, yaw=0.0):
    """MANUAL_CONTROL; throttle from 0 to 1."""
    axes = [round(1000 * value) for value in (forward, right, throttle, yaw)]
    vehicle.send(mavlink.MAVLink_manual_control_message(1, *axes, 0))


def flown(vehicle, seconds, **axes):
    vehicle.fly(seconds, lambda: push(vehicle, **axes))


def in_mode(vehicle, main):
    """With sticks in the middle, in a mode."""
    push(vehicle)
    assert vehicle.command(DO_SET_MODE, 1, main) == ACCEPTED
    flown(vehicle, 1.2)
    assert vehicle.mode[0] == main


def test_stick_modes_need_sticks(hovering):
    """AUTOPILOT.md 2: TEMPORARILY_REJECTED in air: POSCTL without sticks."""
    for main, name in ((2, "Altitude"), (3, "Position"), (7, "Stabilized")):
        assert hovering.command(DO_SET_MODE, 1, main) == TEMPORARILY_REJECTED
        assert hovering.texts()[-1] == f"Switching to mode '{name}' is currently not possible"
    push(hovering)
    assert hovering.command(DO_SET_MODE, 1, 3) == ACCEPTED


def test_position_mode_flies_by_heading_and_holds_when_centred(hovering):
    in_mode(hovering, 3)
    flown(hovering, 2.0)
    height = hovering.position[2]
    flown(hovering, 3.0, right=0.5)
    assert hovering.velocity[1] > 1.5
    assert abs(hovering.velocity[0]) < 0.2
    flown(hovering, 4.0, yaw=0.4)  # turn to the right
    flown(hovering, 2.0)
    yaw = hovering.latest["ATTITUDE"].yaw
    assert yaw > 0.3
    flown(hovering, 6.0, forward=1.0)
    speed = math.hypot(*hovering.velocity[:2])
    assert speed == pytest.approx(9.0, abs=1.2)  # MPC_VEL_MANUAL 10, less SIH's drag
    assert math.atan2(hovering.velocity[1], hovering.velocity[0]) == pytest.approx(yaw, abs=0.1)
    flown(hovering, 8.0)
    place = hovering.position
    assert place[2] == pytest.approx(height, abs=0.5)
    flown(hovering, 4.0)
    assert hovering.position == pytest.approx(place, abs=0.3)
    assert hovering.latest["ATTITUDE"].yaw == pytest.approx(yaw, abs=0.05)
    flown(hovering, 4.0, throttle=1.0)
    assert hovering.velocity[2] == pytest.approx(-3.0, abs=0.4)  # MPC_Z_VEL_MAX_UP
    flown(hovering, 4.0, right=-0.5)
    assert -hovering.velocity[0] * math.sin(yaw) + hovering.velocity[1] * math.cos(yaw) < -0.8


def test_takeoff_and_landing_by_sticks(vehicle):
    vehicle.boot()
    in_mode(vehicle, 3)
    push(vehicle, throttle=1.0)
    assert vehicle.command(ARM, 1) == TEMPORARILY_REJECTED
    assert vehicle.texts()[-1] == "Arming denied: throttle above center"
    push(vehicle, throttle=0.0)
    assert vehicle.command(ARM, 1) == ACCEPTED
    flown(vehicle, 3.0, throttle=0.0)
    assert vehicle.landed == 1
    flown(vehicle, 8.0, throttle=0.8)
    assert vehicle.position[2] < -1.0
    assert vehicle.landed == 2
    vehicle.until(lambda: not vehicle.armed, 60, lambda: push(vehicle, throttle=0.0))
    assert vehicle.position[2] == 0.0


def test_altitude_mode_tilts_and_keeps_the_height(hovering):
    in_mode(hovering, 2)
    flown(hovering, 3.0, forward=0.5)
    tilt = math.radians(35.0) * 0.5  # MPC_MAN_TILT_MAX
    assert hovering.latest["ATTITUDE"].pitch == pytest.approx(-tilt, abs=0.06)
    assert hovering.velocity[0] > 2.0
    assert hovering.position[2] == pytest.approx(-10, abs=0.8)
    flown(hovering, 1.0)
    assert abs(hovering.latest["ATTITUDE"].pitch) < 0.05
    assert hovering.velocity[0] > 0.8  # it coasts: nothing holds the place, only SIH's drag brakes


def test_stabilized_mode_gives_attitude_and_thrust(hovering):
    in_mode(hovering, 7)
    flown(hovering, 2.0, right=0.6)
    assert hovering.latest["ATTITUDE"].roll == pytest.approx(math.radians(21.0), abs=0.06)
    assert hovering.velocity[1] > 2.0
    before = hovering.velocity[2]
    flown(hovering, 1.5, throttle=0.8)
    assert hovering.velocity[2] < before - 1.0


@pytest.mark.parametrize(("action", "mode"), [(1, LOITER), (2, RTL), (3, LANDING)])
def test_sticks_lost(action, mode):
    """NAV_RCL_ACT after COM_RC_LOSS_T 0.5 s and COM_FAIL_ACT_T 5 s of hold."""
    with direct(NAV_RCL_ACT=action) as vehicle:
        vehicle.take_off(499.4)
        in_mode(vehicle, 3)
        push(vehicle)
        vehicle.advance(50)
        last = vehicle.time_ms
        vehicle.until(lambda: "Manual control lost" in vehicle.texts(), 2)
        assert vehicle.time_ms - last == pytest.approx(500, abs=60)
        vehicle.fly(2)
        assert vehicle.mode == LOITER
        assert vehicle.latest["HEARTBEAT"].system_status == 5
        vehicle.fly(5)
        assert vehicle.mode == mode


def test_sticks_regained(hovering):
    """A failsafe for lost sticks lasts until the mode is changed, or, after its hold, until the sticks are moved."""
    in_mode(hovering, 3)
    hovering.fly(2)
    assert hovering.mode == LOITER
    flown(hovering, 1.5, forward=0.5)
    assert "Manual control regained" in hovering.texts()
    assert hovering.mode == LOITER
    flown(hovering, 4.0)
    assert hovering.mode == RTL
    flown(hovering, 1.5, forward=0.5)
    assert hovering.mode == POSCTL


def test_moved_sticks_take_over_from_automatic_modes_but_not_from_offboard(hovering):
    """COM_RC_OVERRIDE 1: automatic modes; COM_RC_STICK_OV 30 %."""
    flown(hovering, 1.2, forward=0.2)
    assert hovering.mode == LOITER
    flown(hovering, 1.2, forward=0.5)
    assert hovering.mode == POSCTL
    assert "Pilot took over using sticks" in hovering.texts()
    hovering.offboard(0.0, 0.0, 0.0)

    def both():
        push(hovering, forward=0.8)
        hovering.setpoint(0.0, 0.0, 0.0)

    hovering.fly(3, both)
    assert hovering.mode == OFFBOARD


def test_offboard_loss_with_sticks_holds_the_place(hovering):
    """AUTOPILOT.md 2: on stream loss to POSCTL; only "without sticks it does not hold". Issue 4, item 3."""
    hovering.offboard(2.0, 0.0, 0.0)

    def both():
        push(hovering)
        hovering.setpoint(2.0, 0.0, 0.0)

    hovering.fly(4, both)
    flown(hovering, 6.0)
    assert "Failsafe activated" in hovering.texts()
    assert hovering.mode == POSCTL
    place = hovering.position
    flown(hovering, 5.0)
    assert hovering.position == pytest.approx(place, abs=0.3)
    assert hovering.position[2] == pytest.approx(-10, abs=0.5)


def test_sticks_that_are_not_taken(hovering):
    """For another system, out of range, or of a source that COM_RC_IN_MODE (1: joystick) excludes."""
    hovering.send(mavlink.MAVLink_manual_control_message(9, 1000, 0, 500, 0, 0))
    hovering.send(mavlink.MAVLink_manual_control_message(1, 32767, 32767, 32767, 32767, 0))
    hovering.send(mavlink.MAVLink_rc_channels_override_message(1, 1, 1500, 1500, 1500, 1500, 0, 0, 0, 0))
    hovering.advance()
    assert hovering.command(DO_SET_MODE, 1, 3) == TEMPORARILY_REJECTED


def test_radio_override_when_allowed():
    with direct(COM_RC_IN_MODE=3) as vehicle:
        vehicle.take_off(499.4)

        def push_forward():
            vehicle.send(mavlink.MAVLink_rc_channels_override_message(1, 1, 1500, 1100, 1500, 1500, 0, 0, 0, 0))

        vehicle.fly(4, push_forward)
        assert vehicle.mode == POSCTL  # it took over
        assert vehicle.velocity[0] > 2
