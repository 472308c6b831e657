"""Flying a mission: item after item, each turned into setpoints; shared by all personalities.

What differs between them (speeds, acceptance, how to take off, land and go home) comes as `Manners` and `Pilot`.
"""

import math
from dataclasses import dataclass, replace
from typing import Protocol

from sitl.flight.control import Setpoint
from sitl.flight.physics import Body, heading
from sitl.flight.reference import (
    ERROR_MAX_M,
    Limits,
    Reference,
    Vec3,
    lead,
    speed_for_distance,
    stopping_point,
    turned,
    vector,
)
from sitl.plan import (
    CHANGE_SPEED,
    DELAY,
    DO_JUMP,
    LAND,
    LOITER_TIME,
    LOITER_UNLIM,
    PLACES,
    RETURN,
    SET_HOME,
    TAKEOFF,
    WAYPOINT,
    Item,
    Plans,
)

NAN = math.nan
NAN3 = (NAN, NAN, NAN)
ORDERS_PER_TICK = 50
"""A mission of nothing but jumps must not stop the clock."""
TURN_DISTANCE_M = 1.0
"""Closer than this the heading no longer follows the way to the target."""


class Leg(Protocol):
    """Anything that makes setpoints tick by tick."""

    @property
    def landing(self) -> bool: ...

    def step(self, body: Body, dt: float) -> Setpoint: ...


class Climb(Leg, Protocol):
    """A takeoff."""

    @property
    def done(self) -> bool: ...


@dataclass(frozen=True)
class Manners:
    """How a personality flies to places."""

    limits: Limits
    speed_max: float
    """Fastest that may be asked for [m/s] (MPC_XY_VEL_MAX)."""
    radius: float
    """An item is reached inside this horizontal distance [m] (NAV_ACC_RAD, WPNAV_RADIUS) ..."""
    height: float
    """... and inside this vertical distance [m] (NAV_MC_ALT_RAD)."""
    yaw_rate: float
    """Fastest turn [rad/s]."""
    first_height: float
    """Takeoff put before a mission that begins on the ground without one [m above home] (MIS_TAKEOFF_ALT)."""
    tells_orders: bool
    """Whether MISSION_ITEM_REACHED is said of items that only order something (speed, home, camera)."""
    takeoff_goes_there: bool
    """Whether a takeoff item's own latitude and longitude are flown to after the climb."""


class Pilot(Protocol):
    """What a mission asks of the vehicle that flies it."""

    @property
    def on_ground(self) -> bool: ...

    def place(self, item: Item, here: Vec3) -> Vec3:
        """NED of an item with a position."""
        ...

    def takeoff(self, down: float) -> Climb:
        """Straight up to a height given by its NED down; NaN: `Manners.first_height`."""
        ...

    def land(self, north: float, east: float) -> Leg: ...

    def return_home(self) -> Leg | None:
        """None: the vehicle changes its mode."""
        ...

    def set_home(self, place: Vec3) -> None: ...


def corner_speed(before: Vec3, corner: Vec3, after: Vec3, acceleration: float, radius: float) -> float:
    """Speed [m/s] to pass a corner at: sqrt(a r tan(alpha/2)) with alpha the angle between the legs, pi = straight on.

    As PX4's trajectory constraints (computeMaxSpeedInWaypoint) have it.
    """
    ax, ay = before[0] - corner[0], before[1] - corner[1]
    bx, by = after[0] - corner[0], after[1] - corner[1]
    a, b = math.hypot(ax, ay), math.hypot(bx, by)
    if a < 1e-3 or b < 1e-3:
        return 0.0
    alpha = math.acos(min(max((ax * bx + ay * by) / (a * b), -1.0), 1.0))
    return math.sqrt(acceleration * radius * math.tan(min(0.5 * alpha, 1.57)))


