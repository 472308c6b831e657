"""How ArduCopter flies by itself: braking and velocity, takeoff, a destination, return, land.

Each turns the state into a setpoint tick by tick; `landing` tells that it is on its way to the ground.
"""

import math
from dataclasses import replace

from sitl.arducopter.shaper import Motion, Shape, eased_speed, held_back, limited, shaped, square_root
from sitl.arducopter.vehicle_setup import limits, shape
from sitl.flight.control import Setpoint
from sitl.flight.physics import Body, heading
from sitl.flight.reference import Limits, Reference, Vec3, approach, follow, stopping_point, turned, vector
from sitl.landing import Landing
from sitl.parameters import Parameters

NAN = math.nan
NAN3 = (NAN, NAN, NAN)
STILL: Vec3 = (0.0, 0.0, 0.0)
JERK_SHARE = 0.57
"""Of WPNAV_JERK, which is the peak of a raised cosine: held steadily, this makes the recorded S-curve of the return."""
TIGHT = 100.0
"""Times the jerk: so tightly is the speed of an S-curve followed."""
YAW_FAR_M = 2.0
"""Nearer than this the nose no longer follows the way to a place."""


def slew(p: Parameters) -> float:
    """ATC_SLEW_YAW in rad/s."""
    return math.radians(p["ATC_SLEW_YAW"] * 0.01)


class Velocity:
    """A velocity, shaped; zero is braking and holding the place. With a place it is flown to, `velocity` on top."""

    landing = False

    def __init__(self, body: Body, p: Parameters) -> None:
        self._p = p
        self._motion = Motion(vector(body.position), vector(body.velocity), STILL)
        self.velocity: Vec3 = STILL
        """Asked for [m/s]."""
        self.place: Vec3 | None = None
        """NED [m]."""
        self.yaw_goal = NAN
        """[rad]; NaN: no other heading than now."""
        self.yaw_rate = 0.0
        self._yaw = heading(body.attitude)

    def step(self, body: Body, dt: float) -> Setpoint:
        p = self._p
        by = shape(p)
        wish = limited(self.velocity)
        if self.place is not None:
            wish = towards(self.place, self._motion.position, wish, by, limits(p))
        motion = shaped(self._motion, wish, by, dt)
        self._motion = held_back(motion, vector(body.position), vector(body.velocity))
        turn = slew(p) * dt
        if math.isfinite(self.yaw_goal):
            self._yaw = turned(self._yaw, self.yaw_goal, turn)
        elif self.yaw_rate:
            self._yaw = math.remainder(self._yaw + min(max(self.yaw_rate * dt, -turn), turn), math.tau)
        m = self._motion
        # ArduCopter's D acts on the velocity error; the shared law's on the velocity alone: the rest is fed forward.
        forward = 1.0 + p["PSC_VELXY_D"]
        acceleration = (forward * m.acceleration[0], forward * m.acceleration[1], m.acceleration[2])
        return Setpoint(m.position, m.velocity, acceleration, self._yaw, NAN)


def towards(place: Vec3, here: Vec3, forward: Vec3, by: Shape, within: Limits) -> Vec3:
    """The velocity [m/s] that goes to a place and can be braked in time, on top of `forward`."""
    north, east, down = place[0] - here[0], place[1] - here[1], place[2] - here[2]
    distance = math.hypot(north, east)
    # Half of the acceleration is kept for what the jerk limit takes.
    speed = min(square_root(distance, 1.0, 0.5 * by.acceleration_xy), within.speed_xy)
    sink = square_root(down, 1.0, 0.5 * by.acceleration_z)
    share = speed / distance if distance > 1e-9 else 0.0
    return (
        forward[0] + north * share,
        forward[1] + east * share,
        forward[2] + min(max(sink, -within.speed_up), within.speed_down),
    )


class Level:
    """A mode for sticks that are centred: level, the height held, coasting."""

    landing = False

    def __init__(self, body: Body) -> None:
        self._yaw = heading(body.attitude)

    def step(self, body: Body, dt: float) -> Setpoint:
        return Setpoint(NAN3, (NAN, NAN, 0.0), (0.0, 0.0, NAN), self._yaw, NAN)


