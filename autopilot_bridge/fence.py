"""Volumes that a vehicle must not leave: a shape in plan times a band of altitude, in ENU about home [m].

Altitude is height above home, and above the ground, which is taken to be flat and as high as home.

A path in plan is a polyline, shape (n, 2). Whether a shape holds it is asked of all of it: for a convex shape its
vertices tell, for a polygon its edges have to be looked at too. A path held by a shape may touch its boundary.
"""

import math
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag
from pydantic import Strict as StrictTypes

Plan = NDArray[np.float64]
"""Shape (2,) or (n, 2): east, north."""
Coordinate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
Pair = Annotated[tuple[Coordinate, Coordinate], StrictTypes(False)]
Vec3 = tuple[float, float, float]

TOUCH_M = 1e-6
"""So far outside still counts as on the boundary."""
HOME_M = 10.0
"""Room about home that a vehicle on its way to a far box needs."""
MOST_VERTICES = 200
APART_M = 0.01


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
    crossing = _crossing(np.array(vertices))
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
    def corners(self) -> Plan:
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

    def holds(self, path: Plan) -> bool:
        return self.beyond_m(path) <= TOUCH_M

    def beyond_m(self, path: Plan) -> float:
        """How far the path's furthest vertex is outside [m]; 0 inside."""
        over = np.maximum(self._over(path), 0.0)
        return float(np.hypot(over[..., 0], over[..., 1]).max())

    def wall(self, path: Plan) -> Plan:
        """The outward normal of the wall that is in the way of the path's end."""
        end = path[-1]
        over = self._over(end)
        axis = int(np.argmax(over))
        normal = np.zeros(2)
        normal[axis] = 1.0 if end[axis] > sum(self.spans[axis]) / 2 else -1.0
        return normal

    def _over(self, points: Plan) -> Plan:
        """By how much each coordinate is outside its span, negative inside."""
        low, high = np.array([self.x, self.y]).T
        over: Plan = np.maximum(low - points, points - high)
        return over


class Cylinder(Strict):
    """Upright."""

    centre: Pair
    radius: Annotated[float, Field(strict=True, gt=0, le=1e6)]
    altitude: Span

    def down_to_home(self) -> "Cylinder":
        return self.model_copy(update={"altitude": _to_the_ground(self.altitude)})

    def holds(self, path: Plan) -> bool:
        return self.beyond_m(path) <= TOUCH_M

    def beyond_m(self, path: Plan) -> float:
        return max(0.0, float(np.hypot(*(np.atleast_2d(path) - self.centre).T).max()) - self.radius)

    def wall(self, path: Plan) -> Plan:
        return _unit(path[-1] - self.centre)


