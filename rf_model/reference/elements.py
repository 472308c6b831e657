"""What the elements of a surface can do, in the reference's terms (`rf_model.surfaces` has the surfaces)."""

from enum import IntEnum
from typing import Literal, TypeAlias

import torch
from torch import Tensor

SurfaceKind: TypeAlias = Literal["coupled", "independent", "dual", "conventional"]


class Element(IntEnum):
    """The set that an element's pair of coefficients (phi_R, phi_T) lies in."""

    COUPLED = 0
    """|phi_R|^2 + |phi_T|^2 = 1 with phases pi/2 apart (paper eq. 1, 21)."""
    INDEPENDENT = 1
    """|phi_R|^2 + |phi_T|^2 = 1, any phases."""
    REFLECTING = 2
    """|phi_R| = 1, phi_T = 0."""
    TRANSMITTING = 3
    """|phi_T| = 1, phi_R = 0."""


def elements_of(kind: SurfaceKind, elements: int) -> Tensor:
    """What each of N elements can do, int64 [N].

    `coupled` and `independent`: a STAR-RIS of such elements; `dual`: elements in turn reflect and transmit;
    `conventional`: all reflect.
    """
    if kind == "dual":
        return torch.where(torch.arange(elements) % 2 == 0, Element.REFLECTING, Element.TRANSMITTING)
    whole = {"coupled": Element.COUPLED, "independent": Element.INDEPENDENT, "conventional": Element.REFLECTING}
    return torch.full((elements,), whole[kind])
