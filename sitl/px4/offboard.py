"""The OFFBOARD setpoint stream: what arrives, whether it is alive, and what is flown of it."""

import math
from dataclasses import dataclass

from sitl.flight.control import Setpoint
from sitl.flight.reference import Vec3
from sitl.targets import AttitudeTarget, PositionTarget

NAN = math.nan
NAN3 = (NAN, NAN, NAN)
FRAME_LOCAL_NED = 1
FRAME_BODY_NED = 8
IGNORE_YAW = 1024
IGNORE_YAW_RATE = 2048
FORCE = 512

# ATTITUDE_TARGET_TYPEMASK
IGNORE_RATES = 7
IGNORE_BODY_YAW_RATE = 4
IGNORE_THRUST = 64
IGNORE_ATTITUDE = 128

SETTLE_MS = 40
"""A setpoint stream must be this old before OFFBOARD may be entered."""
LOSS_EXTRA_MS = 50
"""What PX4 takes beyond COM_OF_LOSS_T to see that the stream is gone."""


class SetpointRefusedError(ValueError):
    """A setpoint that is not flown; the text is PX4's STATUSTEXT."""


@dataclass(frozen=True)
class Target:
    """The fields of SET_POSITION_TARGET_LOCAL_NED that are flown; NaN where ignored or not finite."""

    position: Vec3
    velocity: Vec3
    acceleration: Vec3
    yaw: float
    yaw_rate: float


def masked(values: Vec3, mask: int, first_bit: int) -> Vec3:
    """The values whose ignore bits are clear; NaN for the others and for infinities."""
    x, y, z = (
        value if not mask >> (first_bit + axis) & 1 and math.isfinite(value) else NAN
        for axis, value in enumerate(values)
    )
    return x, y, z


def rotated(values: Vec3, yaw: float) -> Vec3:
    """From the body's heading to north-east."""
    c, s = math.cos(yaw), math.sin(yaw)
    return (c * values[0] - s * values[1], s * values[0] + c * values[1], values[2])


def read_target(asked: PositionTarget, heading: float) -> Target:
    """Understand a SET_POSITION_TARGET_LOCAL_NED as PX4 does.

    Raises SetpointRefusedError for frames other than 1 and 8, for force setpoints and when nothing is left to fly.
    In frame 8 (body) positions mean nothing and are ignored.
    """
    frame, mask = asked.frame, asked.mask
    position, velocity, acceleration = asked.position, asked.velocity, asked.acceleration
    if frame not in (FRAME_LOCAL_NED, FRAME_BODY_NED):
        raise SetpointRefusedError(f"{asked.message} coordinate frame {frame} unsupported")
    if mask & FORCE:
        raise SetpointRefusedError(f"{asked.message} force not supported")
    infinite = any(
        math.isinf(value) and not mask >> bit & 1 for bit, value in enumerate((*position, *velocity, *acceleration))
    )
    position, velocity, acceleration = (
        masked(position, mask, 0),
        masked(velocity, mask, 3),
        masked(acceleration, mask, 6),
    )
    if not infinite and all(math.isnan(value) for value in (*position, *velocity, *acceleration)):
        raise SetpointRefusedError(f"{asked.message} invalid")
    if frame == FRAME_BODY_NED:
        position = NAN3
        velocity = rotated(velocity, heading)
        acceleration = rotated(acceleration, heading)
    return Target(
        position,
        velocity,
        acceleration,
        NAN if mask & IGNORE_YAW or not math.isfinite(asked.yaw) else asked.yaw,
        NAN if mask & IGNORE_YAW_RATE or not math.isfinite(asked.yaw_rate) else asked.yaw_rate,
    )


def flown(target: Target) -> Setpoint:
    """The setpoint flown for a target: all three axes controlled, north and east alike, or else a brake to zero."""
    known = [
        [math.isfinite(value) for value in values] for values in (target.position, target.velocity, target.acceleration)
    ]
    complete = all(any(kind[axis] for kind in known) for axis in range(3))
    paired = all(kind[0] == kind[1] for kind in known)
    if not (complete and paired):
        return Setpoint(NAN3, (0.0, 0.0, 0.0), NAN3, target.yaw, target.yaw_rate)
    return Setpoint(target.position, target.velocity, target.acceleration, target.yaw, target.yaw_rate)


def flown_attitude(asked: AttitudeTarget) -> Setpoint:
    """The setpoint flown for a SET_ATTITUDE_TARGET: an attitude if there is one, or else body rates, with a thrust.

    Raises SetpointRefusedError when either is missing or not finite, or the quaternion has no length.
    """
    norm = math.sqrt(sum(value * value for value in asked.attitude))
    with_attitude = not asked.mask & IGNORE_ATTITUDE
    refused = SetpointRefusedError("SET_ATTITUDE_TARGET invalid")
    if asked.mask & IGNORE_THRUST or not math.isfinite(asked.thrust):
        raise refused
    thrust = min(max(asked.thrust, 0.0), 1.0)
    if with_attitude:
        if not (math.isfinite(norm) and norm > 0.1):
            raise refused
        w, x, y, z = (value / norm for value in asked.attitude)
        yaw_rate = NAN if asked.mask & IGNORE_BODY_YAW_RATE or not math.isfinite(asked.rates[2]) else asked.rates[2]
        return Setpoint(NAN3, NAN3, NAN3, NAN, yaw_rate, thrust=thrust, attitude=(w, x, y, z))
    if asked.mask & IGNORE_RATES or not all(math.isfinite(rate) for rate in asked.rates):
        raise refused
    return Setpoint(NAN3, NAN3, NAN3, NAN, NAN, thrust=thrust, rates=asked.rates)


class OffboardStream:
    """The latest setpoint and how alive the stream is, on vehicle time."""

    def __init__(self) -> None:
        self.setpoint: Setpoint | None = None
        self._first_ms = 0
        self._last_ms = 0

    def receive(self, setpoint: Setpoint, now_ms: int, loss_s: float) -> None:
        """What is flown for a setpoint that came; after a silence a new stream begins with it."""
        if self.setpoint is None or not self.alive(now_ms, loss_s):
            self._first_ms = now_ms
        self.setpoint = setpoint
        self._last_ms = now_ms

    def alive(self, now_ms: int, loss_s: float) -> bool:
        """Whether the last setpoint is younger than COM_OF_LOSS_T (and what PX4 takes to notice)."""
        return self.setpoint is not None and now_ms - self._last_ms < loss_s * 1000.0 + LOSS_EXTRA_MS

    def ready(self, now_ms: int, loss_s: float) -> bool:
        """Whether OFFBOARD may be entered: alive, and not begun this very instant."""
        return self.alive(now_ms, loss_s) and now_ms - self._first_ms >= SETTLE_MS
