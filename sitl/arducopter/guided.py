"""What GUIDED understands of a SET_POSITION_TARGET_LOCAL_NED."""

import math
from dataclasses import dataclass

from sitl.arducopter.shaper import near
from sitl.flight.reference import Vec3
from sitl.targets import PositionTarget

POSITION, VELOCITY, ACCELERATION = 0x007, 0x038, 0x1C0
FORCE, YAW, YAW_RATE = 0x200, 0x400, 0x800
"""Ignore bits of type_mask; one set bit of a vector ignores the whole vector."""
LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9
FRAMES = frozenset({LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED})
BODY = frozenset({BODY_NED, BODY_OFFSET_NED})

FAR_M = 100_000.0
"""No place is further away."""

NAN = math.nan
STILL: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Order:
    """What is flown, NED. Neither position nor velocity: stop."""

    position: Vec3 | None
    velocity: Vec3 | None
    yaw: float
    """[rad]; NaN keeps the heading."""
    yaw_rate: float
    """[rad/s]; 0 = none."""


STOP = Order(None, None, NAN, 0.0)
"""For frames, masks and values that mean nothing."""


def understood(asked: PositionTarget, here: Vec3, heading: float) -> Order:
    """The order in a setpoint, for a vehicle `here` with a `heading` [rad].

    Frames 1, 7, 8, 9 are known; in 7 to 9 positions are offsets from here, in 8 and 9 vectors turn with the heading.
    Anything else, a force for an acceleration, NaN or infinity in what is not ignored: stop.
    """
    mask = asked.mask
    position = asked.position if not mask & POSITION else None
    velocity = asked.velocity if not mask & VELOCITY else None
    forced = mask & FORCE and not mask & ACCELERATION  # MAVProxy's `velocity` sets the bit, and ignores accelerations
    if asked.frame not in FRAMES or forced or (position is None and velocity is None):
        return STOP
    if not all(map(math.isfinite, (*(position or STILL), *(velocity or STILL)))):
        return STOP
    if asked.frame in BODY:
        position = None if position is None else turned_by(position, heading)
        velocity = None if velocity is None else turned_by(velocity, heading)
    if position is not None:
        if asked.frame != LOCAL_NED:
            position = (here[0] + position[0], here[1] + position[1], here[2] + position[2])
        position = near(position, here, FAR_M)
    yaw = asked.yaw if not mask & YAW and math.isfinite(asked.yaw) else NAN
    if asked.frame in BODY:
        yaw += heading
    rate = asked.yaw_rate if not mask & YAW_RATE and math.isfinite(asked.yaw_rate) else 0.0
    return Order(position, velocity, yaw, rate)


def turned_by(vector: Vec3, heading: float) -> Vec3:
    """From the body's heading to north-east."""
    c, s = math.cos(heading), math.sin(heading)
    return c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]
