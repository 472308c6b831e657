"""The tracking law: PX4's own position loop, closed by the bridge so that only velocity and yaw are ever sent.

    v = v_ref + drag * v_ref + lead * a_ref + K (p_ref - p),    K = 0.95 /s (PX4 MPC_XY_P)

`lead` makes up, per axis, for the time in which the autopilot's velocity loop answers; `drag`, level only, for what it
falls short of a velocity that is held against the air (see the dialect). One 3-vector to check, one type mask on every
autopilot, and a stream that stops really is a vehicle that stops.
"""

import math

import numpy as np

from airframe.slot_profile import Reference, Vector, triple

POSITION_GAIN = 0.95
"""[1/s]"""
LEVEL = (1.0, 1.0, 0.0)
NEAR_M = 2.0
"""A place this near below has no heading worth turning to."""


def track(
    reference: Reference, position: Vector, lead_s: tuple[float, float, float], drag_share: float = 0.0
) -> Vector:
    """Velocity setpoint [m/s] for a vehicle at `position` [m]; all in ENU, shape (3,)."""
    places = zip(triple(reference.position), triple(position), strict=True)
    moves = zip(triple(reference.velocity), triple(reference.acceleration), lead_s, LEVEL, strict=True)
    return np.array(
        [
            velocity * (1.0 + drag_share * level) + lead * acceleration + POSITION_GAIN * (there - here)
            for (there, here), (velocity, acceleration, lead, level) in zip(places, moves, strict=True)
        ]
    )


def follow(reference: Reference) -> Vector:
    """Velocity setpoint [m/s] of the open loop, for comparison: what is lost on the way is never made up for."""
    return reference.velocity


def heading_to(place: tuple[float, float], position: Vector, before: float) -> float:
    """Yaw [rad, ENU] from `position` towards a `place` (east, north); `before` when it is as good as below."""
    east, north = place[0] - float(position[0]), place[1] - float(position[1])
    return math.atan2(north, east) if math.hypot(east, north) > NEAR_M else before
