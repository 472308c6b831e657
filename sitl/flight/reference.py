"""Smooth references for the autonomous modes: a point that moves to a target inside speed and acceleration limits."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vec3 = tuple[float, float, float]

ERROR_MAX_M = 2.0
"""MPC_XY_ERR_MAX: the reference waits as the vehicle falls behind it, and stands at this distance."""


def vector(array: NDArray[np.float64]) -> Vec3:
    """A float64 [3] array as three floats."""
    return float(array[0]), float(array[1]), float(array[2])


def turned(yaw: float, goal: float, step: float) -> float:
    """Yaw moved towards goal by at most `step`, the shorter way round [rad]."""
    error = math.remainder(goal - yaw, 2.0 * math.pi)
    return math.remainder(yaw + min(max(error, -step), step), 2.0 * math.pi)


@dataclass(frozen=True)
class Limits:
    """What a reference may do [m/s, m/s2, m/s3]."""

    speed_xy: float
    speed_up: float
    speed_down: float
    acceleration_xy: float
    acceleration_z: float
    braking_z: float
    jerk: float


@dataclass(frozen=True)
class Reference:
    """Where the vehicle should be and how fast, NED."""

    position: Vec3
    velocity: Vec3
    acceleration: Vec3 = (0.0, 0.0, 0.0)
    """Where it is followed with limited jerk."""


def speed_for_distance(distance: float, acceleration: float, jerk: float) -> float:
    """Highest speed [m/s] from which a jerk- and acceleration-limited stop takes `distance` [m]."""
    b = 4.0 * acceleration * acceleration / jerk
    return 0.5 * (math.sqrt(b * b + 8.0 * acceleration * distance) - b)


def distance_for_speed(speed: float, acceleration: float, jerk: float) -> float:
    """The inverse: where a vehicle at `speed` comes to rest [m]."""
    b = 4.0 * acceleration * acceleration / jerk
    return speed * (speed + b) / (2.0 * acceleration)


def stopping_point(moving: Reference, limits: Limits) -> Vec3:
    """Where something that brakes now comes to rest."""
    position, velocity = moving.position, moving.velocity
    speed = math.hypot(velocity[0], velocity[1])
    distance = distance_for_speed(speed, limits.acceleration_xy, limits.jerk)
    rise = distance_for_speed(abs(velocity[2]), limits.braking_z, limits.jerk)
    x, y = (velocity[0] / speed, velocity[1] / speed) if speed > 1e-3 else (0.0, 0.0)
    return (
        position[0] + x * distance,
        position[1] + y * distance,
        position[2] + math.copysign(rise, velocity[2]),
    )


def approach(reference: Reference, target: Vec3, actual: Vec3, limits: Limits, dt: float) -> Reference:
    """Move the reference towards `target` for dt, waiting for the vehicle at `actual` when that lags."""
    return follow(reference, wished(reference, target, limits), limits, stretched(reference, actual, dt))


def eased(reference: Reference, target: Vec3, actual: Vec3, limits: Limits, dt: float) -> Reference:
    """The same with limited jerk."""
    return follow_eased(reference, wished(reference, target, limits), limits, stretched(reference, actual, dt))


def wished(reference: Reference, target: Vec3, limits: Limits) -> Vec3:
    """The velocity with which the reference should move to `target` now."""
    p = reference.position
    dx, dy, dz = target[0] - p[0], target[1] - p[1], target[2] - p[2]
    distance = math.hypot(dx, dy)
    speed = min(limits.speed_xy, speed_for_distance(distance, limits.acceleration_xy, limits.jerk))
    wish_x, wish_y = (dx / distance * speed, dy / distance * speed) if distance > 1e-6 else (0.0, 0.0)
    wish_z = math.copysign(
        min(
            limits.speed_down if dz > 0 else limits.speed_up, speed_for_distance(abs(dz), limits.braking_z, limits.jerk)
        ),
        dz,
    )
    return (wish_x, wish_y, wish_z)


def stretched(reference: Reference, actual: Vec3, dt: float) -> float:
    """The time by which a reference moves on in dt, waiting for the vehicle at `actual` when that lags."""
    return dt * (1.0 - min(max(lead(reference, actual), 0.0) / ERROR_MAX_M, 1.0))


def lead(reference: Reference, actual: Vec3) -> float:
    """How far the reference is ahead of the vehicle, along its way [m]."""
    p, v = reference.position, reference.velocity
    speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if speed < 1e-6:
        return 0.0
    return sum((p[i] - actual[i]) * v[i] for i in range(3)) / speed


def follow(reference: Reference, wish: Vec3, limits: Limits, dt: float) -> Reference:
    """Bring the reference's velocity towards `wish` inside the acceleration limits, and move it."""
    v = reference.velocity
    ax, ay = wish[0] - v[0], wish[1] - v[1]
    change = math.hypot(ax, ay)
    share = min(1.0, limits.acceleration_xy * dt / change) if change > 1e-9 else 1.0
    step_z = limits.acceleration_z * dt
    velocity = (
        v[0] + ax * share,
        v[1] + ay * share,
        v[2] + min(max(wish[2] - v[2], -step_z), step_z),
    )
    p = reference.position
    return Reference((p[0] + velocity[0] * dt, p[1] + velocity[1] * dt, p[2] + velocity[2] * dt), velocity)


def follow_eased(reference: Reference, wish: Vec3, limits: Limits, dt: float) -> Reference:
    """`follow` with limited jerk: the acceleration eases in, and out again before `wish` is reached."""
    v, a, jerk = reference.velocity, reference.acceleration, limits.jerk
    ex, ey, ez = wish[0] - v[0], wish[1] - v[1], wish[2] - v[2]
    error = math.hypot(ex, ey)
    share = min(limits.acceleration_xy, math.sqrt(2.0 * jerk * error), error / max(dt, 1e-9)) / max(error, 1e-9)
    dx, dy = ex * share - a[0], ey * share - a[1]
    change = math.hypot(dx, dy)
    part = min(1.0, jerk * dt / change) if change > 1e-12 else 1.0
    most_z = min(limits.acceleration_z, math.sqrt(2.0 * jerk * abs(ez)), abs(ez) / max(dt, 1e-9))
    dz = math.copysign(most_z, ez) - a[2]
    acceleration = (a[0] + dx * part, a[1] + dy * part, a[2] + min(max(dz, -jerk * dt), jerk * dt))
    velocity = (v[0] + acceleration[0] * dt, v[1] + acceleration[1] * dt, v[2] + acceleration[2] * dt)
    p = reference.position
    moved = (p[0] + velocity[0] * dt, p[1] + velocity[1] * dt, p[2] + velocity[2] * dt)
    return Reference(moved, velocity, acceleration)
