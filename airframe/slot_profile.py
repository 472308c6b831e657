"""The slot profile: how far of a commanded displacement the vehicle can really fly in one slot.

The paper moves the UAV by up to V_max * slot at each slot as if by teleport. A multicopter changes its velocity at a
limited rate, and that rate at a limited rate again. So a slot starts with the velocity v0 and the acceleration a0 that
the last one ended with, and the profile turns the commanded displacement d over the slot T into one pulse:

    a(t): from a0 to a1 in a straight line at the jerk limit, a1 held, from a1 to zero at the jerk limit; then coasting

with a1 as large as the acceleration limit lets it and the pulse as short as it can be, such that it ends in p0 + d at
T when that is within reach. The way back to zero begins at T at the latest, so that no profile gathers more speed than
its own slot has use for. Without a jerk limit this is a constant acceleration a along d - v0 T for s / a seconds, with

    s T - s^2 / (2 a) = |d - v0 T|,      s <= a T.

Position, velocity and (with a jerk limit) acceleration are continuous from slot to slot by construction, since each
slot starts where the last one's profile ended. The limits of acceleration and jerk are spheres, or ellipsoids whose
vertical half-axis is `vertical_share` of the horizontal one; all sums are done with the vertical axis stretched.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]
"""Shape (3,) or (..., 3): east, north, up."""

ROUNDS = 60
"""Most steps of a root search; some ten are needed."""
PIECES = 8
TRIALS = 20
"""Bisections of a turn that would be too fast on its way."""


class SpeedLimits(NamedTuple):
    """Largest horizontal speed, climb rate and descent rate, all positive [m/s]."""

    horizontal: float
    up: float
    down: float


class Agility(NamedTuple):
    """How fast a velocity may change."""

    acceleration: float
    """Horizontal [m/s2]."""
    jerk: float = math.inf
    """Horizontal [m/s3]."""
    vertical_share: float = 1.0
    """Both limits' vertical half-axis as a share of the horizontal one."""


class Reference(NamedTuple):
    """What the vehicle should be doing at some instant: shape (..., 3) each; m, m/s, m/s2."""

    position: Vector
    velocity: Vector
    acceleration: Vector


@dataclass(frozen=True)
class SlotProfile:
    """One pulse of acceleration, constant velocity after it."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    """At the start."""
    peak: Vector
    """The acceleration that is held."""
    ramp_up_s: float
    hold_s: float
    ramp_down_s: float
    limited_by: tuple[str, ...] = ()
    """What kept the profile from the commanded displacement: `speed`, `climb`, `acceleration` (or the jerk)."""

    @property
    def duration_s(self) -> float:
        """Until the velocity no longer changes."""
        return self.ramp_up_s + self.hold_s + self.ramp_down_s

    def at(self, time_s: ArrayLike) -> Reference:
        """The reference at times [s] since the profile's start; `time_s` of shape (...) gives vectors (..., 3)."""
        t = np.maximum(np.asarray(time_s, dtype=float), 0.0)[..., None]
        up = _ramp(t, self.ramp_up_s)
        down = _ramp(t - self.ramp_up_s - self.hold_s, self.ramp_down_s)
        first = (t * t / 2 - up[2], t - up[1], 1.0 - up[0])
        then = tuple(rise - fall for rise, fall in zip(reversed(up), reversed(down), strict=True))
        moved, gained, acceleration = (
            self.acceleration * share + self.peak * other for share, other in zip(first, then, strict=True)
        )
        return Reference(self.position + self.velocity * t + moved, self.velocity + gained, acceleration)

    def displacement(self, slot_s: float) -> Vector:
        """Planned displacement [m] after `slot_s`."""
        return self.at(slot_s).position - self.position


def reach(
    position: Vector,
    velocity: Vector,
    displacement: Vector,
    slot_s: float,
    acceleration: float | Agility,
    limits: SpeedLimits,
    initial_acceleration: Vector | None = None,
) -> SlotProfile:
    """The profile from (`position`, `velocity`) towards `displacement` [m] over `slot_s`, as far as the limits let it.

    `acceleration` is a limit [m/s2] of any direction, or an `Agility`. `velocity`, and where the jerk limit lets it
    settle from `initial_acceleration`, should lie within the speed limits: then so does every velocity of the profile.
    """
    agility = acceleration if isinstance(acceleration, Agility) else Agility(acceleration)
    wanted = _within_speed(displacement, slot_s, limits)
    limited_by = []
    if not np.array_equal(wanted[:2], displacement[:2]):
        limited_by.append("speed")
    if wanted[2] != displacement[2]:
        limited_by.append("climb")

    start = _Start(position, velocity, initial_acceleration, agility)
    pulse, reached = start.pulse_to_place(wanted, slot_s)
    if not reached:
        limited_by.append("acceleration")
    settled, change = start.settled_velocity, pulse.end_velocity - start.settled_velocity
    size = float(np.linalg.norm(change))
    if size > 1e-9:
        room = _speed_room(settled, change / size, limits)
        if room < size - 1e-9:
            limited_by.append("speed")
            pulse = start.pulse_to_velocity(settled + change * (room / size))
        if not pulse.straight and _fast(pulse.profile(()), limits):  # a turn may swing out beyond both its ends
            limited_by.append("speed")
            pulse = start.calmed(pulse, lambda track: _fast(track, limits))
    return pulse.profile(tuple(dict.fromkeys(limited_by)))


