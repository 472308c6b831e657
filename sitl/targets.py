"""Setpoints, destinations and sticks as they came in, before a personality decides what it flies of them."""

from dataclasses import dataclass

from sitl.flight.reference import Vec3


@dataclass(frozen=True)
class PositionTarget:
    """SET_POSITION_TARGET_LOCAL_NED, field by field; any value, NaN and infinity included."""

    frame: int
    """MAV_FRAME."""
    mask: int
    """POSITION_TARGET_TYPEMASK: set bits are ignored."""
    position: Vec3
    velocity: Vec3
    acceleration: Vec3
    yaw: float
    yaw_rate: float
    message: str = "SET_POSITION_TARGET_LOCAL_NED"
    """What it came as."""


@dataclass(frozen=True)
class AttitudeTarget:
    """SET_ATTITUDE_TARGET, field by field; any value."""

    mask: int
    """ATTITUDE_TARGET_TYPEMASK: set bits are ignored."""
    attitude: tuple[float, float, float, float]
    """Body to NED, w first."""
    rates: Vec3
    """FRD [rad/s]."""
    thrust: float


@dataclass(frozen=True)
class Sticks:
    """A pilot's sticks, each -1 to 1, 0 in the middle."""

    forward: float
    right: float
    throttle: float
    yaw: float
    """Clockwise from above."""


@dataclass(frozen=True)
class Destination:
    """DO_REPOSITION; NaN leaves a value as it is."""

    place: Vec3
    """NED [m]; north and east are NaN together."""
    yaw: float
    """[rad]"""
    speed: float
    """[m/s]; the usual one when not above zero."""
    flags: int
    """MAV_DO_REPOSITION_FLAGS."""
