"""The control law: what it asks for, its limits, and the mixer."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sitl.flight.control import (
    Setpoint,
    attitude_from_thrust,
    control_attitude,
    controller_at_rest,
    mix,
    prioritise,
    velocity_from_position,
)
from sitl.flight.flight_model import NAN3, FlightModel
from sitl.flight.physics import GRAVITY, body_at_rest
from sitl.parameters import Parameters
from sitl.px4.parameters import TABLE
from sitl.px4.vehicle_setup import gains, rotorcraft

NAN = math.nan
PX4 = gains(Parameters(TABLE))


def velocity(*v: float, yaw: float = 0.0) -> Setpoint:
    return Setpoint(NAN3, v, NAN3, yaw, NAN, math.inf, PX4.thrust_min)


def hovering(**parameters: float) -> FlightModel:
    p = Parameters(TABLE)
    for name, value in parameters.items():
        p.set(name, value)
    model = FlightModel(gains(p), rotorcraft(p))
    model.body.position[2] = -100.0
    model.body.motors[:] = p["SIH_MASS"] * GRAVITY / (4 * p["SIH_T_MAX"])
    return model


def fly(model: FlightModel, setpoint: Setpoint, seconds: float) -> np.ndarray:
    """Velocities at 100 Hz."""
    track = []
    for _ in range(round(seconds * 100)):
        model.advance(setpoint, True, 10)
        track.append(model.body.velocity.copy())
    return np.array(track)


def test_zero_velocity_hovers_where_it_is():
    model = hovering()
    fly(model, velocity(0.0, 0.0, 0.0), 10)
    assert model.body.position == pytest.approx([0, 0, -100], abs=1e-6)
    assert model.controller.commands == pytest.approx(np.full(4, PX4.hover_thrust), abs=1e-6)


def test_without_hover_estimate_the_integral_finds_the_weight():
    """MPC_THR_HOVER 0.4 is 18 % short of the weight: the velocity integral makes it up."""
    model = hovering(MPC_USE_HTE=0, MPC_THR_HOVER=0.4)
    track = fly(model, velocity(0.0, 0.0, 0.0), 20)
    assert track[:100, 2].max() > 0.1
    assert track[-1] == pytest.approx([0, 0, 0], abs=1e-3)


@pytest.mark.parametrize(
    ("asked", "flown"),
    [((30.0, 0.0, 0.0), (12.0, 0.0)), ((0.0, 0.0, -9.0), (0.0, -3.0)), ((0.0, 0.0, 9.0), (0.0, 1.5))],
)
def test_speed_limits(asked, flown):
    """AUTOPILOT.md 2: clamped to 12 m/s horizontal, 3 up, 1.5 down."""
    model = hovering(SIH_KDV=0.0)
    track = fly(model, velocity(*asked), 15)
    assert np.hypot(track[-1, 0], track[-1, 1]) == pytest.approx(flown[0], abs=0.1)
    assert track[-1, 2] == pytest.approx(flown[1], abs=0.1)


def test_tilt_setpoint_is_limited_to_45_degrees():
    model = hovering()
    for _ in range(300):
        model.advance(velocity(12.0, 0.0, 0.0), True, 10)
        up = Rotation.from_quat(model.controller.attitude_setpoint, scalar_first=True).apply([0, 0, 1])
        assert up[2] >= math.cos(math.radians(45)) - 1e-9


def test_position_setpoint_is_reached_and_held():
    model = hovering()
    target = Setpoint((20.0, -10.0, -110.0), NAN3, NAN3, 1.0, NAN, math.inf, PX4.thrust_min)
    fly(model, target, 60)
    assert model.body.position == pytest.approx([20, -10, -110], abs=0.1)
    yaw = Rotation.from_quat(model.body.attitude, scalar_first=True).as_euler("ZYX")[0]
    assert yaw == pytest.approx(1.0, abs=0.01)


def test_velocity_with_a_position_is_feed_forward():
    """AUTOPILOT.md 5: PX4's own position loop is v = v_ff + 0.95 (p_sp - p)."""
    out = np.zeros(3)
    body = body_at_rest()
    target = Setpoint((2.0, 0.0, -1.0), (1.0, 3.0, 0.0), NAN3, 0.0, NAN)
    velocity_from_position(body, target, PX4, out)
    assert out == pytest.approx([0.95 * 2 + 1.0, 3.0, -1.0])