def brake(
    position: Vector, velocity: Vector, acceleration: float | Agility, initial_acceleration: Vector | None = None
) -> SlotProfile:
    """The planned hold: to rest as fast as `acceleration` [m/s2], or an `Agility`, lets it, and there for ever.

    Without a jerk limit that is a straight line.
    """
    agility = acceleration if isinstance(acceleration, Agility) else Agility(acceleration)
    return _Start(position, velocity, initial_acceleration, agility).pulse_to_velocity(np.zeros(3)).profile(())


@dataclass(frozen=True)
class _Pulse:
    """A pulse of acceleration in stretched axes, for a vehicle that starts so."""

    start: "_Start"
    peak: Vector
    ramp_up_s: float
    hold_s: float
    ramp_down_s: float

    @property
    def end_velocity(self) -> Vector:
        gained: Vector = self.start.acceleration * (self.ramp_up_s / 2) + self.peak * (
            self.ramp_up_s / 2 + self.hold_s + self.ramp_down_s / 2
        )
        velocity: Vector = self.start.velocity + gained * self.start.axes
        return velocity

    @property
    def straight(self) -> bool:
        """Whether every velocity lies between the first and the last."""
        return self.ramp_up_s == 0.0 or not self.start.acceleration.any()

    def profile(self, limited_by: tuple[str, ...]) -> SlotProfile:
        start = self.start
        return SlotProfile(
            start.position,
            start.velocity,
            start.acceleration * start.axes,
            self.peak * start.axes,
            self.ramp_up_s,
            self.hold_s,
            self.ramp_down_s,
            limited_by,
        )


class _Start:
    """Where a profile starts, and how it may go on. Accelerations in here are in stretched axes."""

    def __init__(self, position: Vector, velocity: Vector, acceleration: Vector | None, agility: Agility) -> None:
        self.axes = np.array([1.0, 1.0, agility.vertical_share])
        self.position, self.velocity = position, velocity
        self._most, self._jerk = agility.acceleration, agility.jerk
        self.acceleration: Vector = np.zeros(3)
        if acceleration is not None and math.isfinite(self._jerk):  # without a jerk limit it may jump
            self.acceleration = acceleration / self.axes

    @property
    def settled_velocity(self) -> Vector:
        """Once the acceleration has gone to zero straight."""
        size = float(np.linalg.norm(self.acceleration))
        velocity: Vector = self.velocity + self.acceleration * self.axes * (size / (2 * self._jerk))
        return velocity

    def pulse_to_velocity(self, velocity: Vector) -> _Pulse:
        """The shortest pulse that ends at `velocity`."""
        most, jerk = self._most, self._jerk
        change = (velocity - self.velocity) / self.axes

        def peak(ramp_s: float) -> tuple[Vector, float, float]:
            rest = change - self.acceleration * (ramp_s / 2)
            size = float(np.linalg.norm(rest))
            if size < 1e-12:
                return np.zeros(3), 0.0, 0.0
            unheld = math.inf
            if math.isfinite(jerk):
                unheld = jerk * ((ramp_s * ramp_s / 4 + 2 * size / jerk) ** 0.5 - ramp_s / 2)
            strength = min(most, unheld)
            hold_s = max(0.0, size / strength - ramp_s / 2 - strength / (2 * jerk))
            return rest * (strength / size), hold_s, strength / jerk

        return self._pulse(peak, math.inf)[0]

    def pulse_to_place(self, displacement: Vector, slot_s: float) -> tuple[_Pulse, bool]:
        """The shortest pulse that makes `displacement` in `slot_s`, or comes nearest; whether it does make it."""
        most, jerk = self._most, self._jerk
        missing = (displacement - self.velocity * slot_s) / self.axes

        def peak(ramp_s: float) -> tuple[Vector, float, float]:
            whole = _ramp_area(slot_s, ramp_s)
            rest = missing - self.acceleration * (slot_s * slot_s / 2 - whole)
            size = float(np.linalg.norm(rest))
            if size < 1e-9:
                return np.zeros(3), 0.0, 0.0
            left_s = slot_s - ramp_s

            def made(strength: float) -> float:
                return strength * (whole - _ramp_area(left_s, strength / jerk)) - size

            if made(most) > 0.0 and most / jerk > 0.0:  # no need to hold the most there is
                strength = _root(made, 0.0, most)
                return rest * (strength / size), 0.0, strength / jerk
            down_s = most / jerk
            area = max(0.0, whole - size / most)  # what the way back must leave away
            if area >= down_s * down_s / 6:
                coast_s = down_s / 2 + max(0.0, 2 * area - down_s * down_s / 12) ** 0.5
            else:
                coast_s = (6 * down_s * area) ** (1 / 3)
            return rest * (most / size), max(0.0, left_s - coast_s), down_s

        pulse, missed = self._pulse(peak, slot_s)
        made = pulse.profile(()).displacement(slot_s) - displacement
        return pulse, missed < 1e-6 and float(np.linalg.norm(made)) < 1e-6

    def calmed(self, pulse: _Pulse, fast: Callable[[SlotProfile], bool]) -> _Pulse:
        """`pulse`, drawn towards the settled velocity by as little as makes it not `fast`."""
        settled, end = self.settled_velocity, pulse.end_velocity
        good, low, high = self.pulse_to_velocity(settled), 0.0, 1.0
        for _ in range(TRIALS):
            share = (low + high) / 2
            trial = self.pulse_to_velocity(settled + (end - settled) * share)
            if fast(trial.profile(())):
                high = share
            else:
                low, good = share, trial
        return good

    def _pulse(self, peak: Callable[[float], tuple[Vector, float, float]], within_s: float) -> tuple[_Pulse, float]:
        """The pulse whose way from the acceleration at the start to `peak(ramp_s)` takes just `ramp_s`.

        There is one, because the peak depends on the ramp continuously and no way is longer than from limit to limit.
        A ramp longer than `within_s` is cut off; by how much [m/s2] is told.
        """
        size = float(np.linalg.norm(self.acceleration))
        longest_s = min(within_s, (size + self._most) / self._jerk * (1 + 1e-9))

        def late_s(ramp_s: float) -> float:
            return float(np.linalg.norm(peak(ramp_s)[0] - self.acceleration)) / self._jerk - ramp_s

        missed = late_s(longest_s)
        if missed > 0.0 and longest_s > 0.0:
            towards = peak(longest_s)[0] - self.acceleration
            cut = self.acceleration + towards * (longest_s * self._jerk / float(np.linalg.norm(towards)))
            return _Pulse(self, cut, longest_s, 0.0, float(np.linalg.norm(cut)) / self._jerk), missed * self._jerk
        ramp_s = _root(lambda s: -late_s(s), 0.0, longest_s) if longest_s > 0.0 else 0.0
        top, hold_s, down_s = peak(ramp_s)
        return _Pulse(self, top, ramp_s, hold_s, down_s), 0.0