class Takeoff:
    """Straight up to a height, then hold there."""

    landing = False
    SLOW = 0.1
    """Share of the climb rate below which it ends, from where the height is reached anyhow (_AutoTakeoff::run)."""

    def __init__(self, body: Body, p: Parameters, target_down: float) -> None:
        self._limits = limits(p)
        self._start = vector(body.position)
        self.target = (self._start[0], self._start[1], target_down)
        self._reference = Reference(self._start, STILL)
        self._yaw = heading(body.attitude)
        self.done = False

    def step(self, body: Body, dt: float) -> Setpoint:
        if body.contact_s[0] > 0.0:
            self._reference = Reference(self._start, (0.0, 0.0, -0.3))  # enough to leave the ground
        else:
            self._reference = approach(self._reference, self.target, vector(body.position), self._limits, dt)
        slow = self.SLOW * self._limits.speed_up
        near = 0.5 * slow * slow / self._limits.acceleration_z
        _, _, down = self._reference.position
        climb = -self._reference.velocity[2]
        self.done = self.done or (down <= self.target[2] + near and climb <= slow)
        return Setpoint(self._reference.position, self._reference.velocity, NAN3, self._yaw, NAN)


class Destination:
    """To a place inside the WPNAV_* limits, and hold it."""

    landing = False

    def __init__(
        self, body: Body, p: Parameters, target: Vec3, yaw: float = NAN, nose_first: bool = True, speed_cms: float = 0.0
    ) -> None:
        """`yaw` NaN: nose first (WP_YAW_BEHAVIOR), or as it is."""
        self._p = p
        self._limits = limits(p, speed_cms)
        self.target = target
        self.reference = Reference(vector(body.position), vector(body.velocity))
        self.yaw = heading(body.attitude)
        self._speed = math.hypot(*self.reference.velocity[:2])
        self._acceleration = 0.0
        self._goal = yaw
        self._nose_first = nose_first and p["WP_YAW_BEHAVIOR"] > 0

    def step(self, body: Body, dt: float) -> Setpoint:
        here = vector(body.position)
        self._gather_speed(dt)
        most, jerk = self._limits, JERK_SHARE * self._p["WPNAV_JERK"]
        left = math.dist(self.reference.position[:2], self.target[:2])
        eased = eased_speed(left, most.speed_xy, most.acceleration_xy, jerk)
        within = replace(most, speed_xy=min(self._speed, eased), jerk=TIGHT * jerk)
        self.reference = approach(self.reference, self.target, here, within, dt)
        goal = self._goal
        if math.isnan(goal):
            north, east = self.target[0] - here[0], self.target[1] - here[1]
            far = self._nose_first and math.hypot(north, east) > YAW_FAR_M
            goal = math.atan2(east, north) if far else self.yaw
        self.yaw = turned(self.yaw, goal, slew(self._p) * dt)
        return Setpoint(self.reference.position, self.reference.velocity, NAN3, self.yaw, NAN)

    def _gather_speed(self, dt: float) -> None:
        """The speed allowed grows to the cruise speed with WPNAV_JERK at both ends (an S-curve)."""
        most, jerk = self._limits, JERK_SHARE * self._p["WPNAV_JERK"]
        ease_out = math.sqrt(2.0 * jerk * max(most.speed_xy - self._speed, 0.0))
        self._acceleration = min(self._acceleration + jerk * dt, most.acceleration_xy, ease_out)
        self._speed = min(self._speed + self._acceleration * dt, most.speed_xy)


class Land(Landing):
    """Brake and come down: at WPNAV_SPEED_DN (LAND_SPEED_HIGH), at LAND_SPEED below LAND_ALT_LOW."""

    AHEAD_M = 0.5
    """The height asked for is no further below the vehicle, also when that stands on the ground."""

    def __init__(self, body: Body, p: Parameters, ground_down: float, place: tuple[float, float] | None = None) -> None:
        super().__init__(body, limits(p), ground_down, place)
        self._p = p

    def sink_rate(self, height: float) -> float:
        """[m/s] at a height [m]: a square-root controller of the height above LAND_ALT_LOW."""
        p = self._p
        fast = p["LAND_SPEED_HIGH"] * 0.01 or self._limits.speed_down
        high = height - p["LAND_ALT_LOW"] * 0.01
        return max(p["LAND_SPEED"] * 0.01, min(fast, square_root(high, p["PSC_POSZ_P"], self._limits.acceleration_z)))

    def step(self, body: Body, dt: float) -> Setpoint:
        here = vector(body.position)
        level = (self._place[0], self._place[1], self._reference.position[2])
        flat = approach(self._reference, level, (here[0], here[1], self._reference.position[2]), self._limits, dt)
        sink = self.sink_rate(self._ground_down - here[2])
        down = follow(self._reference, (0.0, 0.0, sink), self._limits, dt).velocity[2]
        below = min(self._reference.position[2] + down * dt, here[2] + self.AHEAD_M)
        self._reference = Reference(
            (flat.position[0], flat.position[1], below), (flat.velocity[0], flat.velocity[1], down)
        )
        return Setpoint(self._reference.position, self._reference.velocity, NAN3, self._yaw, NAN)


