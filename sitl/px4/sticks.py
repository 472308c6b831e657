"""PX4's modes flown by sticks: position, altitude and stabilized, with the MPC_* and MC_* parameters of each."""

import math
from dataclasses import replace

from sitl.flight.control import Setpoint
from sitl.flight.physics import GRAVITY, Body, heading
from sitl.flight.reference import Limits, Reference, Vec3, follow_eased, vector
from sitl.parameters import Parameters
from sitl.px4.autonomy import limits
from sitl.stick_input import StickInput, deadzone, quaternion

NAN = math.nan
NAN3 = (NAN, NAN, NAN)
JOYSTICK_MODES, RADIO_MODES = (1, 2, 3), (0, 2, 3)
"""COM_RC_IN_MODE: 0 radio only, 1 joystick only, 2 and 3 either, 4 none."""


def expo(value: float, share: float, width: float) -> float:
    """Stick axis with a dead middle and a cubic share (math::expo_deadzone)."""
    x = deadzone(value, width)
    return (1.0 - share) * x + share * x**3


class _Stick:
    """What the stick modes share: climb and yaw."""

    landing = False

    def __init__(self, body: Body, p: Parameters, sticks: StickInput) -> None:
        self._p = p
        self._sticks = sticks
        self._yaw = heading(body.attitude)
        self._hold_down: float | None = None

    @property
    def climbs(self) -> bool:
        """Whether a vehicle on the ground is asked to leave it."""
        return deadzone(self._sticks.now.throttle, self._p["MPC_HOLD_DZ"]) > 0.0

    def _turn(self, body: Body) -> tuple[float, float]:
        """Yaw to hold and yaw rate [rad, rad/s]: the heading is kept while the stick is centred."""
        p = self._p
        rate = math.radians(p["MPC_MAN_Y_MAX"]) * expo(self._sticks.now.yaw, p["MPC_YAW_EXPO"], p["MPC_HOLD_DZ"])
        if rate != 0.0:
            self._yaw = heading(body.attitude)
            return NAN, rate
        return self._yaw, NAN

    def _climb(self, body: Body) -> tuple[float, float]:
        """Down position to hold and down velocity [m, m/s]."""
        p = self._p
        stick = expo(self._sticks.now.throttle, p["MPC_Z_MAN_EXPO"], p["MPC_HOLD_DZ"])
        if stick != 0.0:
            self._hold_down = None
            return NAN, -stick * (p["MPC_Z_VEL_MAX_UP"] if stick > 0.0 else p["MPC_Z_VEL_MAX_DN"])
        if self._hold_down is None and abs(body.velocity[2]) < p["MPC_HOLD_MAX_Z"]:
            self._hold_down = float(body.position[2])
        return (NAN, 0.0) if self._hold_down is None else (self._hold_down, 0.0)


class PositionSticks(_Stick):
    """POSCTL: sticks are a velocity by heading, up to MPC_VEL_MANUAL; centred, the place is held."""

    def __init__(self, body: Body, p: Parameters, sticks: StickInput) -> None:
        super().__init__(body, p, sticks)
        usual = limits(p)
        acceleration = p["MPC_ACC_HOR_MAX"]
        self._limits = Limits(
            p["MPC_VEL_MANUAL"], usual.speed_up, usual.speed_down, acceleration, usual.acceleration_z,
            usual.braking_z, p["MPC_JERK_MAX"],
        )  # fmt: skip
        self._reference = Reference(vector(body.position), vector(body.velocity))
        self._place: tuple[float, float] | None = None

    def _wish(self, body: Body) -> tuple[float, float]:
        """Velocity asked for, north and east [m/s]."""
        p, now = self._p, self._sticks.now
        dead, share, fastest = p["MPC_HOLD_DZ"], p["MPC_XY_MAN_EXPO"], p["MPC_VEL_MANUAL"]
        forward, right = now.forward, now.right
        length = math.hypot(forward, right)
        if length == 0.0:
            return 0.0, 0.0
        speed = fastest * expo(min(length, 1.0), share, dead) / length
        yaw = heading(body.attitude)
        c, s = math.cos(yaw), math.sin(yaw)
        return speed * (c * forward - s * right), speed * (s * forward + c * right)

    def step(self, body: Body, dt: float) -> Setpoint:
        north, east = self._wish(body)
        down, sink = self._climb(body)
        yaw, yaw_rate = self._turn(body)
        here: Vec3 = vector(body.position)
        self._reference = follow_eased(replace(self._reference, position=here), (north, east, 0.0), self._limits, dt)
        vx, vy, _ = self._reference.velocity
        if north != 0.0 or east != 0.0:
            self._place = None
        elif self._place is None and math.hypot(body.velocity[0], body.velocity[1]) < self._p["MPC_HOLD_MAX_XY"]:
            self._place = here[:2]
        if self._place is None:
            return Setpoint((NAN, NAN, down), (vx, vy, sink), NAN3, yaw, yaw_rate)
        return Setpoint((*self._place, down), (0.0, 0.0, sink), NAN3, yaw, yaw_rate)


class AltitudeSticks(_Stick):
    """ALTCTL: sticks are a tilt up to MPC_MAN_TILT_MAX; the height is held."""

    def step(self, body: Body, dt: float) -> Setpoint:
        down, sink = self._climb(body)
        yaw, yaw_rate = self._turn(body)
        tilt = math.radians(self._p["MPC_MAN_TILT_MAX"])
        forward, right = (
            GRAVITY * math.tan(tilt * stick) for stick in (self._sticks.now.forward, self._sticks.now.right)
        )
        at = heading(body.attitude)
        c, s = math.cos(at), math.sin(at)
        flat = (c * forward - s * right, s * forward + c * right, NAN)
        return Setpoint((NAN, NAN, down), (NAN, NAN, sink), flat, yaw, yaw_rate)


class StabilizedSticks(_Stick):
    """STABILIZED: sticks are a tilt, the throttle is thrust: hover in the middle, MPC_MANTHR_MIN at the bottom."""

    def step(self, body: Body, dt: float) -> Setpoint:
        p, now = self._p, self._sticks.now
        _, yaw_rate = self._turn(body)
        if not math.isnan(yaw_rate):
            self._yaw = heading(body.attitude) + yaw_rate * dt
        hover, lowest = p["MPC_THR_HOVER"], p["MPC_MANTHR_MIN"]
        top = p["MPC_THR_MAX"]
        thrust = hover + now.throttle * (top - hover if now.throttle > 0.0 else hover - lowest)
        tilt = math.radians(p["MPC_MAN_TILT_MAX"])
        attitude = quaternion(tilt * now.right, -tilt * now.forward, self._yaw)
        return Setpoint(NAN3, NAN3, NAN3, NAN, yaw_rate, thrust=thrust, attitude=attitude)