def _ramp(t: Vector, ramp_s: float) -> tuple[Vector, Vector, Vector]:
    """A ramp from 0 to 1 over `ramp_s` from t = 0 on, its integral, and the integral of that."""
    begun = t >= 0.0
    t = np.maximum(t, 0.0)
    if ramp_s <= 0.0:
        return np.where(begun, 1.0, 0.0), t, t * t / 2
    u = np.minimum(t, ramp_s)
    after = t - u
    speed = u * u / (2 * ramp_s) + after
    return u / ramp_s, speed, u**3 / (6 * ramp_s) + after * ramp_s / 2 + after * after / 2


def _ramp_area(t: float, ramp_s: float) -> float:
    """The ramp's double integral at one time t >= 0."""
    if t < ramp_s:
        return t**3 / (6 * ramp_s)
    return t * t / 2 - ramp_s * t / 2 + ramp_s * ramp_s / 6


def _root(rising: Callable[[float], float], low: float, high: float) -> float:
    """A root between `low`, where the function is below zero, and `high`, where it is not (regula falsi, Illinois)."""
    at_low, at_high = rising(low), rising(high)
    if at_low >= 0.0:
        return low
    side = 0
    for _ in range(ROUNDS):
        if high - low < 1e-13 * max(1.0, high):
            break
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        value = rising(middle)
        if abs(value) < 1e-14:
            return middle
        if value < 0.0:
            low, at_low = middle, value
            at_high = at_high / 2 if side == -1 else at_high
            side = -1
        else:
            high, at_high = middle, value
            at_low = at_low / 2 if side == 1 else at_low
            side = 1
    return high


def _fast(track: SlotProfile, limits: SpeedLimits) -> bool:
    """Whether a velocity of the pulse may be beyond the limits.

    Only on the first ramp do velocities not run straight, but along a parabola, here in `PIECES`: each lies within the
    triangle of its ends and the point where their tangents meet.
    """
    step_s = track.ramp_up_s / PIECES
    at = track.at(np.append(np.arange(PIECES + 1) * step_s, track.duration_s))
    v = np.concatenate([at.velocity, at.velocity[:-2] + at.acceleration[:-2] * (step_s / 2)])
    horizontal = np.hypot(v[:, 0], v[:, 1]).max()
    return bool(
        horizontal > limits.horizontal + 1e-9 or v[:, 2].max() > limits.up + 1e-9 or -v[:, 2].min() > limits.down + 1e-9
    )


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
