"""Volumes that a vehicle must not leave: a shape in plan times a band of altitude, in ENU about home [m].

Altitude is height above home, and above the ground, which is taken to be flat and as high as home.

A path in plan is a polyline. Whether a shape holds it is asked of all of it: for a convex shape its corners tell, for a
polygon what lies between them too. A path held by a shape may touch its boundary.

Plain floats throughout: the envelope asks this dozens of times for every setpoint.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag
from pydantic import Strict as StrictTypes

from airframe.slot_profile import Vector, triple

Point = tuple[float, float]
"""East, north [m]; also a direction."""
Path = Sequence[Point]
"""The corners of a polyline; of a single point, itself."""
Coordinate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
Pair = Annotated[tuple[Coordinate, Coordinate], StrictTypes(False)]
Vec3 = tuple[float, float, float]

TOUCH_M = 1e-6
"""So far outside still counts as on the boundary."""
HOME_M = 10.0
"""Room about home that a vehicle on its way to a far box needs."""
MOST_VERTICES = 200
APART_M = 0.01


class Bound(Protocol):
    """What in plan must not be left."""

    def holds(self, path: Path, slack_m: float = TOUCH_M) -> bool:
        """Whether all of it is inside, or no further outside than that."""

    def beyond_m(self, path: Path) -> float:
        """How far its furthest corner is outside [m]; 0 inside."""

    def wall(self, path: Path) -> Point:
        """Outward unit normal of what is in the way of it."""

    def near(self, place: Point, radius_m: float) -> "Bound | None":
        """The same for paths that stay within `radius_m` of `place`; None when no such path is in its way."""


class Strict(BaseModel):
    """Base of all parts of a configuration: frozen, unknown fields refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


def _ordered(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] >= span[1]:
        raise ValueError(f"{span}: the minimum must be below the maximum")
    return span


