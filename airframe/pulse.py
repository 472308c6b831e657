"""The pulse of acceleration that takes a vehicle to a velocity, or to a place in a given time, under a jerk limit.

    a(t): from a0 to a1 in a straight line at the jerk limit, a1 held, from a1 to zero at the jerk limit

Everything is in stretched axes, in which the limits of acceleration and jerk are spheres, and in plain floats: on
vectors of three, arrays cost twenty times what the sums do, and a plan needs many pulses.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from airframe.search import root

Triple = tuple[float, float, float]
"""East, north, up."""

ROUNDS = 60
"""Most steps of Newton's method; some five are needed."""
NOTHING: Triple = (0.0, 0.0, 0.0)


class Pulse(NamedTuple):
    """`peak` is reached after `ramp_up_s`, held for `hold_s`, and gone `ramp_down_s` later."""

    peak: Triple
    ramp_up_s: float
    hold_s: float
    ramp_down_s: float


@dataclass(frozen=True)
class Start:
    """Velocity and acceleration at the start, and their limits `most` [m/s2] and `jerk` [m/s3]."""

    velocity: Triple
    acceleration: Triple
    most: float
    jerk: float

    @property
    def settled_velocity(self) -> Triple:
        """Once the acceleration has gone to zero straight."""
        return _sum(self.velocity, self.acceleration, math.hypot(*self.acceleration) / (2 * self.jerk))

    def end_velocity(self, pulse: Pulse) -> Triple:
        """After `pulse`."""
        gained = _sum(self.velocity, self.acceleration, pulse.ramp_up_s / 2)
        return _sum(gained, pulse.peak, pulse.ramp_up_s / 2 + pulse.hold_s + pulse.ramp_down_s / 2)

    def made(self, pulse: Pulse, time_s: float) -> Triple:
        """Displacement after `time_s`."""
        up = ramp_area(time_s, pulse.ramp_up_s)
        down = ramp_area(time_s - pulse.ramp_up_s - pulse.hold_s, pulse.ramp_down_s)
        gone = _sum(NOTHING, self.velocity, time_s)
        return _sum(_sum(gone, self.acceleration, time_s * time_s / 2 - up), pulse.peak, up - down)

    def straight(self, pulse: Pulse) -> bool:
        """Whether every velocity of `pulse` lies between the first and the last."""
        return pulse.ramp_up_s == 0.0 or self.acceleration == NOTHING

    def to_velocity(self, velocity: Triple) -> Pulse:
        """The shortest pulse that ends at `velocity`."""
        most, jerk = self.most, self.jerk
        change = _sum(velocity, self.velocity, -1.0)
        if self.acceleration == NOTHING:  # then it is known beforehand where the first ramp goes
            size = math.hypot(*change)
            if size < 1e-12:
                return Pulse(NOTHING, 0.0, 0.0, 0.0)
            strength = min(most, (size * jerk) ** 0.5)
            ramp_s = strength / jerk
            return Pulse(_sum(NOTHING, change, strength / size), ramp_s, max(0.0, size / strength - ramp_s), ramp_s)

        def peak(ramp_s: float) -> Pulse:
            rest = _sum(change, self.acceleration, -ramp_s / 2)
            size = math.hypot(*rest)
            if size < 1e-12:
                return Pulse(NOTHING, ramp_s, 0.0, 0.0)
            unheld = jerk * ((ramp_s * ramp_s / 4 + 2 * size / jerk) ** 0.5 - ramp_s / 2)
            strength = min(most, unheld)
            hold_s = max(0.0, size / strength - ramp_s / 2 - strength / (2 * jerk))
            return Pulse(_sum(NOTHING, rest, strength / size), ramp_s, hold_s, strength / jerk)

        return self._pulse(peak, math.inf)[0]

    def to_place(self, displacement: Triple, slot_s: float) -> tuple[Pulse, bool]:
        """The shortest pulse that makes `displacement` in `slot_s`, or comes nearest; whether it does make it."""
        most, jerk = self.most, self.jerk
        missing = _sum(displacement, self.velocity, -slot_s)
        down_s = most / jerk

        def peak(ramp_s: float) -> Pulse:
            whole = ramp_area(slot_s, ramp_s)
            rest = _sum(missing, self.acceleration, whole - slot_s * slot_s / 2)
            size = math.hypot(*rest)
            if size < 1e-9:
                return Pulse(NOTHING, ramp_s, 0.0, 0.0)
            left_s = slot_s - ramp_s
            if most * (whole - ramp_area(left_s, down_s)) > size and down_s > 0.0:  # no need to hold the most there is
                strength = _unheld(size, whole, left_s, jerk, most)
                return Pulse(_sum(NOTHING, rest, strength / size), ramp_s, 0.0, strength / jerk)
            area = max(0.0, whole - size / most)  # what the way back must leave away
            if area >= down_s * down_s / 6:
                coast_s = down_s / 2 + max(0.0, 2 * area - down_s * down_s / 12) ** 0.5
            else:
                coast_s = (6 * down_s * area) ** (1 / 3)
            return Pulse(_sum(NOTHING, rest, most / size), ramp_s, max(0.0, left_s - coast_s), down_s)

        pulse, missed = self._pulse(peak, slot_s)
        return pulse, missed < 1e-6 and math.dist(self.made(pulse, slot_s), displacement) < 1e-6

    def _pulse(self, peak: Callable[[float], Pulse], within_s: float) -> tuple[Pulse, float]:
        """The pulse whose way from the acceleration at the start to that of `peak(ramp_s)` takes just `ramp_s`.

        There is one, because the peak depends on the ramp continuously and no way is longer than from limit to limit.
        A ramp longer than `within_s` is cut off; by how much [m/s2] is told.
        """
        longest_s = (math.hypot(*self.acceleration) + self.most) / self.jerk * (1 + 1e-9)
        if longest_s <= 0.0 or within_s <= 0.0:
            return peak(0.0), 0.0

        def early_s(ramp_s: float) -> float:
            return ramp_s - math.dist(peak(ramp_s).peak, self.acceleration) / self.jerk

        if within_s < longest_s:
            longest_s, missed_s = within_s, -early_s(within_s)
            if missed_s > 0.0:
                towards = _sum(peak(longest_s).peak, self.acceleration, -1.0)
                cut = _sum(self.acceleration, towards, longest_s * self.jerk / math.hypot(*towards))
                return Pulse(cut, longest_s, 0.0, math.hypot(*cut) / self.jerk), missed_s * self.jerk
        return peak(root(early_s, 0.0, longest_s)), 0.0


def ramp_area(t: float, ramp_s: float) -> float:
    """The double integral up to t of what rises from 0 to 1 over `ramp_s` from t = 0 on, and stays there."""
    if t <= 0.0:
        return 0.0
    if t < ramp_s:
        return t * t * t / (6 * ramp_s)
    return t * t / 2 - ramp_s * t / 2 + ramp_s * ramp_s / 6


def _unheld(size: float, whole: float, left_s: float, jerk: float, most: float) -> float:
    """The strength s in (0, most) with s (whole - ramp_area(left_s, s / jerk)) = size, by Newton's method.

    While its way back ends in time, that is a cubic; else it is the straight line that continues it.
    """
    linear = (size + jerk * left_s**3 / 6) / whole
    if linear >= jerk * left_s:
        return min(linear, most)
    strength = min(most, jerk * left_s)
    for _ in range(ROUNDS):
        value = strength * (whole - ramp_area(left_s, strength / jerk)) - size
        slope = whole - left_s * left_s / 2 + left_s * strength / jerk - strength * strength / (2 * jerk * jerk)
        change = value / slope
        strength -= change
        if abs(change) <= 1e-14 * strength:
            break
    return strength


def _sum(a: Triple, b: Triple, share: float) -> Triple:
    """a + share b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]
