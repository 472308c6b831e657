"""Rigid-body dynamics of a quadrotor, compiled.

The model is that of PX4's SIH quadrotor (parameters SIH_*): four first-order motors, linear drag, angular drag, flat
ground; and on top quadratic drag, the drag of a flat panel, and wind: drag acts on the velocity through the air.
Frames: NED world, FRD body; the attitude quaternion (w, x, y, z) turns body into world.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sitl.flight.compiled import compiled

GRAVITY = 9.80665
"""Standard gravity [m/s2], CONSTANTS_ONE_G in PX4."""

ROLL_SIGN = (-1.0, 1.0, 1.0, -1.0)
PITCH_SIGN = (1.0, -1.0, 1.0, -1.0)
YAW_SIGN = (1.0, 1.0, -1.0, -1.0)
"""What one motor's thrust does: 0 front right, 1 rear left, 2 front left, 3 rear right (PX4's quad x)."""


class Rotorcraft(NamedTuple):
    """What the vehicle is made of; each field is a SIH_* parameter."""

    mass: float
    """SIH_MASS [kg]."""
    inertia: tuple[float, float, float]
    """SIH_IXX, SIH_IYY, SIH_IZZ [kg m2]."""
    arm_roll: float
    """SIH_L_ROLL [m]."""
    arm_pitch: float
    """SIH_L_PITCH [m]."""
    thrust_max: float
    """SIH_T_MAX [N] of one motor."""
    torque_max: float
    """SIH_Q_MAX [N m] of one motor."""
    motor_lag: float
    """SIH_T_TAU [s]."""
    drag: float
    """SIH_KDV [N/(m/s)]."""
    angular_drag: float
    """SIH_KDW [N m/(rad/s)]."""
    drag_quadratic: float = 0.0
    """[N/(m/s)2] against the speed through the air, in every direction alike."""
    panel: float = 0.0
    """[N/(m/s)2] of a flat panel across the body's x axis: 1/2 rho S C_d, as in `airframe.power.drag_force`."""
    health: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """What is left of each motor's thrust; 0 = failed."""


class Body(NamedTuple):
    """The moving state; arrays of float64 that `step_body` changes in place."""

    position: NDArray[np.float64]
    """[3] NED [m]; the ground is at down = 0."""
    velocity: NDArray[np.float64]
    """[3] NED [m/s]."""
    attitude: NDArray[np.float64]
    """[4] unit quaternion body to NED, w first."""
    rates: NDArray[np.float64]
    """[3] FRD [rad/s]."""
    motors: NDArray[np.float64]
    """[4] thrust of each motor over its maximum, 0 to 1."""
    specific_force: NDArray[np.float64]
    """[3] FRD [m/s2]: what an accelerometer feels."""
    contact_s: NDArray[np.float64]
    """[1] how long the vehicle has stood on the ground [s]; 0 in the air."""
    air: NDArray[np.float64]
    """[3] velocity of the air around the vehicle, NED [m/s]."""


def body_at_rest() -> Body:
    """On the ground at the origin, facing north, motors off."""
    return Body(
        position=np.zeros(3),
        velocity=np.zeros(3),
        attitude=np.array([1.0, 0.0, 0.0, 0.0]),
        rates=np.zeros(3),
        motors=np.zeros(4),
        specific_force=np.array([0.0, 0.0, -GRAVITY]),
        contact_s=np.zeros(1),
        air=np.zeros(3),
    )


@compiled
def rotate(q: NDArray[np.float64], x: float, y: float, z: float) -> tuple[float, float, float]:
    """Body vector to world."""
    w, a, b, c = q[0], q[1], q[2], q[3]
    return (
        (1 - 2 * (b * b + c * c)) * x + 2 * (a * b - w * c) * y + 2 * (a * c + w * b) * z,
        2 * (a * b + w * c) * x + (1 - 2 * (a * a + c * c)) * y + 2 * (b * c - w * a) * z,
        2 * (a * c - w * b) * x + 2 * (b * c + w * a) * y + (1 - 2 * (a * a + b * b)) * z,
    )


@compiled
def rotate_back(q: NDArray[np.float64], x: float, y: float, z: float) -> tuple[float, float, float]:
    """World vector to body."""
    w, a, b, c = q[0], q[1], q[2], q[3]
    return (
        (1 - 2 * (b * b + c * c)) * x + 2 * (a * b + w * c) * y + 2 * (a * c - w * b) * z,
        2 * (a * b - w * c) * x + (1 - 2 * (a * a + c * c)) * y + 2 * (b * c + w * a) * z,
        2 * (a * c + w * b) * x + 2 * (b * c - w * a) * y + (1 - 2 * (a * a + b * b)) * z,
    )