def _simple(vertices: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    if len(vertices) > 3 and vertices[0] == vertices[-1]:
        vertices = vertices[:-1]
    for first, second in zip(vertices, (*vertices[1:], vertices[0]), strict=True):
        if math.dist(first, second) < APART_M:
            raise ValueError(f"vertices {first} and {second} must be {APART_M:g} m apart at least")
    crossing = _crossing(vertices)
    if crossing is not None:
        raise ValueError(f"its sides from {vertices[crossing[0]]} and from {vertices[crossing[1]]} must not meet")
    return vertices


Span = Annotated[Pair, AfterValidator(_ordered)]
"""(min, max) [m]."""
Vertices = Annotated[
    tuple[Pair, ...],
    StrictTypes(False),
    Field(min_length=3, max_length=MOST_VERTICES),
    AfterValidator(_simple),
]
"""(east, north) [m] of a simple polygon, in either sense; it closes by itself, or by its first vertex again."""


class Box(Strict):
    """Axis-aligned; each span is (min, max)."""

    x: Span
    y: Span
    z: Span

    @property
    def spans(self) -> tuple[Span, Span, Span]:
        return self.x, self.y, self.z

    @property
    def altitude(self) -> Span:
        return self.z

    @property
    def corners(self) -> NDArray[np.float64]:
        """In plan, shape (4, 2), counter-clockwise."""
        (west, east), (south, north) = self.x, self.y
        return np.array([(west, south), (east, south), (east, north), (west, north)])

    def contains(self, point: Vec3, margin: float = 0.0) -> bool:
        """Whether `point` lies at least `margin` [m] inside every face."""
        return all(low + margin <= c <= high - margin for c, (low, high) in zip(point, self.spans, strict=True))

    def grown(self, sideways: float, vertically: float) -> "Box":
        """The box with its faces moved outward [m]."""
        return Box(
            x=(self.x[0] - sideways, self.x[1] + sideways),
            y=(self.y[0] - sideways, self.y[1] + sideways),
            z=(self.z[0] - vertically, self.z[1] + vertically),
        )

    def hull(self, point: Vec3) -> "Box":
        """The smallest box that holds this one and `point`."""
        x, y, z = ((min(low, c), max(high, c)) for c, (low, high) in zip(point, self.spans, strict=True))
        return Box(x=x, y=y, z=z)

    def down_to_home(self) -> "Box":
        """With room for the way between home and the box."""
        return self.hull((-HOME_M, -HOME_M, -1.0)).hull((HOME_M, HOME_M, 0.0))

    def holds(self, path: Path, slack_m: float = TOUCH_M) -> bool:
        return self.beyond_m(path) <= slack_m

    def beyond_m(self, path: Path) -> float:
        (west, east), (south, north) = self.x, self.y
        return max([math.hypot(max(west - x, 0.0, x - east), max(south - y, 0.0, y - north)) for x, y in path])

    def wall(self, path: Path) -> Point:
        (west, east), (south, north) = self.x, self.y
        x, y = path[-1]
        if max(west - x, x - east) >= max(south - y, y - north):
            return (1.0 if x > (west + east) / 2 else -1.0), 0.0
        return 0.0, (1.0 if y > (south + north) / 2 else -1.0)

    def near(self, place: Point, radius_m: float) -> "Box | None":
        (west, east), (south, north) = self.x, self.y
        room_m = min(place[0] - west, east - place[0], place[1] - south, north - place[1])
        return None if room_m >= radius_m else self


class Cylinder(Strict):
    """Upright."""

    centre: Pair
    radius: Annotated[float, Field(strict=True, gt=0, le=1e6)]
    altitude: Span

    def down_to_home(self) -> "Cylinder":
        return self.model_copy(update={"altitude": _to_the_ground(self.altitude)})

    def holds(self, path: Path, slack_m: float = TOUCH_M) -> bool:
        return self.beyond_m(path) <= slack_m

    def beyond_m(self, path: Path) -> float:
        return max(0.0, max([math.dist(point, self.centre) for point in path]) - self.radius)

    def wall(self, path: Path) -> Point:
        return unit(path[-1][0] - self.centre[0], path[-1][1] - self.centre[1])

    def near(self, place: Point, radius_m: float) -> "Cylinder | None":
        return None if math.dist(place, self.centre) + radius_m <= self.radius else self


class Polygon(Strict):
    """Any simple polygon, not only a convex one."""

    polygon: Vertices
    altitude: Span

    def down_to_home(self) -> "Polygon":
        return self.model_copy(update={"altitude": _to_the_ground(self.altitude)})

    def holds(self, path: Path, slack_m: float = TOUCH_M) -> bool:
        vicinity = self.near(path[0], max([math.dist(path[0], point) for point in path]))
        return vicinity is None or vicinity.holds(path, slack_m)

    def beyond_m(self, path: Path) -> float:
        return max([0.0 if self._inside(point) else min(self._distances_m(point)) for point in path])

    def wall(self, path: Path) -> Point:
        """Of the side that the path meets first; where it meets none, away from the nearest one."""
        return _wall(self._sides, path)

    def near(self, place: Point, radius_m: float) -> "_Vicinity | None":
        inside = self._inside(place)
        radius_m += TOUCH_M if inside else min(self._distances_m(place)) + TOUCH_M
        sides = [side for side in self._sides if side.touches(place, place, 2 * radius_m)]
        return None if inside and not sides else _Vicinity(self, sides, radius_m, inside)

    @cached_property
    def _sides(self) -> tuple["_Side", ...]:
        """Counter-clockwise."""
        vertices = self.polygon if _area(self.polygon) > 0 else self.polygon[::-1]
        edges = list(zip(vertices, (*vertices[1:], vertices[0]), strict=True))
        outward = [unit(bn - an, ae - be) for (ae, an), (be, bn) in edges]
        return tuple(
            _Side(*edge, outward[i], _sum(outward[i - 1], outward[i]), _sum(outward[i], outward[(i + 1) % len(edges)]))
            for i, edge in enumerate(edges)
        )

    def _inside(self, point: Point) -> bool:
        """By the number of sides to the east of it."""
        x, y = point
        odd = False
        for (ax, ay), (bx, by), *_ in self._sides:
            if (ay > y) != (by > y) and ax + (y - ay) / (by - ay) * (bx - ax) > x:
                odd = not odd
        return odd

    def _distances_m(self, point: Point) -> list[float]:
        return [abs(side.beyond_m(point)) for side in self._sides]


class _Side(NamedTuple):
    """Of a polygon; `outward` is its own normal, the others, longer or shorter, are those of its ends."""

    begin: Point
    end: Point
    outward: Point
    outward_at_begin: Point
    outward_at_end: Point

    def beyond_m(self, point: Point) -> float:
        """Distance from the side, negative on its inner side; the sign counts where no other side is nearer."""
        (ax, ay), (bx, by), (nx, ny), at_begin, at_end = self
        x, y = point
        dx, dy = x - ax, y - ay
        along = dy * nx - dx * ny  # the normal turned to the left is the side's direction
        if along <= 0.0:
            return math.copysign(math.hypot(dx, dy), dx * at_begin[0] + dy * at_begin[1])
        dx, dy = x - bx, y - by
        if dy * nx - dx * ny >= 0.0:
            return math.copysign(math.hypot(dx, dy), dx * at_end[0] + dy * at_end[1])
        return dx * nx + dy * ny

    def away(self, point: Point) -> Point:
        """The direction in which `beyond_m` grows."""
        beyond_m = self.beyond_m(point)
        for x, y in (self.begin, self.end):
            dx, dy = point[0] - x, point[1] - y
            if beyond_m and math.hypot(dx, dy) == abs(beyond_m):  # past that end
                return dx / beyond_m, dy / beyond_m
        return self.outward

    def touches(self, low: Point, high: Point, margin_m: float) -> bool:
        """Whether its bounding box meets another, grown by a margin."""
        (ax, ay), (bx, by), *_ = self
        return (
            (ax if ax < bx else bx) - margin_m <= high[0]
            and (ax if ax > bx else bx) + margin_m >= low[0]
            and (ay if ay < by else by) - margin_m <= high[1]
            and (ay if ay > by else by) + margin_m >= low[1]
        )

    def meeting(self, p: Point, q: Point) -> float | None:
        """The share of the way from p to q at which it meets the side; a parallel does not."""
        (ax, ay), (bx, by), *_ = self
        wx, wy, sx, sy = q[0] - p[0], q[1] - p[1], bx - ax, by - ay
        across = wx * sy - wy * sx
        if abs(across) <= 1e-12:
            return None
        dx, dy = ax - p[0], ay - p[1]
        share = (dx * sy - dy * sx) / across
        if not 0.0 <= share <= 1.0:
            return None
        along, slack = (dx * wy - dy * wx) / across, TOUCH_M / math.hypot(sx, sy)
        return share if -slack <= along <= 1.0 + slack else None


class _Vicinity(NamedTuple):
    """A polygon as it looks to paths that stay near a place."""

    polygon: Polygon
    sides: list[_Side]
    """All that are nearer to the place than twice as far, and perhaps others."""
    radius_m: float
    """How near; when the place is outside, and how far outside it is."""
    inside: bool
    """Whether the place is."""

    def holds(self, path: Path, slack_m: float = TOUCH_M) -> bool:
        """Every segment is cut where it meets a side; each piece is inside if its middle is."""
        xs, ys = [x for x, _ in path], [y for _, y in path]
        low, high = (min(xs), min(ys)), (max(xs), max(ys))
        met = [side for side in self.sides if side.touches(low, high, TOUCH_M)]
        if len(path) == 1 or (slack_m <= TOUCH_M and not met):
            return self._keeps(path[0], slack_m)
        if slack_m > TOUCH_M and not all(self._keeps(corner, slack_m) for corner in path):
            return False
        for p, q in pairwise(path):
            cuts = sorted([0.0, *[share for side in met if (share := side.meeting(p, q)) is not None], 1.0])
            for first, last in pairwise(cuts):
                middle = (first + last) / 2
                if last - first > 1e-12:
                    point = p[0] + middle * (q[0] - p[0]), p[1] + middle * (q[1] - p[1])
                    if not self._keeps(point, slack_m):
                        return False
        return True

    def beyond_m(self, path: Path) -> float:
        return self.polygon.beyond_m(path)

    def wall(self, path: Path) -> Point:
        return _wall(self.sides or self.polygon._sides, path)

    def near(self, place: Point, radius_m: float) -> "_Vicinity | None":
        return self.polygon.near(place, radius_m)

    def _keeps(self, point: Point, slack_m: float) -> bool:
        """By the side that is nearest. Where none is within the radius, there is none between it and the place."""
        nearest, least = math.inf, math.inf
        for side in self.sides:
            beyond_m = side.beyond_m(point)
            if abs(beyond_m) < least:
                nearest, least = beyond_m, abs(beyond_m)
        return self.inside if least > self.radius_m else nearest <= slack_m


def _wall(sides: Sequence[_Side], path: Path) -> Point:
    """See `Polygon.wall`; sharp corners point away from themselves."""
    for p, q in pairwise(path):
        first, outward = 1.0, None
        for side in sides:
            leaves = (q[0] - p[0]) * side.outward[0] + (q[1] - p[1]) * side.outward[1] > 1e-12  # along it is no meeting
            share = side.meeting(p, q) if leaves else None
            if share is not None and 0.0 < share < first:
                first, outward = share, side.outward
        if outward is not None:
            return outward
    return min(sides, key=lambda side: abs(side.beyond_m(path[-1]))).away(path[-1])


def _kind(fence: object) -> str:
    """The tag of the shape that a mapping means by its fields."""
    fields = fence if isinstance(fence, dict) else type(fence).model_fields if isinstance(fence, BaseModel) else ()
    return "|polygon" if "polygon" in fields else "|cylinder" if "radius" in fields or "centre" in fields else "|box"


Fence = Annotated[
    Annotated[Box, Tag("|box")] | Annotated[Polygon, Tag("|polygon")] | Annotated[Cylinder, Tag("|cylinder")],
    Discriminator(_kind),
]


def lowered(fence: Box | Polygon | Cylinder, ceiling_m: float) -> Box | Polygon | Cylinder:
    """The fence, no higher than that above home; the ceiling must be above its floor."""
    low, high = fence.altitude
    if high <= ceiling_m:
        return fence
    altitude = (low, ceiling_m)
    return fence.model_copy(update={"z" if isinstance(fence, Box) else "altitude": altitude})


def outside_m(fence: Box | Polygon | Cylinder, position: Vector) -> float:
    """How far outside a position (3,) is, sideways or vertically, whichever is more [m]; 0 inside."""
    low, high = fence.altitude
    east, north, up = triple(position)
    return max(fence.beyond_m([(east, north)]), low - up, up - high, 0.0)


def holds_box(fence: Box | Polygon | Cylinder, box: Box) -> str:
    """What of `box` the fence does not hold; empty when it holds all of it."""
    low, high = fence.altitude
    if isinstance(fence, Box):
        for axis, (near, far), (fence_near, fence_far) in zip("xyz", box.spans, fence.spans, strict=True):
            if fence_near > near or fence_far < far:
                return f".{axis}: ({fence_near:g}, {fence_far:g}) must hold the box's ({near:g}, {far:g})"
        return ""
    if low > box.z[0] or high < box.z[1]:
        return f".altitude: ({low:g}, {high:g}) must hold the box's ({box.z[0]:g}, {box.z[1]:g})"
    corners: list[Point] = [(east, north) for east, north in box.corners.tolist()]
    if not fence.holds([*corners, corners[0]]):
        x, y = box.x, box.y
        return f": must hold the box's ({x[0]:g}, {x[1]:g}) x ({y[0]:g}, {y[1]:g})"
    return ""


def _to_the_ground(altitude: Span) -> Span:
    return min(altitude[0], -1.0), altitude[1]


def unit(east: float, north: float) -> Point:
    """The direction of a vector; zero of none."""
    length = max(math.hypot(east, north), 1e-12)
    return east / length, north / length


def _sum(a: Point, b: Point) -> Point:
    return a[0] + b[0], a[1] + b[1]


def _cross(a: Point, b: Point, c: Point) -> float:
    """Twice the signed area of a triangle, positive when counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _area(vertices: Path) -> float:
    """Signed, positive when counter-clockwise; from its first vertex, so that far from home nothing cancels."""
    return sum(_cross(vertices[0], b, c) for b, c in pairwise(vertices[1:])) / 2


def _crossing(vertices: Path) -> tuple[int, int] | None:
    """Two sides, by their first vertices, that meet without being neighbours, or fold back on each other."""
    count = len(vertices)
    for one in range(count):
        for other in range(one + 1, count):
            a, b, c, d = vertices[one], vertices[one + 1], vertices[other], vertices[(other + 1) % count]
            if other == one + 1 or (one == 0 and other == count - 1):
                shared, first, second = (b, a, d) if other == one + 1 else (a, b, c)
                ahead = (first[0] - shared[0]) * (second[0] - shared[0]) + (first[1] - shared[1]) * (
                    second[1] - shared[1]
                )
                if ahead > 0 and _cross(shared, first, second) == 0:
                    return one, other
            elif _segments_meet(a, b, c, d):
                return one, other
    return None


def _segments_meet(a: Point, b: Point, c: Point, d: Point) -> bool:
    """Also where one only touches the other."""
    corners = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    sides = [_cross(*corner) for corner in corners]
    if sides[0] * sides[1] < 0 and sides[2] * sides[3] < 0:
        return True

    def on(p: Point, q: Point, r: Point) -> bool:
        return all(min(p[axis], q[axis]) <= r[axis] <= max(p[axis], q[axis]) for axis in (0, 1))

    return any(side == 0 and on(*corner) for corner, side in zip(corners, sides, strict=True))
