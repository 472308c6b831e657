"""The modes that fly by themselves: takeoff, hold, return, land, and the blind descent of a failsafe.

Each turns the state into a setpoint, tick by tick. `landing` tells the landed-state machine that the mode
is on its way to the ground.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

from sitl.flight.control import Setpoint
from sitl.flight.physics import Body, heading
from sitl.flight.reference import Limits, Reference, Vec3, approach, eased, follow_eased, stopping_point, turned, vector
from sitl.landing import Landing
from sitl.parameters import Parameters

NAN = math.nan
NAN3 = (NAN, NAN, NAN)
STANDING_SPEED = 0.7
"""Downwards [m/s]: where the velocity asked for by a takeoff begins (FlightTaskAuto::reActivate)."""

Say = Callable[[str], None]


class Autonomous(Protocol):
    """A mode that makes its own setpoints."""

    @property
    def landing(self) -> bool: ...

    def step(self, body: Body, dt: float) -> Setpoint: ...


def limits(p: Parameters) -> Limits:
    """MPC_* limits of the autonomous modes."""
    return Limits(
        speed_xy=min(p["MPC_XY_CRUISE"], p["MPC_XY_VEL_MAX"]),
        speed_up=min(p["MPC_Z_V_AUTO_UP"], p["MPC_Z_VEL_MAX_UP"]),
        speed_down=min(p["MPC_Z_V_AUTO_DN"], p["MPC_Z_VEL_MAX_DN"]),
        acceleration_xy=p["MPC_ACC_HOR"],
        acceleration_z=p["MPC_ACC_UP_MAX"],
        braking_z=p["MPC_ACC_DOWN_MAX"],
        jerk=p["MPC_JERK_AUTO"],
    )


def tracking(reference: Reference, yaw: float) -> Setpoint:
    """Follow a reference: its position, its velocity and acceleration as feed-forward."""
    return Setpoint(reference.position, reference.velocity, reference.acceleration, yaw, NAN)


class Loiter:
    """AUTO.LOITER: brake, then hold the place."""

    landing = False

    def __init__(self, body: Body, p: Parameters, target: Vec3 | None = None) -> None:
        """`target` is the place to hold; None: where braking ends."""
        self._limits = limits(p)
        self._reference = Reference(vector(body.position), vector(body.velocity))
        self.target = target or stopping_point(self._reference, self._limits)
        self._yaw = heading(body.attitude)

    def step(self, body: Body, dt: float) -> Setpoint:
        self._reference = approach(self._reference, self.target, vector(body.position), self._limits, dt)
        return tracking(self._reference, self._yaw)


class Takeoff:
    """AUTO.TAKEOFF: straight up to a height.

    Up to MPC_LAND_ALT1 above home at MPC_TKO_SPEED, which is reached in MPC_TKO_RAMP_T; above that as AUTO climbs.
    """

    landing = False

    def __init__(
        self, body: Body, p: Parameters, target_down: float, ground_down: float, flying: Callable[[], bool]
    ) -> None:
        self._limits = limits(p)
        self._slow = replace(
            self._limits,
            speed_up=min(p["MPC_TKO_SPEED"], self._limits.speed_up),
            acceleration_z=min(p["MPC_TKO_SPEED"] / p["MPC_TKO_RAMP_T"], self._limits.acceleration_z),
        )
        self._slow = replace(self._slow, braking_z=self._slow.acceleration_z)
        self._slow_above = ground_down - p["MPC_LAND_ALT1"]
        self._accept = p["NAV_MC_ALT_RAD"]
        self._flying = flying
        start = vector(body.position)
        self.target = (start[0], start[1], target_down)
        self._reference = Reference(start, vector(body.velocity) if flying() else (0.0, 0.0, STANDING_SPEED))
        self._yaw = heading(body.attitude)
        self.done = False

    def step(self, body: Body, dt: float) -> Setpoint:
        here = vector(body.position)
        self.done = here[2] <= self.target[2] + min(self._accept, 0.5 * abs(self.target[2]))
        if here[2] <= self._slow_above:
            self._reference = approach(self._reference, self.target, here, self._limits, dt)
            return tracking(self._reference, self._yaw)
        if self._flying():  # the height itself is not tracked yet
            at = Reference((self.target[0], self.target[1], here[2]), self._reference.velocity)
            self._reference = approach(at, self.target, here, self._slow, dt)
        x, y, _ = self.target
        return Setpoint((x, y, NAN), self._reference.velocity, NAN3, self._yaw, NAN)


class Land(Landing):
    """AUTO.LAND: brake and come down; slower below MPC_LAND_ALT1, 2 and 3 above home."""

    def __init__(self, body: Body, p: Parameters, ground_down: float, place: tuple[float, float] | None = None) -> None:
        super().__init__(body, limits(p), ground_down, place)
        self._p = p

    def sink_rate(self, height: float) -> float:
        """Descent speed [m/s] at a height above home [m]."""
        p = self._p
        if height < p["MPC_LAND_ALT3"]:
            return p["MPC_LAND_CRWL"]
        share = (height - p["MPC_LAND_ALT2"]) / max(p["MPC_LAND_ALT1"] - p["MPC_LAND_ALT2"], 1e-6)
        slow = min(p["MPC_LAND_SPEED"], self._limits.speed_down)
        return slow + min(max(share, 0.0), 1.0) * (self._limits.speed_down - slow)

    def step(self, body: Body, dt: float) -> Setpoint:
        actual = vector(body.position)
        level = (self._place[0], self._place[1], self._reference.position[2])
        flat = eased(self._reference, level, (actual[0], actual[1], self._reference.position[2]), self._limits, dt)
        sink = self.sink_rate(self._ground_down - actual[2])
        down = follow_eased(self._reference, (0.0, 0.0, sink), self._limits, dt)
        self._reference = Reference(
            (flat.position[0], flat.position[1], actual[2]),
            (flat.velocity[0], flat.velocity[1], down.velocity[2]),
            (flat.acceleration[0], flat.acceleration[1], down.acceleration[2]),
        )
        x, y, _ = self._reference.position
        return Setpoint((x, y, NAN), self._reference.velocity, self._reference.acceleration, self._yaw, NAN)


class Return:
    """AUTO.RTL: climb, fly home nose first, land with the heading of arming.

    With an RTL_LAND_DELAY it first comes down to RTL_DESCEND_ALT and waits so long.
    """

    def __init__(self, body: Body, p: Parameters, home: Vec3, home_yaw: float, home_altitude: float, say: Say) -> None:
        self._p = p
        self._say = say
        self._home = home
        self._home_yaw = home_yaw
        self._limits = limits(p)
        self._reference = Reference(vector(body.position), vector(body.velocity))
        here = stopping_point(self._reference, self._limits)
        distance = math.dist(here[:2], home[:2])
        height = max(self.return_height(distance), home[2] - body.position[2])
        self._cruise_down = home[2] - height
        self._climb_target = (here[0], here[1], self._cruise_down)
        self._yaw = heading(body.attitude)
        self._phase = "climb"
        self._waited = 0.0
        self._land: Land | None = None
        say(f"RTL: start return at {home_altitude + height:.0f} m ({height:.0f} m above destination)")

    def return_height(self, distance: float) -> float:
        """Height above home to fly back at: RTL_RETURN_ALT, lower inside the cone of RTL_CONE_ANG near home."""
        p = self._p
        accept = p["NAV_ACC_RAD"]
        if distance <= accept:
            return 2.0 * distance
        height = p["RTL_RETURN_ALT"]
        if distance <= p["RTL_MIN_DIST"] and p["RTL_CONE_ANG"] > 0:
            cone = math.radians(min(max(p["RTL_CONE_ANG"], 1.0), 89.0))
            height = min(distance / math.tan(cone), height)
        return max(height, 2.0 * accept)

    @property
    def landing(self) -> bool:
        return self._phase in ("descend", "wait", "land")

    @property
    def target(self) -> Vec3:
        """Where it flies to now."""
        if self._phase == "climb":
            return self._climb_target
        if self._phase == "cruise":
            return (self._home[0], self._home[1], self._cruise_down)
        return (self._home[0], self._home[1], max(self._cruise_down, self._home[2] - self._p["RTL_DESCEND_ALT"]))

    def _next_phase(self, body: Body, dt: float) -> None:
        target = self.target
        level = abs(body.position[2] - target[2]) < self._p["NAV_MC_ALT_RAD"]
        there = math.dist(vector(body.position)[:2], target[:2]) < self._p["NAV_ACC_RAD"]
        if self._phase == "climb" and level:
            self._phase = "cruise"
        elif self._phase == "cruise" and there:
            self._phase = "descend"
            self._say("RTL: land at destination")
            if self._p["RTL_LAND_DELAY"] == 0.0:
                self._come_down(body)
        elif self._phase == "descend" and level:
            self._phase = "wait"
        elif self._phase == "wait":
            self._waited += dt
            if self._waited >= self._p["RTL_LAND_DELAY"]:
                self._come_down(body)

    def _come_down(self, body: Body) -> None:
        self._phase = "land"
        self._land = Land(body, self._p, self._home[2], self._home[:2])

    def step(self, body: Body, dt: float) -> Setpoint:
        self._next_phase(body, dt)
        position = vector(body.position)
        if self._phase != "climb":
            north, east = self._home[0] - position[0], self._home[1] - position[1]
            far = self._phase == "cruise" and math.hypot(north, east) > self._p["NAV_ACC_RAD"]
            goal = math.atan2(east, north) if far else self._home_yaw
            self._yaw = turned(self._yaw, goal, math.radians(self._p["MPC_YAWRAUTO_MAX"]) * dt)
        if self._land is not None:
            return self._land.step(body, dt)._replace(yaw=self._yaw)
        climbing = replace(self._limits, braking_z=self._limits.acceleration_z)
        within = climbing if self._phase == "climb" else self._limits
        self._reference = eased(self._reference, self.target, position, within, dt)
        return tracking(self._reference, self._yaw)


class Descend:
    """What position mode does without sticks, and landing without a position: level, coast, sink at MPC_LAND_SPEED."""

    def __init__(self, body: Body, p: Parameters, landing: bool = False) -> None:
        self.landing = landing
        self._sink = p["MPC_LAND_SPEED"]
        self._yaw = heading(body.attitude)

    def step(self, body: Body, dt: float) -> Setpoint:
        return Setpoint(NAN3, (NAN, NAN, self._sink), (0.0, 0.0, NAN), self._yaw, NAN)
