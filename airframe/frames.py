"""East-north-up (ours, everywhere) and north-east-down (MAVLink's), in plain arithmetic."""

import math
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

Real = TypeVar("Real", float, "Tensor")


def enu_to_ned(east: Real, north: Real, up: Real) -> tuple[Real, Real, Real]:
    """(east, north, up) -> (north, east, down)."""
    return north, east, -up


def ned_to_enu(north: Real, east: Real, down: Real) -> tuple[Real, Real, Real]:
    """(north, east, down) -> (east, north, up)."""
    return east, north, -down


def yaw_enu_to_ned(yaw: float) -> float:
    """Yaw [rad] counter-clockwise from east -> clockwise from north, in [-pi, pi]."""
    return wrap(math.pi / 2 - yaw)


def yaw_ned_to_enu(yaw: float) -> float:
    """Yaw [rad] clockwise from north -> counter-clockwise from east, in [-pi, pi]."""
    return wrap(math.pi / 2 - yaw)


def wrap(angle: float) -> float:
    """The same angle [rad] in [-pi, pi]."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