@given(*[st.floats(-30, 30)] * 4)
def test_position_error_has_priority_over_feed_forward(px, py, fx, fy):
    x, y = prioritise(px, py, fx, fy, 12.0)
    assert math.hypot(x, y) <= 12.0 + 1e-9
    if math.hypot(px, py) <= 12.0 and math.hypot(px + fx, py + fy) > 12.0:
        # What is left is p plus a part of f, in f's direction.
        assert (x - px) * fy - (y - py) * fx == pytest.approx(0.0, abs=1e-6)
        assert (x - px) * fx + (y - py) * fy >= -1e-9


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, -0.1), st.floats(-3.1, 3.1))
def test_attitude_points_the_thrust(x, y, z, yaw):
    q = np.zeros(4)
    thrust = np.array([x, y, z])
    attitude_from_thrust(thrust, yaw, q)
    rotation = Rotation.from_quat(q, scalar_first=True)
    assert rotation.apply([0, 0, -1]) == pytest.approx(thrust / np.linalg.norm(thrust), abs=1e-9)
    forward = rotation.apply([1, 0, 0])
    # The nose lies in the vertical plane of the commanded yaw.
    assert forward[0] * -math.sin(yaw) + forward[1] * math.cos(yaw) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(("axis", "p"), [(0, 6.5), (1, 6.5), (2, 2.8)])
def test_small_attitude_errors_give_rates_by_their_gains(axis, p):
    """MC_ROLL_P, MC_PITCH_P, MC_YAW_P: a small error about one axis gives rate = P * error."""
    body, controller = body_at_rest(), controller_at_rest()
    vector = np.zeros(3)
    vector[axis] = 0.01
    controller.attitude_setpoint[:] = Rotation.from_rotvec(vector).as_quat(scalar_first=True)
    control_attitude(body, controller, velocity(0.0, 0.0, 0.0), PX4)
    assert controller.rate_setpoint == pytest.approx(p * vector, abs=1e-4)


def test_yaw_step_turns_within_the_rate_limit():
    model = hovering()
    fastest = 0.0
    for _ in range(400):
        model.advance(velocity(0.0, 0.0, 0.0, yaw=2.5), True, 10)
        fastest = max(fastest, abs(model.body.rates[2]))
    assert fastest < math.radians(210)
    assert Rotation.from_quat(model.body.attitude, scalar_first=True).as_euler("ZYX")[0] == pytest.approx(2.5, abs=0.02)
    assert np.abs(model.body.velocity).max() < 0.05


@given(st.floats(0, 1), *[st.floats(-1, 1)] * 3)
def test_mixer_stays_in_range_and_gives_what_it_says(collective, roll, pitch, yaw):
    commands = np.zeros(4)
    achieved = mix(collective, np.array([roll, pitch, yaw]), commands)
    assert (commands >= 0).all()
    assert (commands <= 1).all()
    again = np.array(
        [
            (-commands[0] + commands[1] + commands[2] - commands[3]) / (4 * math.sqrt(0.5)),
            (commands[0] - commands[1] + commands[2] - commands[3]) / (4 * math.sqrt(0.5)),
            (commands[0] + commands[1] - commands[2] - commands[3]) / 4,
        ]
    )
    assert achieved == pytest.approx(again, abs=1e-12)


@given(*[st.floats(-0.1, 0.1)] * 3)
def test_mixer_is_exact_away_from_saturation(roll, pitch, yaw):
    commands = np.zeros(4)
    achieved = mix(0.5, np.array([roll, pitch, yaw]), commands)
    assert achieved == pytest.approx([roll, pitch, yaw], abs=1e-12)
    assert commands.mean() == pytest.approx(0.5)


def test_mixer_gives_up_yaw_before_roll():
    commands = np.zeros(4)
    achieved = mix(0.5, np.array([0.6, 0.0, 0.4]), commands)
    assert achieved[0] == pytest.approx(0.6, abs=0.02)
    assert abs(achieved[2]) < 0.2


def test_integral_does_not_wind_up_under_saturation():
    """Held at the tilt limit for 10 s by a speed that drag forbids, it still brakes at once."""
    model = hovering(SIH_KDV=2.0)
    fly(model, velocity(12.0, 0.0, 0.0), 10)
    track = fly(model, velocity(0.0, 0.0, 0.0), 3)
    assert track[-1, 0] < 1.0
    assert track[:, 0].min() > -1.0