class BlindLand:
    """Without a position: level, drifting with the wind, down as Land does by height."""

    landing = True

    def __init__(self, body: Body, p: Parameters, ground_down: float) -> None:
        self._land = Land(body, p, ground_down)
        self._ground_down = ground_down
        self._yaw = heading(body.attitude)

    def step(self, body: Body, dt: float) -> Setpoint:
        sink = self._land.sink_rate(self._ground_down - float(body.position[2]))
        return Setpoint(NAN3, (NAN, NAN, sink), (0.0, 0.0, NAN), self._yaw, NAN)


class Return:
    """RTL: climb to RTL_ALT (or what RTL_CONE_SLOPE makes of it), fly home, wait RTL_LOIT_TIME, land.

    With RTL_ALT_FINAL above zero it comes down to that height and stays.
    """

    CLIMB_MIN_CM = 200.0
    """RTL_ALT_MIN of ArduCopter: never lower than this on the way home."""

    def __init__(self, body: Body, p: Parameters, home: Vec3) -> None:
        self._p = p
        self._home = home
        self._waited = 0.0
        self._phase = "climb"
        height = self.height(home[2] - float(body.position[2]), math.dist(vector(body.position)[:2], home[:2]))
        self._cruise_down = home[2] - height
        here = stopping_point(Reference(vector(body.position), vector(body.velocity)), limits(p))
        self._leg: Destination | Land = self._to(body, (here[0], here[1], self._cruise_down), nose_first=False)
        if height <= home[2] - float(body.position[2]) + 0.5:
            self._start_cruise(body)

    def height(self, now: float, distance: float) -> float:
        """Height above home to fly back at [m], for a vehicle at a height `now` and a distance from home."""
        p = self._p
        wanted = p["RTL_ALT"]
        if p["RTL_CONE_SLOPE"] > 0.0:
            wanted = min(wanted, max(distance * 100.0 * p["RTL_CONE_SLOPE"], self.CLIMB_MIN_CM))
        return max(now + p["RTL_CLIMB_MIN"] * 0.01, wanted * 0.01)

    @property
    def landing(self) -> bool:
        return self._phase == "land"

    def _to(self, body: Body, target: Vec3, nose_first: bool) -> Destination:
        return Destination(body, self._p, target, nose_first=nose_first, speed_cms=self._p["RTL_SPEED"])

    def _start_cruise(self, body: Body) -> None:
        """WP_YAW_BEHAVIOR 2 keeps the heading in RTL; 1 turns the nose home."""
        self._phase = "cruise"
        target = (self._home[0], self._home[1], self._cruise_down)
        before = self._leg
        self._leg = self._to(body, target, nose_first=self._p["WP_YAW_BEHAVIOR"] == 1)
        if isinstance(before, Destination):
            self._leg.reference = before.reference

    def step(self, body: Body, dt: float) -> Setpoint:
        there = math.dist(vector(body.position)[:2], self._home[:2]) < self._p["WPNAV_RADIUS"] * 0.01
        level = abs(float(body.position[2]) - self._cruise_down) < 0.5
        if self._phase == "climb" and level:
            self._start_cruise(body)
        elif self._phase == "cruise" and there and isinstance(self._leg, Destination) and self._rests():
            self._phase = "wait"
        elif self._phase == "wait":
            self._waited += dt
            if self._waited >= self._p["RTL_LOIT_TIME"] * 0.001:
                self._come_down(body)
        return self._leg.step(body, dt)

    def _rests(self) -> bool:
        """Whether the way home is over: the reference stands above home."""
        assert isinstance(self._leg, Destination)
        return math.dist(self._leg.reference.position[:2], self._home[:2]) < 0.1

    def _come_down(self, body: Body) -> None:
        final = self._p["RTL_ALT_FINAL"] * 0.01
        if final > 0.0:
            self._phase = "stay"
            self._leg = self._to(body, (self._home[0], self._home[1], self._home[2] - final), nose_first=False)
        else:
            self._phase = "land"
            self._leg = Land(body, self._p, self._home[2], self._home[:2])
