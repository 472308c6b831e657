"""The envelope: nothing reaches the autopilot that it does not let through, whatever planned or asked for it.

Every setpoint passes, in this order: finite; speed limits; acceleration (no command asks for a change of velocity that
takes longer than `RESPONSE_S` at the acceleration limit); fence and altitude band.

The fence is kept by looking one step ahead with the vehicle's stop as a backup. A state is *safe* when the vehicle,
reacting after `reaction_s` and then braking straight at the acceleration limit, stops inside. A command is let through
when the state that it leads to in one step is safe. Else it is blended with zero, first along the axes in the way,
so that the vehicle slides along the fence, then as a whole. Zero, which is braking, always leads from a safe state to
a safe one: the fence is convex, and braking only moves the stopping point back.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airframe.slot_profile import Vector
from airframe.stopping import stop_distance
from autopilot_bridge.config import Box, Limits

RESPONSE_S = 1.5
"""A command may be ahead of the measured velocity by this long at the acceleration limit."""
BISECTIONS = 20


@dataclass(frozen=True)
class Sent:
    """What was really sent, and why it is not what was wanted."""

    velocity: Vector
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Envelope:
    """The last gate before the autopilot; `transmit(velocity_enu, yaw_enu)` puts a setpoint on the wire."""

    limits: Limits
    fence: Box
    reaction_s: float
    step_s: float
    transmit: Callable[[Vector, float], None]

    def send(self, wanted: Vector, yaw: float, position: Vector, velocity: Vector) -> Sent:
        """Clip `wanted` [m/s, ENU] for a vehicle at `position`, `velocity`; transmit it; say what was sent and why."""
        sent = self.clip(wanted, position, velocity)
        self.transmit(sent.velocity, yaw)
        return sent

    def clip(self, wanted: Vector, position: Vector, velocity: Vector) -> Sent:
        """What `send` would transmit."""
        if not (np.isfinite(wanted).all() and np.isfinite(position).all() and np.isfinite(velocity).all()):
            return Sent(np.zeros(3), ("not finite",))
        reasons: list[str] = []

        slower = self._limit_speed(wanted)
        if not np.array_equal(slower, wanted):
            reasons.append("speed")

        change = slower - velocity
        size, most = float(np.linalg.norm(change)), self.limits.acceleration_mps2 * RESPONSE_S
        gentler = slower if size <= most else self._limit_speed(velocity + change * (most / size))
        if gentler is not slower:
            reasons.append("acceleration")

        def in_the_way(command: Vector) -> NDArray[np.bool_]:
            after = ideal_step(position, velocity, command, self.limits.acceleration_mps2, self.step_s)
            return outside(self.fence, stopping_point(*after, self.limits.acceleration_mps2, self.reaction_s))

        safe = nearest_inside(gentler, np.zeros(3), in_the_way)
        if safe is not gentler:
            blocked = in_the_way(gentler)
            reasons += ["fence"] * bool(blocked[:2].any()) + ["altitude"] * bool(blocked[2])
        return Sent(safe, () if np.array_equal(safe, wanted) else tuple(reasons))

    def _limit_speed(self, velocity: Vector) -> Vector:
        horizontal = float(np.hypot(velocity[0], velocity[1]))
        vertical = min(max(float(velocity[2]), -self.limits.down_mps), self.limits.up_mps)
        if horizontal <= self.limits.horizontal_mps and vertical == velocity[2]:
            return velocity
        shorter = min(1.0, self.limits.horizontal_mps / horizontal) if horizontal > 0 else 1.0
        return np.array([velocity[0] * shorter, velocity[1] * shorter, vertical])


def stopping_point(position: Vector, velocity: Vector, deceleration: float, reaction_s: float = 0.0) -> Vector:
    """Where a vehicle comes to rest that brakes straight after `reaction_s`; shapes (..., 3)."""
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    point: Vector = position + velocity * stop_distance(speed, deceleration, reaction_s) / np.maximum(speed, 1e-9)
    return point


def outside(box: Box, points: Vector) -> NDArray[np.bool_]:
    """Per axis, whether any of the `points` (..., 3) is outside; shape (3,)."""
    low, high = np.array(box.spans).T
    flat = points.reshape(-1, 3)
    return np.asarray(((flat < low - 1e-6) | (flat > high + 1e-6)).any(axis=0))


def nearest_inside(wanted: Vector, fallback: Vector, in_the_way: Callable[[Vector], NDArray[np.bool_]]) -> Vector:
    """`wanted` itself when nothing is in the way; else blended with `fallback`, as little as needed.

    Only along the axes in the way if that helps, else along all. `in_the_way(candidate)` tells per axis. When even
    `fallback` is blocked it is returned all the same: there is nothing better.
    """
    blocked = in_the_way(wanted)
    if not blocked.any():
        return wanted
    for target in (np.where(blocked, fallback, wanted), fallback):
        if in_the_way(target).any():
            continue
        good, bad = 0.0, 1.0
        for _ in range(BISECTIONS):
            share = (good + bad) / 2
            if in_the_way(target + share * (wanted - target)).any():
                bad = share
            else:
                good = share
        return target + good * (wanted - target)
    return fallback


def ideal_step(
    position: Vector, velocity: Vector, command: Vector, acceleration: float, step_s: float
) -> tuple[Vector, Vector]:
    """(position, velocity) after `step_s` of a vehicle whose velocity goes straight to `command` at `acceleration`."""
    change = command - velocity
    size = float(np.linalg.norm(change))
    ramp_s = min(step_s, size / acceleration)
    gained = change * (acceleration * ramp_s / size) if size > 0 else np.zeros(3)
    reached = velocity + gained
    return position + velocity * ramp_s + gained * (ramp_s / 2) + reached * (step_s - ramp_s), reached