class Polygon(Strict):
    """Any simple polygon, not only a convex one."""

    polygon: Vertices
    altitude: Span

    def down_to_home(self) -> "Polygon":
        return self.model_copy(update={"altitude": _to_the_ground(self.altitude)})

    def holds(self, path: Plan) -> bool:
        """Every segment is cut where it meets a side; each piece is inside if its middle is."""
        starts, ways = path[:-1], np.diff(path, axis=0)
        if len(path) == 1 or self._well_inside(path):
            return self.beyond_m(path[:1]) <= TOUCH_M
        shares = self._meetings(starts, ways)
        cuts = np.sort(np.concatenate([np.zeros((len(ways), 1)), shares, np.ones((len(ways), 1))], axis=1), axis=1)
        middles = (cuts[:, 1:] + cuts[:, :-1]) / 2
        points = starts[:, None] + middles[..., None] * ways[:, None]
        return self.beyond_m(points[np.diff(cuts, axis=1) > 1e-12]) <= TOUCH_M if ways.any() else True

    def beyond_m(self, path: Plan) -> float:
        points = np.atleast_2d(path)
        if not len(points):
            return 0.0
        distances = np.where(self._inside(points), 0.0, self._to_sides(points).min(axis=1))
        return float(distances.max())

    def wall(self, path: Plan) -> Plan:
        """Of the side that the path meets first; of the nearest one where it meets none."""
        starts, ways = path[:-1], np.diff(path, axis=0)
        shares = self._meetings(starts, ways)
        normals = self._normals
        outward = ways @ normals.T > 1e-12  # along a side is no meeting
        shares = np.where(outward & (shares > 0.0), shares, 1.0)
        for row in shares:
            if row.min() < 1.0:
                met: Plan = normals[int(np.argmin(row))]
                return met
        nearest: Plan = normals[int(np.argmin(self._to_sides(path[-1:])))]
        return nearest

    @cached_property
    def _sides(self) -> tuple[Plan, Plan]:
        """Where each side begins, and its way; counter-clockwise."""
        vertices = np.array(self.polygon)
        if _area(vertices) < 0:
            vertices = vertices[::-1]
        return vertices, np.roll(vertices, -1, axis=0) - vertices

    @cached_property
    def _normals(self) -> Plan:
        """Outward, one per side."""
        _, ways = self._sides
        outward = np.stack([ways[:, 1], -ways[:, 0]], axis=1)
        normals: Plan = outward / np.linalg.norm(outward, axis=1, keepdims=True)
        return normals

    def _well_inside(self, path: Plan) -> bool:
        """Whether the path stays nearer to its start than any side is."""
        extent = float(np.hypot(*(path - path[0]).T).max())
        return extent < float(self._to_sides(path[:1]).min())

    def _inside(self, points: Plan) -> NDArray[np.bool_]:
        """By the number of sides to the east of each point."""
        begins, ways = self._sides
        x, y = points[:, 0, None], points[:, 1, None]
        ends = np.roll(begins[:, 1], -1)  # not the sum with the way: rounding could put a corner on both sides
        astride = (begins[:, 1] > y) != (ends > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = begins[:, 0] + (y - begins[:, 1]) / ways[:, 1] * ways[:, 0]
        odd: NDArray[np.bool_] = (astride & (at > x)).sum(axis=1) % 2 == 1
        return odd

    def _to_sides(self, points: Plan) -> NDArray[np.float64]:
        """Distance of each point from each side, shape (points, sides)."""
        begins, ways = self._sides
        apart = points[:, None] - begins
        share = np.clip((apart * ways).sum(axis=2) / (ways * ways).sum(axis=1), 0.0, 1.0)
        distances: NDArray[np.float64] = np.linalg.norm(apart - share[..., None] * ways, axis=2)
        return distances

    def _meetings(self, starts: Plan, ways: Plan) -> NDArray[np.float64]:
        """How far along each segment it meets each side, as a share; 1 where it does not. Shape (segments, sides)."""
        begins, sides = self._sides
        apart = begins - starts[:, None]
        across = _cross(ways[:, None], sides)
        with np.errstate(divide="ignore", invalid="ignore"):
            share, along = _cross(apart, sides) / across, _cross(apart, ways[:, None]) / across
        near = TOUCH_M / np.linalg.norm(sides, axis=1)
        meet = (abs(across) > 1e-12) & (share >= 0) & (share <= 1) & (along >= -near) & (along <= 1 + near)
        return np.where(meet, share, 1.0)


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


def outside_m(fence: Box | Polygon | Cylinder, position: NDArray[np.float64]) -> float:
    """How far outside a position (3,) is, sideways or vertically, whichever is more [m]; 0 inside."""
    low, high = fence.altitude
    return max(fence.beyond_m(position[:2]), low - float(position[2]), float(position[2]) - high, 0.0)


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
    corners = box.corners
    if not fence.holds(np.vstack([corners, corners[:1]])):
        x, y = box.x, box.y
        return f": must hold the box's ({x[0]:g}, {x[1]:g}) x ({y[0]:g}, {y[1]:g})"
    return ""


def _to_the_ground(altitude: Span) -> Span:
    return min(altitude[0], -1.0), altitude[1]


def _unit(vector: Plan) -> Plan:
    unit: Plan = vector / max(float(np.hypot(*vector)), 1e-12)
    return unit


def _cross(a: Plan, b: Plan) -> NDArray[np.float64]:
    product: NDArray[np.float64] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _area(vertices: Plan) -> float:
    """Signed, positive when counter-clockwise."""
    return float(_cross(vertices, np.roll(vertices, -1, axis=0)).sum()) / 2


def _crossing(vertices: Plan) -> tuple[int, int] | None:
    """Two sides, by their first vertices, that meet without being neighbours, or fold back on each other."""
    count = len(vertices)
    ends = np.roll(vertices, -1, axis=0)
    for one in range(count):
        for other in range(one + 1, count):
            a, b, c, d = vertices[one], ends[one], vertices[other], ends[other]
            if other == one + 1 or (one == 0 and other == count - 1):
                shared, first, second = (b, a, d) if other == one + 1 else (a, b, c)
                folded = _cross(first - shared, second - shared) == 0 and np.dot(first - shared, second - shared) > 0
                if folded:
                    return one, other
            elif _segments_meet(a, b, c, d):
                return one, other
    return None


def _segments_meet(a: Plan, b: Plan, c: Plan, d: Plan) -> bool:
    """Also where one only touches the other."""
    corners = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    sides = [float(_cross(second - first, third - first)) for first, second, third in corners]
    if sides[0] * sides[1] < 0 and sides[2] * sides[3] < 0:
        return True

    def on(p: Plan, q: Plan, r: Plan, side: float) -> bool:
        return side == 0 and bool((np.minimum(p, q) <= r).all() and (r <= np.maximum(p, q)).all())

    return any(on(*corner, side) for corner, side in zip(corners, sides, strict=True))
