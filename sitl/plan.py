"""Plans that ground stations upload: mission items and fences as MAVLink carries them, and what is wrong with them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from sitl.flight.reference import Vec3
from sitl.origin import Origin


class Kind(IntEnum):
    """MAV_MISSION_TYPE."""

    MISSION = 0
    FENCE = 1
    RALLY = 2


class Verdict(IntEnum):
    """MAV_MISSION_RESULT."""

    ACCEPTED = 0
    ERROR = 1
    UNSUPPORTED_FRAME = 2
    UNSUPPORTED = 3
    NO_SPACE = 4
    INVALID = 5
    INVALID_PARAM1 = 6
    INVALID_PARAM2 = 7
    INVALID_PARAM5_X = 10
    INVALID_PARAM6_Y = 11
    INVALID_PARAM7 = 12
    INVALID_SEQUENCE = 13
    DENIED = 14
    OPERATION_CANCELLED = 15


WAYPOINT, LOITER_UNLIM, LOITER_TIME, RETURN, LAND, TAKEOFF, LOITER_TO_ALT = 16, 17, 19, 20, 21, 22, 31
SPLINE_WAYPOINT, DELAY, DO_JUMP, CHANGE_SPEED, SET_HOME = 82, 93, 177, 178, 179
POLYGON_INCLUSION, POLYGON_EXCLUSION, CIRCLE_INCLUSION, CIRCLE_EXCLUSION = 5001, 5002, 5003, 5004

PLACES = frozenset({WAYPOINT, LOITER_UNLIM, LOITER_TIME, LAND, TAKEOFF, LOITER_TO_ALT, SPLINE_WAYPOINT})
"""Commands with a position: these are flown to."""
ORDERS = frozenset({RETURN, DELAY, DO_JUMP, CHANGE_SPEED, SET_HOME})
"""Commands without one (SET_HOME has one only when param1 is 0)."""
PAYLOAD = frozenset({203, 204, 205, 206, 214, 530, 531, 532, 1000, 1001, 2000, 2001, 2003, 2500, 2501})
"""Camera and gimbal items, which autopilots pass on to the payload. There is none here: passed over in flight."""
POLYGONS = frozenset({POLYGON_INCLUSION, POLYGON_EXCLUSION})
CIRCLES = frozenset({CIRCLE_INCLUSION, CIRCLE_EXCLUSION})

FRAME_MISSION = 2
AMSL_FRAMES = frozenset({0, 5})
"""MAV_FRAME_GLOBAL, _INT: altitude above mean sea level."""
RELATIVE_FRAMES = frozenset({3, 6})
"""MAV_FRAME_GLOBAL_RELATIVE_ALT, _INT: altitude above home."""
ALTITUDE_MAX_M = 100_000.0
VERTICES_MIN = 3


@dataclass(frozen=True)
class Item:
    """One MISSION_ITEM_INT."""

    frame: int
    command: int
    p: tuple[float, float, float, float]
    x: int
    """Latitude [1e-7 deg]."""
    y: int
    """Longitude [1e-7 deg]."""
    z: float
    """Altitude [m] as `frame` says."""
    autocontinue: int = 1

    @property
    def here(self) -> bool:
        """Whether latitude and longitude are left open (0, 0): where the vehicle is then."""
        return self.x == 0 and self.y == 0


def place(item: Item, origin: Origin, home: Vec3, here: Vec3) -> Vec3:
    """Where an item is, NED [m] from the origin; latitude and longitude 0, 0 mean `here`."""
    north, east = here[:2] if item.here else origin.local(item.x * 1e-7, item.y * 1e-7)
    down = home[2] - item.z if item.frame in RELATIVE_FRAMES else origin.altitude - item.z
    return north, east, down


def judge(item: Item, kind: Kind) -> Verdict:
    """What is wrong with an item by itself; ACCEPTED when nothing is."""
    if any(math.isinf(value) for value in item.p):
        return Verdict.INVALID
    if kind is Kind.FENCE:
        return _judge_fence_item(item)
    if item.command in PLACES:
        return _judge_position(item)
    if item.command not in ORDERS | PAYLOAD:
        return Verdict.UNSUPPORTED
    if item.command == SET_HOME and item.p[0] != 1.0:
        return _judge_position(item)
    if item.command == CHANGE_SPEED and math.isnan(item.p[1]):
        return Verdict.INVALID_PARAM2
    return Verdict.ACCEPTED


def _judge_position(item: Item) -> Verdict:
    if item.frame not in AMSL_FRAMES | RELATIVE_FRAMES:
        return Verdict.UNSUPPORTED_FRAME
    if abs(item.x) > 90 * 10**7:
        return Verdict.INVALID_PARAM5_X
    if abs(item.y) > 180 * 10**7:
        return Verdict.INVALID_PARAM6_Y
    if not abs(item.z) <= ALTITUDE_MAX_M:
        return Verdict.INVALID_PARAM7
    return Verdict.ACCEPTED


def _judge_fence_item(item: Item) -> Verdict:
    if item.command in POLYGONS:
        if not (item.p[0] >= VERTICES_MIN and item.p[0] == int(item.p[0])):
            return Verdict.INVALID_PARAM1
    elif item.command in CIRCLES:
        if not item.p[0] > 0.0:
            return Verdict.INVALID_PARAM1
    else:
        return Verdict.UNSUPPORTED
    return _judge_position(item)


def judge_whole(items: Sequence[Item], kind: Kind) -> Verdict:
    """What is wrong with a complete plan whose items are good: jumps that lead nowhere, polygons cut short."""
    if kind is Kind.FENCE:
        index = 0
        while index < len(items):
            size = int(items[index].p[0]) if items[index].command in POLYGONS else 1
            part = items[index : index + size]
            if len(part) < size or any(
                item.command != part[0].command or (size > 1 and item.p[0] != part[0].p[0]) for item in part
            ):
                return Verdict.INVALID
            index += size
        return Verdict.ACCEPTED
    for item in items:
        if item.command == DO_JUMP and not 0 <= item.p[0] < len(items):
            return Verdict.INVALID_PARAM1
    return Verdict.ACCEPTED


class Plans:
    """What the ground has given to this vehicle, and how far its mission is."""

    def __init__(self, first: int = 0) -> None:
        """`first` is the index of the first item that is flown; ArduPilot keeps home at 0."""
        self.first = first
        self.mission: tuple[Item, ...] = ()
        self.fence: tuple[Item, ...] = ()
        self.mission_changes = 0
        self.fence_changes = 0
        self.current = first
        """Index of the item flown now, or to be flown next."""
        self.finished = False
        self.speed: float | None = None
        """Horizontal speed that the mission or the ground asked for [m/s]; None: the parameter's."""
        self.jumps: dict[int, int] = {}
        """How often each DO_JUMP was followed."""
        self.reached: list[int] = []
        """Items done that the ground has not been told of yet."""

    def store(self, kind: Kind, items: tuple[Item, ...]) -> None:
        """A new plan in place of the old one; a mission begins at its first item."""
        if kind is Kind.FENCE:
            self.fence = items
            self.fence_changes += 1
        else:
            self.mission = items
            self.mission_changes += 1
            self.rewind()

    @property
    def flyable(self) -> bool:
        """Whether there is an item to fly."""
        return len(self.mission) > self.first

    @property
    def begun(self) -> bool:
        """Whether the mission is somewhere after its first item."""
        return self.current > self.first

    def rewind(self) -> None:
        """Back to the first item."""
        self.go_to(self.first)

    def go_to(self, seq: int) -> None:
        """Go on at an item, as if the mission had not been flown."""
        self.current = max(seq, self.first)
        self.finished = False
        self.speed = None
        self.jumps = {}