@compiled
def heading(q: NDArray[np.float64]) -> float:
    """Yaw [rad], 0 = north, clockwise."""
    return math.atan2(2 * (q[0] * q[3] + q[1] * q[2]), 1 - 2 * (q[2] * q[2] + q[3] * q[3]))


def euler(q: NDArray[np.float64]) -> tuple[float, float, float]:
    """Roll, pitch, yaw [rad] of an attitude."""
    w, x, y, z = q.tolist()
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        math.asin(min(max(2 * (w * y - x * z), -1.0), 1.0)),
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


@compiled
def turn(q: NDArray[np.float64], rates: NDArray[np.float64], dt: float) -> None:
    """Turn the attitude by constant body rates for dt: exact, and normalised again."""
    wx, wy, wz = rates[0], rates[1], rates[2]
    rate = math.sqrt(wx * wx + wy * wy + wz * wz)
    half = 0.5 * rate * dt
    scale = 0.5 * dt if rate < 1e-9 else math.sin(half) / rate
    w, x, y, z = math.cos(half), wx * scale, wy * scale, wz * scale
    a, b, c, d = q[0], q[1], q[2], q[3]
    q[0] = a * w - b * x - c * y - d * z
    q[1] = a * x + b * w + c * z - d * y
    q[2] = a * y - b * z + c * w + d * x
    q[3] = a * z + b * y - c * x + d * w
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] /= norm


@compiled
def drag_force(body: Body, craft: Rotorcraft) -> tuple[float, float, float]:
    """Force of the air [N], NED: linear and quadratic drag against the airspeed, and the push on the panel."""
    x, y, z = body.velocity[0] - body.air[0], body.velocity[1] - body.air[1], body.velocity[2] - body.air[2]
    k = craft.drag + craft.drag_quadratic * math.sqrt(x * x + y * y + z * z)
    nx, ny, nz = rotate(body.attitude, 1.0, 0.0, 0.0)
    across = nx * x + ny * y + nz * z
    push = craft.panel * abs(across) * across
    return -k * x - push * nx, -k * y - push * ny, -k * z - push * nz


@compiled
def step_body(body: Body, commands: NDArray[np.float64], craft: Rotorcraft, dt: float) -> None:
    """Move the body by dt under motor commands [4] in 0 to 1 (semi-implicit Euler)."""
    lag = 1.0 - math.exp(-dt / craft.motor_lag)
    thrust = 0.0
    roll = 0.0
    pitch = 0.0
    yaw = 0.0
    for i in range(4):
        body.motors[i] += (commands[i] * craft.health[i] - body.motors[i]) * lag
        thrust += body.motors[i]
        roll += ROLL_SIGN[i] * body.motors[i]
        pitch += PITCH_SIGN[i] * body.motors[i]
        yaw += YAW_SIGN[i] * body.motors[i]

    p, v, w = body.position, body.velocity, body.rates
    ax, ay, az = rotate(body.attitude, 0.0, 0.0, -craft.thrust_max * thrust / craft.mass)
    bx, by, bz = drag_force(body, craft)
    ax += bx / craft.mass
    ay += by / craft.mass
    az += bz / craft.mass

    if p[2] >= 0.0 and v[2] + (az + GRAVITY) * dt >= 0.0:
        stand(body, dt)
        return
    body.contact_s[0] = 0.0
    fx, fy, fz = rotate_back(body.attitude, ax, ay, az)
    body.specific_force[0], body.specific_force[1], body.specific_force[2] = fx, fy, fz
    v[0] += ax * dt
    v[1] += ay * dt
    v[2] += (az + GRAVITY) * dt
    for i in range(3):
        p[i] += v[i] * dt

    jx, jy, jz = craft.inertia
    mx = craft.arm_roll * craft.thrust_max * roll - craft.angular_drag * w[0] - (jz - jy) * w[1] * w[2]
    my = craft.arm_pitch * craft.thrust_max * pitch - craft.angular_drag * w[1] - (jx - jz) * w[2] * w[0]
    mz = craft.torque_max * yaw - craft.angular_drag * w[2] - (jy - jx) * w[0] * w[1]
    w[0] += mx / jx * dt
    w[1] += my / jy * dt
    w[2] += mz / jz * dt
    turn(body.attitude, w, dt)
    if p[2] >= 0.0:
        stand(body, dt)


@compiled
def stand(body: Body, dt: float) -> None:
    """Rest on flat ground: no bounce, no slide, level, heading kept."""
    yaw = heading(body.attitude)
    body.position[2] = 0.0
    for i in range(3):
        body.velocity[i] = 0.0
        body.rates[i] = 0.0
    body.attitude[0] = math.cos(0.5 * yaw)
    body.attitude[1] = 0.0
    body.attitude[2] = 0.0
    body.attitude[3] = math.sin(0.5 * yaw)
    body.specific_force[0], body.specific_force[1], body.specific_force[2] = 0.0, 0.0, -GRAVITY
    body.contact_s[0] += dt
