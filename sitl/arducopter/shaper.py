"""ArduCopter's input shaping: a velocity asked for becomes a reference that respects acceleration and jerk limits.

The laws are those of ArduPilot's AP_Math/control.cpp: the acceleration wished for is a square-root controller of the
velocity error, the acceleration follows it inside the jerk limit, and position and velocity are its integrals.
"""

import math
from dataclasses import dataclass

from sitl.flight.reference import Vec3

LAG_MAX_M = 1.0
"""The reference waits for a vehicle that is further behind: ArduPilot moves it no further into a direction in which the
lean angle is at its limit. Unlimited flight lags less than this."""
SPEED_LAG_MAX = 1.0
"""Likewise for velocity [m/s]."""
OVERSPEED_GAIN = 2.0
"""POSCONTROL_OVERSPEED_GAIN_Z."""
SPEED_MAX = 100.0
"""No more than this is ever asked for [m/s], so that numbers stay numbers."""


@dataclass(frozen=True)
class Shape:
    """Limits [m/s2, m/s3]."""

    acceleration_xy: float
    jerk_xy: float
    acceleration_z: float
    jerk_z: float
    speed_up: float = math.inf
    """Above these [m/s] vertical acceleration and jerk are raised by OVERSPEED_GAIN and the excess ..."""
    speed_down: float = math.inf

    def overspeed(self, down: float) -> float:
        """... by this factor at a vertical speed [m/s] (AC_PosControl's calculate_overspeed_gain)."""
        excess = max(down / self.speed_down, -down / self.speed_up)
        return OVERSPEED_GAIN * excess if excess > 1.0 else 1.0


@dataclass(frozen=True)
class Motion:
    """The reference, NED."""

    position: Vec3
    velocity: Vec3
    acceleration: Vec3


def square_root(error: float, gain: float, second_limit: float) -> float:
    """Proportional near zero, the root of a constant deceleration further out (sqrt_controller)."""
    linear = second_limit / (gain * gain)
    if abs(error) <= linear:
        return error * gain
    return math.copysign(math.sqrt(2.0 * second_limit * (abs(error) - 0.5 * linear)), error)


def shaped(motion: Motion, wish: Vec3, shape: Shape, dt: float) -> Motion:
    """Move on by dt [s] towards the velocity `wish`."""
    v, a = motion.velocity, motion.acceleration
    ex, ey = wish[0] - v[0], wish[1] - v[1]
    error = math.hypot(ex, ey)
    share = 0.0
    if error > 1e-9:
        gain = shape.jerk_xy / shape.acceleration_xy
        share = min(square_root(error, gain, shape.jerk_xy), shape.acceleration_xy) / error
    dx, dy = ex * share - a[0], ey * share - a[1]
    change = math.hypot(dx, dy)
    part = min(1.0, shape.jerk_xy * dt / change) if change > 1e-12 else 1.0
    more = shape.overspeed(v[2])
    jerk_z, most_z = more * shape.jerk_z, more * shape.acceleration_z
    up = square_root(wish[2] - v[2], jerk_z / most_z, jerk_z)
    step_z = jerk_z * dt
    dz = min(max(up, -most_z), most_z) - a[2]
    acceleration = (a[0] + dx * part, a[1] + dy * part, a[2] + min(max(dz, -step_z), step_z))
    return moved(motion, acceleration, dt)


def eased_speed(distance: float, top: float, acceleration: float, jerk: float) -> float:
    """Speed [m/s] at a distance [m] from rest on an S-curve that brakes from `top` (AP_Math/SCurve.cpp)."""
    if top <= 0.0:
        return 0.0
    peak = min(acceleration, math.sqrt(jerk * top))
    ease = peak / jerk
    slow = 0.5 * peak * ease
    last = peak * ease * ease / 6.0
    if distance <= last:
        return 0.5 * jerk * math.pow(6.0 * distance / jerk, 2.0 / 3.0)
    fast = top - slow
    steady = last + (fast * fast - slow * slow) / (2.0 * peak)
    if distance <= steady:
        return math.sqrt(slow * slow + 2.0 * peak * (distance - last))
    begun = steady + top * ease - peak * ease * ease / 6.0 - distance
    if begun <= 0.0:
        return top
    t = begun / top
    for _ in range(4):
        t += (begun - top * t + jerk * t * t * t / 6.0) / (top - 0.5 * jerk * t * t)
    return top - 0.5 * jerk * t * t


def moved(motion: Motion, acceleration: Vec3, dt: float) -> Motion:
    """Integrate an acceleration over dt."""
    p, v = motion.position, motion.velocity
    return Motion(
        (
            p[0] + v[0] * dt + 0.5 * acceleration[0] * dt * dt,
            p[1] + v[1] * dt + 0.5 * acceleration[1] * dt * dt,
            p[2] + v[2] * dt + 0.5 * acceleration[2] * dt * dt,
        ),
        (v[0] + acceleration[0] * dt, v[1] + acceleration[1] * dt, v[2] + acceleration[2] * dt),
        acceleration,
    )


def held_back(motion: Motion, position: Vec3, velocity: Vec3) -> Motion:
    """The reference, no further from the vehicle than it can be followed."""
    return Motion(
        near(motion.position, position, LAG_MAX_M), near(motion.velocity, velocity, SPEED_LAG_MAX), motion.acceleration
    )


def near(wanted: Vec3, actual: Vec3, reach: float) -> Vec3:
    """`wanted`, moved towards `actual` to within `reach`."""
    distance = math.dist(wanted, actual)
    if distance <= reach:
        return wanted
    k = reach / distance
    return (
        actual[0] + (wanted[0] - actual[0]) * k,
        actual[1] + (wanted[1] - actual[1]) * k,
        actual[2] + (wanted[2] - actual[2]) * k,
    )


def limited(velocity: Vec3) -> Vec3:
    """A velocity of at most SPEED_MAX."""
    return near(velocity, (0.0, 0.0, 0.0), SPEED_MAX)
