"""The fence that somebody has uploaded to the autopilot (MAV_MISSION_TYPE_FENCE), and whether a flight fits into it.

Heights of uploaded areas are not looked at, as neither autopilot does.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from pydantic import ValidationError
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.fence import Box, Cylinder, Polygon

Corner = tuple[float, float]
"""East, north about home [m]."""
EARTH_RADIUS_M = 6371000.0
"""PX4's; ArduPilot's is 0.1 % larger: a metre at one kilometre."""
ANY_HEIGHT = (-1e6, 1e6)
POLYGONS = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: True,
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: False,
}
CIRCLES = {mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: True, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: False}
"""MAV_CMD -> whether the vehicle must stay inside."""


@dataclass(frozen=True)
class FenceItem:
    """What of a MISSION_ITEM_INT makes a fence."""

    command: int
    value: float
    """How many vertices the polygon has, or the circle's radius [m]."""
    latitude: float
    longitude: float
    """[deg]."""


@dataclass(frozen=True)
class Area:
    """In plan, ENU about home [m]."""

    inclusion: bool
    shape: Polygon | Cylinder

    def __str__(self) -> str:
        kind = "inclusion" if self.inclusion else "exclusion"
        if isinstance(self.shape, Cylinder):
            (east, north), radius = self.shape.centre, self.shape.radius
            return f"{kind} circle of {radius:.1f} m about ({east:.1f}, {north:.1f})"
        return f"{kind} polygon of {len(self.shape.polygon)} corners from {_rounded(self.shape.polygon[0])}"


def areas(items: Iterable[FenceItem], home: tuple[float, float, float]) -> tuple[Area, ...]:
    """What these items fence, about the home (deg, deg, m). Raises ValueError for what is no fence."""
    found: list[Area] = []
    corners: list[Corner] = []
    for item in items:
        place = _about(home, item)
        if item.command in POLYGONS:
            corners.append(place)
            if len(corners) == round(item.value):
                found.append(Area(POLYGONS[item.command], _polygon(corners)))
                corners = []
        elif item.command in CIRCLES:
            if not 0 < item.value < math.inf:
                raise ValueError(f"a circle's radius is {item.value:g} m")
            found.append(Area(CIRCLES[item.command], Cylinder(centre=place, radius=item.value, altitude=ANY_HEIGHT)))
        elif item.command != mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT:
            raise ValueError(f"MAV_CMD {item.command} fences nothing that is known")
    if corners:
        raise ValueError(f"its last polygon has {len(corners)} corners, not as many as it says")
    return tuple(found)


def objection(found: Sequence[Area], any_inclusion: bool, box: Box, start: Corner, keep_off_m: float) -> str:
    """Why a flight in `box`, and straight from home to the `start` (east, north), does not fit; empty when it does.

    `any_inclusion`: one inclusion area is enough (PX4), else each must hold the flight.
    """
    flown = (_corridor((0.0, 0.0), start, keep_off_m), _outline(box.grown(keep_off_m, 0.0)))
    inclusions = [area for area in found if area.inclusion]
    out = [area for area in inclusions if not all(area.shape.holds([*corners, corners[0]]) for corners in flown)]
    enough = any_inclusion and len(out) < len(inclusions)
    if out and not enough:
        return f"{out[0]} must hold the box and the way from home to the start, with {keep_off_m:g} m to spare"
    for area in found:
        if not area.inclusion and any(_reaches_into(area.shape, corners) for corners in flown):
            return f"{area} must be {keep_off_m:g} m away from the box and from the way from home to the start"
    return ""


def _about(home: tuple[float, float, float], item: FenceItem) -> Corner:
    north = math.radians(item.latitude - home[0]) * EARTH_RADIUS_M
    around = EARTH_RADIUS_M * math.cos(math.radians(home[0]))
    return math.radians(math.remainder(item.longitude - home[1], 360.0)) * around, north


def _polygon(corners: Sequence[Corner]) -> Polygon:
    try:
        return Polygon(polygon=tuple(corners), altitude=ANY_HEIGHT)
    except ValidationError as error:
        raise ValueError(f"a polygon of {len(corners)} corners: {error.errors()[0]['msg']}") from None


def _outline(box: Box) -> list[Corner]:
    (west, east), (south, north) = box.x, box.y
    return [(west, south), (east, south), (east, north), (west, north)]


def _corridor(begin: Corner, end: Corner, aside_m: float) -> list[Corner]:
    """The corners of all that is near a straight way."""
    length = math.dist(begin, end)
    along = ((end[0] - begin[0]) / length, (end[1] - begin[1]) / length) if length > 0 else (1.0, 0.0)
    east, north = aside_m * along[0], aside_m * along[1]
    return [
        (begin[0] - east + north, begin[1] - north - east),
        (end[0] + east + north, end[1] + north - east),
        (end[0] + east - north, end[1] + north + east),
        (begin[0] - east - north, begin[1] - north + east),
    ]


def _reaches_into(shape: Polygon | Cylinder, corners: Sequence[Corner]) -> bool:
    """Whether it has a point in common with the quadrilateral."""
    flown = _polygon(corners)
    if isinstance(shape, Cylinder):
        return flown.beyond_m([shape.centre]) <= shape.radius
    return (
        any(flown.beyond_m([corner]) == 0.0 for corner in shape.polygon)
        or any(shape.beyond_m([corner]) == 0.0 for corner in corners)
        or any(_cross(side, other) for side in _sides(shape.polygon) for other in _sides(corners))
    )


def _sides(corners: Sequence[Corner]) -> list[tuple[Corner, Corner]]:
    return [(corners[number - 1], corner) for number, corner in enumerate(corners)]


def _cross(one: tuple[Corner, Corner], other: tuple[Corner, Corner]) -> bool:
    """Whether two segments do; where one only touches the other a corner tells."""

    def apart(line: tuple[Corner, Corner], points: tuple[Corner, Corner]) -> bool:
        """Whether the points are on two sides of the line."""
        (ax, ay), (bx, by) = line
        first, second = ((bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in points)
        return first * second < 0

    return apart(one, other) and apart(other, one)


def _rounded(corner: Corner) -> str:
    return f"({corner[0]:.1f}, {corner[1]:.1f})"
