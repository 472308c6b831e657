"""The rigid body against RotorPy, written by others: same airframe, same motor thrusts, its own integrator.

RotorPy has z up and x forward, y left; its rotors' speeds follow their commands with a lag, ours their thrusts. So it
is given a lag of almost none and the speeds that make our thrusts, step by step. What is compared is all else.
"""

import numpy as np
import pytest
from rotorpy.vehicles.multirotor import Multirotor
from scipy.spatial.transform import Rotation

from sitl.flight.physics import GRAVITY, PITCH_SIGN, ROLL_SIGN, YAW_SIGN, Rotorcraft, body_at_rest, step_body
from sitl.parameters import Parameters
from sitl.px4.parameters import TABLE
from sitl.px4.vehicle_setup import rotorcraft

DT = 0.001
FLIP = np.array([1.0, -1.0, -1.0])
"""North-east-down to north-west-up, and forward-right-down to forward-left-up."""
CRAFT = rotorcraft(Parameters(TABLE))._replace(drag=0.0, angular_drag=0.0, inertia=(0.02, 0.03, 0.04))


def theirs(craft: Rotorcraft) -> Multirotor:
    """RotorPy's vehicle of the same mass, inertia, arms and quadratic drag; k_eta 1: speed squared is thrust."""
    roll, pitch, yaw = np.array(ROLL_SIGN), np.array(PITCH_SIGN), np.array(YAW_SIGN)
    # A thrust up at (x, y) makes the torques (y, -x) there, and (roll, pitch) = (y, x) after the flip of y.
    places = {f"r{i}": np.array([craft.arm_pitch * pitch[i], craft.arm_roll * roll[i], 0.0]) for i in range(4)}
    ix, iy, iz = craft.inertia
    vehicle = Multirotor(
        {
            "mass": craft.mass,
            "Ixx": ix,
            "Iyy": iy,
            "Izz": iz,
            **dict.fromkeys(("Ixy", "Ixz", "Iyz"), 0.0),
            **dict.fromkeys(("c_Dx", "c_Dy", "c_Dz"), craft.drag_quadratic),
            "num_rotors": 4,
            "rotor_pos": places,
            "rotor_directions": -yaw,
            "rotor_speed_min": 0.0,
            "rotor_speed_max": 1000.0,
            "k_eta": 1.0,
            "k_m": craft.torque_max / craft.thrust_max,
            "tau_m": 1e-3,
        },
        integrator_kwargs={"method": "RK45", "rtol": 1e-9, "atol": 1e-10},
    )
    vehicle.g = GRAVITY
    vehicle.weight = np.array([0.0, 0.0, -craft.mass * GRAVITY])
    return vehicle


def compared(craft: Rotorcraft, commands, seconds: float, velocity=(0, 0, 0), rates=(0, 0, 0), wind=(0, 0, 0)):
    """Our body and their state after the same motor commands(t) [4]."""
    body = body_at_rest()
    body.position[2] = -1000.0
    body.velocity[:], body.rates[:], body.air[:] = velocity, rates, wind
    body.motors[:] = commands(0.0)
    vehicle = theirs(craft)
    state = {
        "x": body.position * FLIP,
        "v": body.velocity * FLIP,
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": body.rates * FLIP,
        "wind": np.array(wind) * FLIP,
        "rotor_speeds": np.sqrt(craft.thrust_max * body.motors),
    }
    steps = round(seconds / DT)
    every = 10  # theirs is slow, and needs no small steps
    for i in range(0, steps, every):
        before = body.motors.copy()
        for j in range(every):
            step_body(body, np.asarray(commands((i + j) * DT), float), craft, DT)
        speeds = np.sqrt(craft.thrust_max * 0.5 * (before + body.motors))
        state["rotor_speeds"] = speeds
        state = vehicle.step(state, {"cmd_motor_speeds": speeds}, every * DT)
    return body, state


def assert_same(body, state, position_m: float, velocity: float, angle_deg: float) -> None:
    assert body.position * FLIP == pytest.approx(state["x"], abs=position_m)
    assert body.velocity * FLIP == pytest.approx(state["v"], abs=velocity)
    assert body.rates * FLIP == pytest.approx(state["w"], abs=np.radians(angle_deg))
    w, x, y, z = body.attitude
    ours = Rotation.from_quat([x, -y, -z, w])
    assert np.degrees((ours.inv() * Rotation.from_quat(state["q"])).magnitude()) < angle_deg


HOVER = CRAFT.mass * GRAVITY / 4.0 / CRAFT.thrust_max


def test_free_response_spinning_without_thrust():
    """A tumbling body: Euler's equations and free fall."""
    body, state = compared(CRAFT, lambda _: np.zeros(4), 2.0, velocity=(3, -2, -5), rates=(2.0, 1.0, -3.0))
    assert_same(body, state, position_m=0.02, velocity=0.01, angle_deg=0.5)


@pytest.mark.parametrize("motor", range(4))
def test_step_of_one_motor(motor):
    """From hover one motor gives 2 % more: roll, pitch, yaw and what they do to the path."""

    def commands(t: float):
        u = np.full(4, HOVER)
        u[motor] += 0.02 * HOVER if t >= 0.1 else 0.0
        return u

    body, state = compared(CRAFT, commands, 1.0)
    assert np.linalg.norm(body.rates) > 0.3  # it really turned
    assert_same(body, state, position_m=0.01, velocity=0.02, angle_deg=0.5)


def test_terminal_velocity_of_quadratic_drag():
    """m g = k v^2."""
    craft = CRAFT._replace(drag_quadratic=0.05)
    body, state = compared(craft, lambda _: np.zeros(4), 8.0)
    terminal = np.sqrt(craft.mass * GRAVITY / 0.05)
    assert body.velocity[2] == pytest.approx(terminal, rel=0.001)
    assert state["v"][2] == pytest.approx(-terminal, rel=0.001)


def test_wind_pushes_by_quadratic_drag():
    craft = CRAFT._replace(drag_quadratic=0.05)
    body, state = compared(craft, lambda _: np.full(4, HOVER), 3.0, velocity=(2, 0, 0), wind=(-4, 6, 1))
    assert body.velocity[1] > 2.0
    assert_same(body, state, position_m=0.02, velocity=0.01, angle_deg=0.1)
