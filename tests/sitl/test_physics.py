"""Rigid-body dynamics against closed forms and conserved quantities."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from airframe.power import Panel, RotaryWing, drag_force
from sitl.flight.physics import GRAVITY, body_at_rest, heading, rotate, rotate_back, step_body, turn
from sitl.flight.physics import drag_force as air_force
from sitl.parameters import Parameters
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


@given(st.tuples(*[st.floats(-15, 15)] * 4), st.floats(-3.1, 3.1))
def test_panel_drag_is_that_of_the_power_model(v, yaw):
    """A level body with its panel across x: `airframe.power.drag_force`, x east and y north there."""
    p = Parameters(TABLE)
    p.set("SITL_PANEL_AREA", 0.09)
    p.set("SIH_KDV", 0.0)
    body = falling()
    body.velocity[:2], body.air[:2] = v[:2], v[2:]
    body.attitude[:] = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    north, east, down = air_force(body, rotorcraft(p))
    n, e, _ = body.velocity - body.air
    wing = RotaryWing(fuselage_drag_ratio=0.0)
    x, y = drag_force(wing, Panel(p["SITL_PANEL_AREA"], p["SITL_PANEL_CD"]), e, n, math.sin(yaw), math.cos(yaw))
    assert (-east, -north, down) == (pytest.approx(x, abs=1e-9), pytest.approx(y, abs=1e-9), pytest.approx(0, abs=1e-9))


def test_a_tilted_panel_is_pushed_along_its_normal():
    """Falling nose down by 30 degrees: the force is along -x of the body, 1/2 rho S C_d (v sin 30)^2."""
    p = Parameters(TABLE)
    p.set("SITL_PANEL_AREA", 0.5)
    p.set("SIH_KDV", 0.0)
    body = falling()
    body.attitude[:] = Rotation.from_euler("Y", -30, degrees=True).as_quat(scalar_first=True)
    body.velocity[2] = 8.0
    force = 0.5 * 1.225 * 0.5 * 2.1 * 4.0**2
    assert np.linalg.norm(air_force(body, rotorcraft(p))) == pytest.approx(force, rel=1e-6)
    assert rotate_back(body.attitude, *air_force(body, rotorcraft(p))) == pytest.approx((-force, 0, 0), rel=1e-6)


def test_a_failed_motor_dies_away_with_its_lag():
    body = falling()
    body.motors[:] = 0.5
    craft = SIH._replace(health=(1.0, 0.0, 1.0, 0.5))
    for _ in range(25):
        step_body(body, np.full(4, 0.5), craft, DT)
    left = math.exp(-0.1 / SIH.motor_lag)
    assert body.motors == pytest.approx([0.5, 0.5 * left, 0.5, 0.25 + 0.25 * left], rel=1e-9)


def test_free_response_against_scipy():
    """Tumbling with linear and quadratic drag in wind: an independent rigid body by DOP853."""
    craft = SIH._replace(drag=0.4, drag_quadratic=0.03, inertia=(0.02, 0.03, 0.04))
    inertia, wind = np.array(craft.inertia), np.array([3.0, -2.0, 0.5])
    thrust = np.array([0.0, 0.0, -0.3 * 4 * craft.thrust_max])

    def derivative(_, s):
        turn = Rotation.from_quat(s[6:10])
        v, w = s[3:6], s[10:13]
        air = v - wind
        force = turn.apply(thrust) - (craft.drag + craft.drag_quadratic * np.linalg.norm(air)) * air
        spin = (-craft.angular_drag * w - np.cross(w, inertia * w)) / inertia
        q = 0.5 * np.array([*(s[9] * w + np.cross(s[6:9], w)), -s[6:9] @ w])
        return [*v, *(force / craft.mass + np.array([0, 0, GRAVITY])), *q, *spin]

    start = np.array([0, 0, -1000.0, 4, 1, -3, 0, 0, 0, 1, 1.5, -1.0, 2.0])
    expected = solve_ivp(derivative, (0, 2.0), start, method="DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
    body = falling()
    body.velocity[:], body.rates[:], body.air[:] = start[3:6], start[10:13], wind
    body.motors[:] = 0.3
    for _ in range(20_000):
        step_body(body, np.full(4, 0.3), craft, 0.0001)
    assert body.position == pytest.approx(expected[:3], abs=0.005)
    assert body.velocity == pytest.approx(expected[3:6], abs=0.005)
    assert body.rates == pytest.approx(expected[10:13], abs=0.005)
    error = Rotation.from_quat(body.attitude, scalar_first=True).inv() * Rotation.from_quat(expected[6:10])
    assert math.degrees(error.magnitude()) < 0.1


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
