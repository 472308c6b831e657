"""The trajectory action as a displacement in ENU, on floats and on torch tensors of any shape alike.

Components are separate arguments and results, so that one formula serves a single slot (floats) and a batch (tensors
with equal or broadcastable shapes). Its limits are kept where it is decoded (`agent.decoding`).
"""

import math
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

Real = TypeVar("Real", float, "Tensor")


def spherical(distance: Real, elevation: Real, azimuth: Real) -> tuple[Real, Real, Real]:
    """Displacement (east, north, up) [m] of a spherical move: the paper's {V, theta_T, phi_T} (constraint 21h).

    `distance` [m]; `elevation` [rad] in [-pi/2, pi/2] above the horizon; `azimuth` [rad] in [0, 2 pi] counter-clockwise
    from east.
    """
    horizontal = distance * _cos(elevation)
    return horizontal * _cos(azimuth), horizontal * _sin(azimuth), distance * _sin(elevation)


def _cos(angle: Real) -> Real:
    return math.cos(angle) if isinstance(angle, float | int) else angle.cos()


def _sin(angle: Real) -> Real:
    return math.sin(angle) if isinstance(angle, float | int) else angle.sin()
