"""The trajectory action as a displacement in ENU, on floats and on torch tensors of any shape alike.

Components are separate arguments and results, so that one formula serves a single slot (floats) and a batch (tensors
with equal or broadcastable shapes). All are differentiable, also at a displacement of zero.
"""

import math
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

Real = TypeVar("Real", float, "Tensor")


def spherical(distance: Real, elevation: Real, azimuth: Real) -> tuple[Real, Real, Real]:
    """Displacement (east, north, up) [m] of a spherical move: the paper's {V, theta_T, phi_T} in constraint (21g).

    `distance` [m]; `elevation` [rad] in [-pi/2, pi/2] above the horizon; `azimuth` [rad] in [0, 2 pi] counter-clockwise
    from east.
    """
    horizontal = distance * _cos(elevation)
    return horizontal * _cos(azimuth), horizontal * _sin(azimuth), distance * _sin(elevation)


def clip_norm(dx: Real, dy: Real, dz: Real, limit: float) -> tuple[Real, Real, Real]:
    """Shorten a displacement to `limit` [m] (V_max times the slot, constraint 21h), keeping its direction."""
    shorter = limit / _clip(dx * dx + dy * dy + dz * dz, limit * limit, math.inf) ** 0.5
    return dx * shorter, dy * shorter, dz * shorter


def limit_climb(dz: Real, slot_s: float, up: float, down: float) -> Real:
    """Clip a climb [m] to what `up` and `down` [m/s], both positive, allow in a slot; the horizontal part is kept."""
    return _clip(dz, -down * slot_s, up * slot_s)


def _cos(angle: Real) -> Real:
    return math.cos(angle) if isinstance(angle, float | int) else angle.cos()


def _sin(angle: Real) -> Real:
    return math.sin(angle) if isinstance(angle, float | int) else angle.sin()


def _clip(value: Real, lower: float, upper: float) -> Real:
    return min(max(value, lower), upper) if isinstance(value, float | int) else value.clip(lower, upper)
