"""ArduCopter flown by sticks (LOITER, ALT_HOLD, STABILIZE) and by SET_ATTITUDE_TARGET in GUIDED."""

import math

from sitl.arducopter.autonomy import Velocity
from sitl.arducopter.vehicle_setup import HOVER_THROTTLE, tilt_max
from sitl.flight.control import Setpoint
from sitl.flight.physics import GRAVITY, Body, heading
from sitl.parameters import Parameters
from sitl.stick_input import StickInput, deadzone, quaternion
from sitl.targets import AttitudeTarget

NAN = math.nan
NAN3 = (NAN, NAN, NAN)
DEAD = 0.05
"""Dead middle of the sticks."""
THRUST_DEAD = 0.1
"""THR_DZ: 100 of 1000 about the throttle's middle."""
GROUND_SHARE = 0.6
"""Share of the hover throttle below which a vehicle flown by thrust stays on the ground."""

IGNORE_RATES, IGNORE_THRUST, IGNORE_ATTITUDE = 7, 64, 128
"""ATTITUDE_TARGET_TYPEMASK."""
THRUST_AS_THRUST = 8
"""GUID_OPTIONS: SET_ATTITUDE_TARGET.thrust is thrust; else 0 to 1 are full descent to full climb."""


def climb_rate(stick: float, p: Parameters) -> float:
    """Climb [m/s] of a throttle stick from -1 to 1: PILOT_SPEED_UP, PILOT_SPEED_DN (0: as up)."""
    up = p["PILOT_SPEED_UP"] * 0.01
    return deadzone(stick, THRUST_DEAD) * (up if stick > 0.0 else p["PILOT_SPEED_DN"] * 0.01 or up)


def yaw_rate(stick: float, p: Parameters) -> float:
    """[rad/s]: PILOT_Y_RATE."""
    return deadzone(stick, DEAD) * math.radians(p["PILOT_Y_RATE"])


class LoiterSticks:
    """LOITER, POSHOLD: sticks are a velocity by heading, up to LOIT_SPEED; centred, it brakes and holds."""

    landing = False

    def __init__(self, body: Body, p: Parameters, sticks: StickInput) -> None:
        self._p = p
        self._sticks = sticks
        self._flight = Velocity(body, p)

    @property
    def climbs(self) -> bool:
        """Whether a vehicle on the ground is asked to leave it."""
        return climb_rate(self._sticks.now.throttle, self._p) > 0.0

    def step(self, body: Body, dt: float) -> Setpoint:
        p, now = self._p, self._sticks.now
        fastest = p["LOIT_SPEED"] * 0.01
        forward, right = fastest * deadzone(now.forward, DEAD), fastest * deadzone(now.right, DEAD)
        yaw = heading(body.attitude)
        c, s = math.cos(yaw), math.sin(yaw)
        self._flight.velocity = (c * forward - s * right, s * forward + c * right, -climb_rate(now.throttle, p))
        self._flight.yaw_rate = yaw_rate(now.yaw, p)
        return self._flight.step(body, dt)


class LeanSticks:
    """ALT_HOLD and STABILIZE: sticks are a lean up to ANGLE_MAX; the throttle is a climb rate, or thrust itself."""

    landing = False

    def __init__(self, body: Body, p: Parameters, sticks: StickInput, by_thrust: bool) -> None:
        self._p = p
        self._sticks = sticks
        self._by_thrust = by_thrust
        self._yaw = heading(body.attitude)

    @property
    def climbs(self) -> bool:
        """Whether a vehicle on the ground is asked to leave it."""
        if self._by_thrust:
            return self._thrust() > GROUND_SHARE * HOVER_THROTTLE
        return climb_rate(self._sticks.now.throttle, self._p) > 0.0

    def _thrust(self) -> float:
        """Middle stick is hover."""
        throttle = self._sticks.now.throttle
        room = 1.0 - HOVER_THROTTLE if throttle > 0.0 else HOVER_THROTTLE
        return HOVER_THROTTLE + throttle * room

    def step(self, body: Body, dt: float) -> Setpoint:
        p, now = self._p, self._sticks.now
        self._yaw = math.remainder(self._yaw + yaw_rate(now.yaw, p) * dt, math.tau)
        lean = tilt_max(p)
        attitude = quaternion(lean * deadzone(now.right, DEAD), -lean * deadzone(now.forward, DEAD), self._yaw)
        if self._by_thrust:
            return Setpoint(NAN3, NAN3, NAN3, NAN, NAN, thrust=self._thrust(), attitude=attitude)
        return leaning(attitude, climb_rate(now.throttle, p))


class Attitude:
    """GUIDED by SET_ATTITUDE_TARGET: an attitude with a climb rate, or attitude or rates with a thrust."""

    landing = False

    def __init__(self, setpoint: Setpoint) -> None:
        self._setpoint = setpoint

    @property
    def climbs(self) -> bool:
        """Whether a vehicle on the ground is asked to leave it; a climb rate does not (CMD 22 does)."""
        return self._setpoint.thrust > GROUND_SHARE * HOVER_THROTTLE

    def step(self, body: Body, dt: float) -> Setpoint:
        return self._setpoint


def attitude_setpoint(asked: AttitudeTarget, p: Parameters) -> Setpoint | None:
    """What GUIDED flies of a SET_ATTITUDE_TARGET; None when it means nothing."""
    norm = math.sqrt(sum(value * value for value in asked.attitude))
    if asked.mask & IGNORE_THRUST or not math.isfinite(asked.thrust):
        return None
    thrust = min(max(asked.thrust, 0.0), 1.0)
    direct = bool(int(p["GUID_OPTIONS"]) & THRUST_AS_THRUST)
    if asked.mask & IGNORE_ATTITUDE:
        if asked.mask & IGNORE_RATES or not direct or not all(map(math.isfinite, asked.rates)):
            return None
        return Setpoint(NAN3, NAN3, NAN3, NAN, NAN, thrust=thrust, rates=asked.rates)
    if not (math.isfinite(norm) and norm > 0.1):
        return None
    w, x, y, z = (value / norm for value in asked.attitude)
    if direct:
        return Setpoint(NAN3, NAN3, NAN3, NAN, NAN, thrust=thrust, attitude=(w, x, y, z))
    climb = 2.0 * thrust - 1.0
    speed = p["WPNAV_SPEED_UP"] if climb > 0.0 else p["WPNAV_SPEED_DN"]
    return leaning((w, x, y, z), climb * speed * 0.01)


def leaning(attitude: tuple[float, float, float, float], climb: float) -> Setpoint:
    """A lean with a climb rate [m/s]: the acceleration that the lean makes in level flight, and the heading."""
    w, x, y, z = attitude
    zx, zy, zz = 2.0 * (w * y + x * z), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)
    zz = max(zz, 0.2)
    yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return Setpoint(NAN3, (NAN, NAN, -climb), (-GRAVITY * zx / zz, -GRAVITY * zy / zz, NAN), yaw, NAN)