def pass_by(reference: Reference, target: Vec3, end_speed: float, actual: Vec3, limits: Limits, dt: float) -> Reference:
    """Move the reference straight towards `target`, to arrive with `end_speed`; it waits for a vehicle that lags."""
    p = reference.position
    d = (target[0] - p[0], target[1] - p[1], target[2] - p[2])
    distance = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    wish: Vec3 = (0.0, 0.0, 0.0)
    if distance > 1e-6:
        climb = limits.speed_down if d[2] > 0.0 else limits.speed_up
        speed = along(d, distance, limits.speed_xy, climb)
        braking = along(d, distance, limits.acceleration_xy, limits.braking_z)
        jerk = along(d, distance, limits.jerk, limits.jerk)
        speed = min(speed, math.hypot(end_speed, speed_for_distance(distance, braking, jerk)))
        wish = (d[0] / distance * speed, d[1] / distance * speed, d[2] / distance * speed)
    dt *= 1.0 - min(max(lead(reference, actual), 0.0) / ERROR_MAX_M, 1.0)
    v = reference.velocity
    change = (wish[0] - v[0], wish[1] - v[1], wish[2] - v[2])
    size = math.sqrt(change[0] * change[0] + change[1] * change[1] + change[2] * change[2])
    share = 1.0
    if size > 1e-9:  # all axes together, so that the way stays straight
        share = min(1.0, along(change, size, limits.acceleration_xy, limits.acceleration_z) * dt / size)
    v = (v[0] + change[0] * share, v[1] + change[1] * share, v[2] + change[2] * share)
    return Reference((p[0] + v[0] * dt, p[1] + v[1] * dt, p[2] + v[2] * dt), v)


def along(direction: Vec3, length: float, level: float, vertical: float) -> float:
    """The largest multiple of a direction of this length that keeps a horizontal and a vertical limit."""
    flat, steep = math.hypot(direction[0], direction[1]) / length, abs(direction[2]) / length
    return min(level / max(flat, 1e-9), vertical / max(steep, 1e-9))


class Fly:
    """To a place, and stay there; nose first unless a yaw is asked for."""

    landing = False

    def __init__(
        self, reference: Reference, target: Vec3, yaw: float, manners: Manners, goal_yaw: float = NAN, end: float = 0.0
    ) -> None:
        """`yaw` is the heading now; `end` the speed to arrive with [m/s]."""
        self.reference = reference
        self.target = target
        self._manners = manners
        self._limits = manners.limits
        self.yaw = yaw
        self._goal_yaw = goal_yaw
        self._end = end

    def set_speed(self, speed: float | None) -> None:
        """Fly at so many m/s; None: as usual."""
        usual = self._manners.limits
        self._limits = usual if speed is None else replace(usual, speed_xy=min(speed, self._manners.speed_max))

    def distance(self, body: Body) -> tuple[float, float]:
        """Horizontal and vertical distance of the vehicle to the place [m]."""
        x, y, z = vector(body.position)
        return math.hypot(self.target[0] - x, self.target[1] - y), abs(self.target[2] - z)

    def step(self, body: Body, dt: float) -> Setpoint:
        actual = vector(body.position)
        self.reference = pass_by(self.reference, self.target, self._end, actual, self._limits, dt)
        goal = self._goal_yaw
        if math.isnan(goal):
            north, east = self.target[0] - actual[0], self.target[1] - actual[1]
            far = math.hypot(north, east) > TURN_DISTANCE_M
            goal = math.atan2(east, north) if far else self.yaw
        self.yaw = turned(self.yaw, goal, self._manners.yaw_rate * dt)
        return Setpoint(self.reference.position, self.reference.velocity, NAN3, self.yaw, NAN)


