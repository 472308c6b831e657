"""Rigid-body dynamics against closed forms and conserved quantities."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sitl.parameters import Parameters
from sitl.physics import GRAVITY, body_at_rest, heading, rotate, rotate_back, step_body, turn
from sitl.px4.parameters import TABLE
from sitl.px4.vehicle_setup import rotorcraft

DT = 0.004
SIH = rotorcraft(Parameters(TABLE))
finite = st.floats(-1.0, 1.0)


def falling(height: float = 1000.0):
    body = body_at_rest()
    body.position[2] = -height
    return body


def test_hover_thrust_holds_height():
    body = falling()
    hover = SIH.mass * GRAVITY / (4 * SIH.thrust_max)
    body.motors[:] = hover
    for _ in range(2500):
        step_body(body, np.full(4, hover), SIH, DT)
    assert body.position == pytest.approx([0, 0, -1000.0], abs=1e-9)
    assert body.specific_force == pytest.approx([0, 0, -GRAVITY], abs=1e-9)


def test_free_fall_follows_linear_drag():
    """v(t) = (m g / k) (1 - exp(-k t / m)) with linear drag k; SIH_KDV."""
    body = falling()
    for _ in range(500):
        step_body(body, np.zeros(4), SIH, DT)
    time_s = 500 * DT
    terminal = SIH.mass * GRAVITY / SIH.drag
    assert body.velocity[2] == pytest.approx(terminal * (1 - math.exp(-SIH.drag * time_s / SIH.mass)), rel=0.005)
    for _ in range(5000):
        step_body(body, np.zeros(4), SIH, DT)
    assert body.velocity[2] == pytest.approx(terminal, rel=1e-6)


def test_motors_lag_first_order():
    body = falling()
    for _ in range(25):
        step_body(body, np.ones(4), SIH, DT)
    assert body.motors == pytest.approx(np.full(4, 1 - math.exp(-0.1 / SIH.motor_lag)), rel=1e-9)


def test_ground_holds_the_vehicle_until_thrust_exceeds_weight():
    body = body_at_rest()
    for _ in range(250):
        step_body(body, np.full(4, 0.48), SIH, DT)
    assert body.position[2] == 0.0
    assert body.contact_s[0] == pytest.approx(1.0)
    for _ in range(250):
        step_body(body, np.full(4, 0.6), SIH, DT)
    assert body.position[2] < -0.5
    assert body.contact_s[0] == 0.0


def test_landing_does_not_bounce_and_levels():
    body = falling(1.0)
    body.velocity[:] = (1.0, -2.0, 3.0)
    body.attitude[:] = Rotation.from_euler("ZYX", [0.7, 0.3, -0.2]).as_quat(scalar_first=True)
    yaw = heading(body.attitude)
    for _ in range(250):
        step_body(body, np.zeros(4), SIH, DT)
    assert body.position[2] == 0.0
    assert body.velocity == pytest.approx(np.zeros(3))
    assert Rotation.from_quat(body.attitude, scalar_first=True).as_euler("ZYX") == pytest.approx([yaw, 0, 0], abs=1e-9)


def test_torque_free_spin_keeps_angular_momentum():
    """No torque, no angular drag: the momentum in the world stays (Euler's equations), to first order in dt."""
    craft = SIH._replace(angular_drag=0.0, inertia=(0.02, 0.03, 0.04))
    body = falling()
    body.rates[:] = (2.0, 1.0, -3.0)
    inertia = np.array(craft.inertia)
    before = np.array(rotate(body.attitude, *(inertia * body.rates)))
    for _ in range(2500):
        step_body(body, np.zeros(4), craft, 0.0001)
    after = np.array(rotate(body.attitude, *(inertia * body.rates)))
    assert after == pytest.approx(before, abs=2e-3 * np.linalg.norm(before))


@given(st.tuples(finite, finite, finite), st.tuples(finite, finite, finite))
def test_rotation_agrees_with_scipy(axis, vector):
    rotation = Rotation.from_rotvec(3.0 * np.array(axis))
    q = rotation.as_quat(scalar_first=True)
    assert rotate(q, *vector) == pytest.approx(rotation.apply(vector), abs=1e-12)
    assert rotate_back(q, *vector) == pytest.approx(rotation.inv().apply(vector), abs=1e-12)


@given(st.tuples(finite, finite, finite), st.floats(0.0, 20.0))
def test_turning_is_exact_and_stays_normalised(axis, scale):
    q = np.array([1.0, 0.0, 0.0, 0.0])
    rates = scale * np.array(axis)
    for _ in range(100):
        turn(q, rates, 0.01)
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-12)
    expected = Rotation.from_rotvec(rates)
    assert (expected.inv() * Rotation.from_quat(q, scalar_first=True)).magnitude() == pytest.approx(0.0, abs=1e-9)


@settings(max_examples=50)
@given(st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4))
def test_any_motor_commands_leave_a_finite_state_above_ground(commands):
    body = falling(2.0)
    for _ in range(250):
        step_body(body, np.array(commands), SIH, DT)
    assert all(np.isfinite(array).all() for array in body)
    assert np.linalg.norm(body.attitude) == pytest.approx(1.0, abs=1e-9)
    assert body.position[2] <= 0.0
