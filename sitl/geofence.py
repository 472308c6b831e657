"""Geofences: where a vehicle may be. Pure geometry in local north, east, down."""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeAlias

from sitl.flight.reference import Vec3
from sitl.origin import Origin
from sitl.plan import CIRCLE_INCLUSION, CIRCLES, POLYGON_INCLUSION, Item

Point = tuple[float, float]


class Breach(IntEnum):
    """FENCE_BREACH."""

    NONE = 0
    MINALT = 1
    MAXALT = 2
    BOUNDARY = 3


@dataclass(frozen=True)
class Polygon:
    """A closed line; not crossing itself."""

    vertices: tuple[Point, ...]
    inclusion: bool

    def contains(self, point: Point) -> bool:
        """Even-odd rule."""
        x, y = point
        inside = False
        ax, ay = self.vertices[-1]
        for bx, by in self.vertices:
            if (ay > y) != (by > y) and x < ax + (bx - ax) * (y - ay) / (by - ay):
                inside = not inside
            ax, ay = bx, by
        return inside

    def nearest(self, point: Point) -> tuple[Point, ...]:
        """The nearest point of each side."""
        corners = self.vertices
        return tuple(_on_segment(corners[i - 1], corners[i], point) for i in range(len(corners)))


@dataclass(frozen=True)
class Circle:
    """A round area."""

    centre: Point
    radius: float
    """[m]"""
    inclusion: bool

    def contains(self, point: Point) -> bool:
        return math.dist(point, self.centre) < self.radius

    def nearest(self, point: Point) -> tuple[Point, ...]:
        """The nearest point of the line."""
        north, east = point[0] - self.centre[0], point[1] - self.centre[1]
        distance = math.hypot(north, east)
        if distance < 1e-9:
            north, east, distance = 1.0, 0.0, 1.0
        scale = self.radius / distance
        return ((self.centre[0] + north * scale, self.centre[1] + east * scale),)


Area: TypeAlias = Polygon | Circle

BENDS = 8
"""In a corner, what is cut for one wall may point at another."""


def _on_segment(a: Point, b: Point, point: Point) -> Point:
    """The point of the segment a-b nearest to another."""
    north, east = b[0] - a[0], b[1] - a[1]
    length = north * north + east * east
    share = ((point[0] - a[0]) * north + (point[1] - a[1]) * east) / length if length > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    return a[0] + share * north, a[1] + share * east


@dataclass(frozen=True)
class Fence:
    """Areas and limits; inf where there is no limit."""

    areas: tuple[Area, ...] = ()
    any_inclusion: bool = True
    """Whether to be in one of several inclusion areas is enough (PX4), or all must hold (ArduPilot)."""
    radius: float = math.inf
    """From home [m]."""
    height_max: float = math.inf
    """Above home [m]."""
    height_min: float = -math.inf

    @property
    def there(self) -> bool:
        """Whether anything is fenced."""
        return bool(self.areas) or math.isfinite(self.radius) or math.isfinite(self.height_max - self.height_min)

    def breach(self, place: Vec3, home: Vec3) -> Breach:
        """What is breached at a place, the boundary last."""
        height = home[2] - place[2]
        if height > self.height_max:
            return Breach.MAXALT
        if height < self.height_min:
            return Breach.MINALT
        flat = (place[0], place[1])
        if math.dist(flat, home[:2]) > self.radius or not self.within_areas(flat):
            return Breach.BOUNDARY
        return Breach.NONE

    def within_areas(self, point: Point) -> bool:
        """Whether a point is in the inclusion areas, and in no exclusion area."""
        included = [area.contains(point) for area in self.areas if area.inclusion]
        if included and not (any(included) if self.any_inclusion else all(included)):
            return False
        return not any(area.contains(point) for area in self.areas if not area.inclusion)


def areas(items: tuple[Item, ...], origin: Origin) -> tuple[Area, ...]:
    """The areas of an uploaded fence, whose items have been judged good."""
    found: list[Area] = []
    index = 0
    while index < len(items):
        item = items[index]
        if item.command in CIRCLES:
            found.append(Circle(_point(item, origin), item.p[0], item.command == CIRCLE_INCLUSION))
            index += 1
            continue
        part = items[index : index + int(item.p[0])]
        found.append(Polygon(tuple(_point(i, origin) for i in part), item.command == POLYGON_INCLUSION))
        index += len(part)
    return tuple(found)


def _point(item: Item, origin: Origin) -> Point:
    return origin.local(item.x * 1e-7, item.y * 1e-7)


def bent(
    velocity: Vec3, place: Vec3, home: Vec3, fence: Fence, margin: float, gain: float, acceleration: float
) -> Vec3:
    """A velocity that keeps `margin` [m] from the fence: what points at it is cut to what can still be stopped.

    As ArduPilot's AC_Avoid: along the shortest way to each boundary the speed is at most
    sqrt(2 a (d - a / (2 k^2))), or k d near it. Sliding along the fence is left alone. Outside nothing is changed.
    """
    if fence.breach(place, home) is not Breach.NONE:
        return velocity
    north, east, down = velocity
    flat = (place[0], place[1])
    rings: list[Area] = [*fence.areas]
    if math.isfinite(fence.radius):
        rings.append(Circle(home[:2], fence.radius, inclusion=True))
    walls = [wall for area in rings for wall in area.nearest(flat)]
    for _ in range(BENDS):
        free = True
        for wall in walls:
            distance = math.dist(wall, flat)
            if distance < 1e-6:
                continue
            unit = ((wall[0] - flat[0]) / distance, (wall[1] - flat[1]) / distance)
            excess = north * unit[0] + east * unit[1] - stoppable(distance - margin, gain, acceleration)
            if excess > 1e-9:
                north, east, free = north - excess * unit[0], east - excess * unit[1], False
        if free:
            break
    else:  # a corner that cutting does not get out of
        north = east = 0.0
    room = fence.height_max - (home[2] - place[2]) - margin
    down = max(down, -stoppable(room, gain, acceleration))
    return north, east, down


def stoppable(distance: float, gain: float, acceleration: float) -> float:
    """Speed [m/s] from which a vehicle stops within `distance` [m]: linear near it, a square root far off."""
    if distance <= 0.0:
        return 0.0
    if math.isinf(distance):
        return math.inf
    linear = acceleration / (gain * gain)
    if distance <= linear:
        return distance * gain
    return math.sqrt(2.0 * acceleration * (distance - 0.5 * linear))
