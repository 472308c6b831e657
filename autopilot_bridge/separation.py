"""Keeping vehicles apart, each by itself, from nothing but where the others are and how fast.

Two vehicles share the gap between their *stops*, in plan: the straight ways that each needs to come to rest. The plane
half-way between the two stops' nearest points divides the gap; each keeps its own stop on its own side, half of the
separation away from it. Both draw the same plane, so whatever either does next, their stops, and with them the
vehicles, stay apart by the separation. Braking draws a stop back along itself, so it is always allowed.

Apart means in plan, whatever the heights: below another multicopter the air comes down.
"""

from dataclasses import dataclass

import numpy as np

from airframe.slot_profile import Vector
from autopilot_bridge.fence import TOUCH_M, Plan


@dataclass(frozen=True)
class Track:
    """Another vehicle, as far as is known; ENU about *our* home."""

    position: Vector
    velocity: Vector
    age_s: float = 0.0
    """How old this is: it may have moved meanwhile, and we may have been seen elsewhere."""
    stop: Vector | None = None
    """Where it comes to rest, when that is not by braking now: the far end of the way that it keeps to itself."""


@dataclass(frozen=True)
class HalfPlane:
    """Points x with (x - `through`) . `outward` <= 0."""

    through: Plan
    outward: Plan

    def holds(self, path: Plan) -> bool:
        return self.beyond_m(path) <= TOUCH_M

    def beyond_m(self, path: Plan) -> float:
        return max(0.0, float(((path - self.through) @ self.outward).max()))

    def wall(self, path: Plan) -> Plan:
        return self.outward


def own_side(own_stop: Plan, other_stop: Plan, separation_m: float) -> HalfPlane:
    """Where we may be, for stops (2, 2) from position to standstill."""
    ours, theirs = nearest_points(own_stop, other_stop)
    gap = theirs - ours
    distance = float(np.hypot(*gap))
    if distance < 1e-9:  # it is too late for a plane between them: away from the other's position
        gap = other_stop[0] - own_stop[0]
        distance = float(np.hypot(*gap))
    outward = gap / distance if distance > 1e-9 else np.array([1.0, 0.0])
    return HalfPlane((ours + theirs) / 2 - outward * (separation_m / 2), outward)


def nearest_points(first: Plan, second: Plan) -> tuple[Plan, Plan]:
    """Of two segments (2, 2), the pair of points that are nearest to each other."""
    meeting = _meeting(first, second)
    if meeting is not None:
        return meeting, meeting
    pairs = [(point, _onto(point, second)) for point in first]
    pairs += [(_onto(point, first), point) for point in second]
    return min(pairs, key=lambda pair: float(np.hypot(*(pair[0] - pair[1]))))


def _onto(point: Plan, segment: Plan) -> Plan:
    """The segment's nearest point."""
    way = segment[1] - segment[0]
    length = float(way @ way)
    share = min(max(float((point - segment[0]) @ way) / length, 0.0), 1.0) if length > 0 else 0.0
    nearest: Plan = segment[0] + share * way
    return nearest


def _meeting(first: Plan, second: Plan) -> Plan | None:
    """Where two segments cross, if they do."""
    p, r = first[0], first[1] - first[0]
    q, s = second[0], second[1] - second[0]
    across = r[0] * s[1] - r[1] * s[0]
    if abs(across) < 1e-12:
        return None
    apart = q - p
    share = (apart[0] * s[1] - apart[1] * s[0]) / across
    other = (apart[0] * r[1] - apart[1] * r[0]) / across
    if not (0 <= share <= 1 and 0 <= other <= 1):
        return None
    point: Plan = p + share * r
    return point
