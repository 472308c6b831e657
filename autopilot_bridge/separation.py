"""Keeping vehicles apart, each by itself, from nothing but where the others are and how fast.

Two vehicles share the gap between their *stops*, in plan: the straight ways that each needs to come to rest. The plane
half-way between the two stops' nearest points divides the gap; each keeps its own stop on its own side, half of the
separation away from it. Both draw the same plane, so whatever either does next, their stops, and with them the
vehicles, stay apart by the separation. Braking draws a stop back along itself, so it is always allowed.

Apart means in plan, whatever the heights: below another multicopter the air comes down.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from airframe.slot_profile import Vector
from autopilot_bridge.fence import TOUCH_M, Path, Point

Segment = Sequence[Point]
"""Two points."""


@dataclass(frozen=True)
class Track:
    """Another vehicle, as far as is known; ENU about *our* home."""

    position: Vector
    velocity: Vector
    age_s: float = 0.0
    """How old this is: it may have moved meanwhile, and we may have been seen elsewhere."""
    stop: Vector | None = None
    """Where it comes to rest, the far end of the way that it keeps to itself; None: by braking as we do."""


@dataclass(frozen=True)
class HalfPlane:
    """Points x with (x - `through`) . `outward` <= 0."""

    through: Point
    outward: Point

    def holds(self, path: Path, slack_m: float = TOUCH_M) -> bool:
        return self.beyond_m(path) <= slack_m

    def beyond_m(self, path: Path) -> float:
        (x, y), (nx, ny) = self.through, self.outward
        return max(0.0, max([(east - x) * nx + (north - y) * ny for east, north in path]))

    def wall(self, path: Path) -> Point:
        return self.outward

    def near(self, place: Point, radius_m: float) -> "HalfPlane | None":
        (x, y), (nx, ny) = self.through, self.outward
        return None if (place[0] - x) * nx + (place[1] - y) * ny + radius_m <= 0.0 else self


def own_side(own_stop: Segment, other_stop: Segment, separation_m: float) -> HalfPlane:
    """Where we may be, for the straight ways from position to standstill."""
    ours, theirs = nearest_points(own_stop, other_stop)
    gap = theirs[0] - ours[0], theirs[1] - ours[1]
    distance = math.hypot(*gap)
    if distance < 1e-9:  # it is too late for a plane between them: away from the other's position
        gap = other_stop[0][0] - own_stop[0][0], other_stop[0][1] - own_stop[0][1]
        distance = math.hypot(*gap)
    outward = (gap[0] / distance, gap[1] / distance) if distance > 1e-9 else (1.0, 0.0)
    half = separation_m / 2
    middle = (ours[0] + theirs[0]) / 2, (ours[1] + theirs[1]) / 2
    return HalfPlane((middle[0] - outward[0] * half, middle[1] - outward[1] * half), outward)


def nearest_points(first: Segment, second: Segment) -> tuple[Point, Point]:
    """Of two segments, the pair of points that are nearest to each other."""
    meeting = _meeting(first, second)
    if meeting is not None:
        return meeting, meeting
    pairs = [(point, _onto(point, second)) for point in first]
    pairs += [(_onto(point, first), point) for point in second]
    return min(pairs, key=lambda pair: math.dist(*pair))


def _onto(point: Point, segment: Segment) -> Point:
    """The segment's nearest point."""
    (ax, ay), (bx, by) = segment
    wx, wy = bx - ax, by - ay
    squared = wx * wx + wy * wy
    share = min(max(((point[0] - ax) * wx + (point[1] - ay) * wy) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    return ax + share * wx, ay + share * wy


def _meeting(first: Segment, second: Segment) -> Point | None:
    """Where two segments cross, if they do."""
    ((px, py), (rx, ry)), ((qx, qy), (sx, sy)) = first, second
    rx, ry, sx, sy = rx - px, ry - py, sx - qx, sy - qy
    across = rx * sy - ry * sx
    if abs(across) < 1e-12:
        return None
    dx, dy = qx - px, qy - py
    share, other = (dx * sy - dy * sx) / across, (dx * ry - dy * rx) / across
    if not (0.0 <= share <= 1.0 and 0.0 <= other <= 1.0):
        return None
    return px + share * rx, py + share * ry
