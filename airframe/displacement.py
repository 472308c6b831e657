"""The trajectory action as a displacement in ENU. Its limits are kept where it is decoded (`agent.decoding`)."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def spherical(distance: "Tensor", elevation: "Tensor", azimuth: "Tensor") -> "tuple[Tensor, Tensor, Tensor]":
    """Displacement (east, north, up) [m] of a spherical move: the paper's {V, theta_T, phi_T} (constraint 21h).

    `distance` [m]; `elevation` [rad] in [-pi/2, pi/2] above the horizon; `azimuth` [rad] in [0, 2 pi] counter-clockwise
    from east. Shapes broadcast.
    """
    horizontal = distance * elevation.cos()
    return horizontal * azimuth.cos(), horizontal * azimuth.sin(), distance * elevation.sin()
