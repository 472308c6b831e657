"""The slot profile: how far of a commanded displacement the vehicle can really fly in one slot.

The paper moves the UAV by up to V_max * slot at each slot as if by teleport. A multicopter changes its velocity at a
limited rate, so a slot starts with the velocity that the last one ended with. The profile turns the commanded
displacement d over the slot T, from the reference (p0, v0), into a constant acceleration a along u, the direction of
d - v0 T, for s / a seconds, and a constant velocity after that, where s solves

    s T - s^2 / (2 a) = |d - v0 T|,      s <= a T,      v0 + s u within the speed limits.

It ends in p0 + d when that is reachable. Position and velocity are continuous from slot to slot by construction, since
each slot starts where the last one's profile ended.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]
"""Shape (3,) or (..., 3): east, north, up."""


class SpeedLimits(NamedTuple):
    """Largest horizontal speed, climb rate and descent rate, all positive [m/s]."""

    horizontal: float
    up: float
    down: float


class Reference(NamedTuple):
    """What the vehicle should be doing at some instant: shape (..., 3) each; m, m/s, m/s2."""

    position: Vector
    velocity: Vector
    acceleration: Vector


@dataclass(frozen=True)
class SlotProfile:
    """Constant acceleration for `ramp_s`, constant velocity after it."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    ramp_s: float
    limited_by: tuple[str, ...] = ()
    """What kept the profile from the commanded displacement: `speed`, `climb`, `acceleration`."""

    def at(self, time_s: ArrayLike) -> Reference:
        """The reference at times [s] since the profile's start; `time_s` of shape (...) gives vectors (..., 3)."""
        t = np.maximum(np.asarray(time_s, dtype=float), 0.0)[..., None]
        ramp = np.minimum(t, self.ramp_s)
        return Reference(
            self.position + self.velocity * t + self.acceleration * (ramp * t - ramp * ramp / 2),
            self.velocity + self.acceleration * ramp,
            np.where(t < self.ramp_s, self.acceleration, 0.0),
        )

    def displacement(self, slot_s: float) -> Vector:
        """Planned displacement [m] after `slot_s`."""
        return self.at(slot_s).position - self.position


def reach(
    position: Vector,
    velocity: Vector,
    displacement: Vector,
    slot_s: float,
    acceleration: float,
    limits: SpeedLimits,
) -> SlotProfile:
    """The profile from (`position`, `velocity`) towards `displacement` [m] over `slot_s`, as far as the limits let it.

    `acceleration` [m/s2] limits the ramp. `velocity` should lie within the speed limits: then so does every velocity of
    the profile.
    """
    wanted = _within_speed(displacement, slot_s, limits)
    limited_by = []
    if not np.array_equal(wanted[:2], displacement[:2]):
        limited_by.append("speed")
    if wanted[2] != displacement[2]:
        limited_by.append("climb")

    shortfall = wanted - velocity * slot_s
    distance = float(np.linalg.norm(shortfall))
    if distance < 1e-9:
        return SlotProfile(position, velocity, np.zeros(3), 0.0, tuple(limited_by))
    direction = shortfall / distance
    fastest = acceleration * slot_s
    speed_change = fastest - max(fastest * fastest - 2 * acceleration * distance, 0.0) ** 0.5
    if distance > fastest * slot_s / 2 + 1e-9:
        limited_by.append("acceleration")
    room = _speed_room(velocity, direction, limits)
    if room < speed_change - 1e-9:
        limited_by.append("speed")
    ramp_s = min(speed_change, room) / acceleration
    return SlotProfile(position, velocity, direction * acceleration, ramp_s, tuple(dict.fromkeys(limited_by)))


def brake(position: Vector, velocity: Vector, acceleration: float) -> SlotProfile:
    """The planned hold: straight to rest at `acceleration` [m/s2], and there for as long as wanted."""
    speed = float(np.linalg.norm(velocity))
    if speed < 1e-9:
        return SlotProfile(position, np.zeros(3), np.zeros(3), 0.0)
    return SlotProfile(position, velocity, velocity * (-acceleration / speed), speed / acceleration)


def _within_speed(displacement: Vector, slot_s: float, limits: SpeedLimits) -> Vector:
    """Horizontal part shortened to what its limit allows in a slot, vertical part clipped to its own."""
    horizontal, furthest = float(np.hypot(displacement[0], displacement[1])), limits.horizontal * slot_s
    shorter = furthest / horizontal if horizontal > furthest else 1.0
    climb = np.clip(displacement[2], -limits.down * slot_s, limits.up * slot_s)
    return np.array([displacement[0] * shorter, displacement[1] * shorter, climb])


def _speed_room(velocity: Vector, direction: Vector, limits: SpeedLimits) -> float:
    """The largest s for which velocity + s * direction is within the limits; infinite when velocity itself is not."""
    vx, vy, vz = velocity
    ux, uy, uz = direction
    spare = limits.horizontal**2 - vx * vx - vy * vy
    if spare < -1e-9 or not -limits.down - 1e-9 <= vz <= limits.up + 1e-9:
        return float("inf")
    room = float("inf")
    if uz > 1e-12:
        room = max(0.0, (limits.up - vz) / uz)
    elif uz < -1e-12:
        room = max(0.0, (-limits.down - vz) / uz)
    along, across = vx * ux + vy * uy, ux * ux + uy * uy
    if across > 1e-12:
        room = min(room, (-along + (along * along + across * max(spare, 0.0)) ** 0.5) / across)
    return float(room)