class MissionFlight:
    """Flies the mission in `plans` from its current item on."""

    def __init__(self, body: Body, plans: Plans, manners: Manners, pilot: Pilot) -> None:
        self._plans = plans
        self._manners = manners
        self._pilot = pilot
        if plans.finished:
            plans.rewind()
        self._seq = plans.current
        self._held = 0.0
        """How long the vehicle has been where the item wants it [s]."""
        self._climb: Climb | None = None
        self._phase = "fly"
        """climb, fly, land, or what the personality flies home with: return."""
        self._paused = False
        self._leg: Leg = self._stay(body)
        if pilot.on_ground and not self._is(TAKEOFF) and math.isfinite(manners.first_height):
            self._start_climb(NAN)
        else:
            self._begin(body)

    # What the commander looks at

    @property
    def landing(self) -> bool:
        return self._leg.landing

    @property
    def taking_off(self) -> bool:
        """Whether it is on its way up from the ground."""
        return self._phase == "climb"

    @property
    def finished(self) -> bool:
        """Whether the last item is done; the place is held then."""
        return self._plans.finished

    @property
    def place(self) -> Vec3 | None:
        """The place flown to, if there is one."""
        return self._leg.target if isinstance(self._leg, Fly) else None

    def set_speed(self, speed: float | None) -> None:
        """What DO_CHANGE_SPEED asks for, on the leg under way; later legs take it from the plans."""
        if isinstance(self._leg, Fly):
            self._leg.set_speed(speed)

    def pause(self, hold: bool, body: Body) -> None:
        """Brake and hold, or go on with the current item."""
        if hold and not self._paused:
            here = stopping_point(self._reference(body), self._manners.limits)
            self._leg = Fly(self._reference(body), here, self._yaw(body), self._manners, self._yaw(body))
        elif not hold and self._paused:
            self._begin(body)
        self._paused = hold

    # Ticks

    def step(self, body: Body, dt: float) -> Setpoint:
        if self._seq != self._plans.current:  # the ground has chosen another item
            self._paused = False
            self._begin(body)
        if self._paused:
            return self._leg.step(body, dt)
        spent = dt  # time is held against one item only
        for _ in range(ORDERS_PER_TICK):
            if self._plans.finished or not self._done(body, spent):
                break
            spent = 0.0
            self._next(body)
        return self._leg.step(body, dt)

    def _item(self) -> Item | None:
        mission = self._plans.mission
        return mission[self._seq] if self._seq < len(mission) else None

    def _is(self, command: int) -> bool:
        item = self._item()
        return item is not None and item.command == command

    def _done(self, body: Body, dt: float) -> bool:
        """Whether the current item is completed, this tick of dt [s] counted."""
        item = self._item()
        if item is None:
            return True
        if self._phase == "climb":
            return self._climb is not None and self._climb.done and self._after_climb(body, item)
        if self._phase == "land":
            return self._pilot.on_ground
        if self._phase == "return":
            return False
        if item.command == DELAY:
            self._held += dt
            return not self._held < item.p[0]
        if item.command not in PLACES:
            return True
        if not self._arrived(body, item):
            return False
        if item.command == LAND:
            assert isinstance(self._leg, Fly)
            self._phase = "land"
            self._leg = self._pilot.land(self._leg.target[0], self._leg.target[1])
            return False
        self._held += dt
        wait = item.p[0] if item.command in (WAYPOINT, LOITER_TIME) and math.isfinite(item.p[0]) else 0.0
        return item.command != LOITER_UNLIM and self._held >= wait

    def _after_climb(self, body: Body, item: Item) -> bool:
        """Whether nothing is left of a takeoff item; a climb put before the mission is followed by its item."""
        if item.command != TAKEOFF:
            self._begin(body)
            return False
        if self._manners.takeoff_goes_there and not item.here:
            self._phase = "fly"
            self._leg = self._fly(body, item)
            return False
        return True

    def _arrived(self, body: Body, item: Item) -> bool:
        if self._held > 0.0:
            return True
        if not isinstance(self._leg, Fly):
            return False
        flat, high = self._leg.distance(body)
        asked = item.p[1] if item.command == WAYPOINT else 0.0
        return flat <= (asked if asked > 0.0 else self._manners.radius) and high <= self._manners.height

    def _next(self, body: Body) -> None:
        """The current item is done: tell so, and begin the one after it."""
        plans = self._plans
        item = self._item()
        following = self._seq + 1
        if item is not None and item.command == DO_JUMP:  # told to nobody, as autopilots do
            followed = plans.jumps.get(self._seq, 0)
            if item.p[1] < 0 or followed < item.p[1]:
                plans.jumps[self._seq] = followed + 1
                following = int(item.p[0])
        elif item is not None and (self._manners.tells_orders or item.command in PLACES | {RETURN, DELAY}):
            plans.reached.append(self._seq)
        if following >= len(plans.mission):
            plans.finished = True
            if not isinstance(self._leg, Fly):
                self._leg = self._stay(body)
            return
        plans.current = following
        self._begin(body)

    def _begin(self, body: Body) -> None:
        """Set out for the current item."""
        self._seq = self._plans.current
        self._held = 0.0
        self._phase = "fly"
        item = self._item()
        if item is None:
            return
        if item.command == TAKEOFF and self._pilot.on_ground:
            self._start_climb(self._pilot.place(item, vector(body.position))[2])
        elif item.command in PLACES:
            self._leg = self._fly(body, item)
        elif item.command == RETURN:
            leg = self._pilot.return_home()
            if leg is not None:
                self._phase, self._leg = "return", leg
        elif item.command == CHANGE_SPEED:
            self._change_speed(item)
        elif item.command == SET_HOME:
            here = vector(body.position)
            self._pilot.set_home(here if item.p[0] == 1.0 else self._pilot.place(item, here))
        elif item.command == DELAY and not isinstance(self._leg, Fly):
            self._leg = self._stay(body)

    def _start_climb(self, down: float) -> None:
        self._phase = "climb"
        self._climb = self._pilot.takeoff(down)
        self._leg = self._climb

    def _change_speed(self, item: Item) -> None:
        """DO_CHANGE_SPEED: param2 [m/s]; not above zero is the usual speed again."""
        self._plans.speed = item.p[1] if item.p[1] > 0.0 else None
        self.set_speed(self._plans.speed)

    def _reference(self, body: Body) -> Reference:
        """Where the last leg has its reference, so that speed is kept from item to item."""
        if isinstance(self._leg, Fly):
            return self._leg.reference
        return Reference(vector(body.position), vector(body.velocity))

    def _yaw(self, body: Body) -> float:
        return self._leg.yaw if isinstance(self._leg, Fly) else heading(body.attitude)

    def _stay(self, body: Body) -> Fly:
        here = vector(body.position)
        return Fly(Reference(here, vector(body.velocity)), here, heading(body.attitude), self._manners)

    def _fly(self, body: Body, item: Item) -> Fly:
        reference = self._reference(body)
        here = self._leg.target if isinstance(self._leg, Fly) else reference.position
        target = self._pilot.place(item, here)
        if item.command == LAND:  # level to above the place, then down
            target = (target[0], target[1], reference.position[2])
        yaw = math.radians(item.p[3]) if item.command != LAND and math.isfinite(item.p[3]) else NAN
        leg = Fly(reference, target, self._yaw(body), self._manners, yaw, self._end_speed(item, reference, target))
        leg.set_speed(self._plans.speed)
        return leg

    def _end_speed(self, item: Item, reference: Reference, target: Vec3) -> float:
        """Speed at the item's place: a waypoint without a hold is flown through on the way to the next place."""
        if item.command != WAYPOINT or item.p[0] > 0.0:
            return 0.0
        for after in self._plans.mission[self._seq + 1 :]:
            if after.command in (DELAY, RETURN, DO_JUMP, LAND):
                return 0.0
            if after.command in PLACES:
                place = self._pilot.place(after, target)
                limits = self._manners.limits
                corner = corner_speed(reference.position, target, place, limits.acceleration_xy, self._manners.radius)
                return min(corner, math.dist(target, place))
        return 0.0
