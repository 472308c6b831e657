"""Transmission and reflection coefficients (TRC) of an energy-splitting STAR-RIS (paper eq. 1, 2, 21)."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

ANGLE_TOLERANCE_RAD = 1e-6
"""Float32 rounds pi up; nothing finer than this is told apart at the limits."""


class TrcError(ValueError):
    """Coefficients that the surface cannot have; the text names the field."""


@dataclass(frozen=True)
class _EnergySplitting:
    """What every splitting element has, whatever couples its phases: each field is [..., N]."""

    theta_reflection: Tensor
    """[rad]"""
    split_angle: Tensor
    """x [rad] in [0, pi/2]: beta_R = sin x, beta_T = cos x, so that no element gives energy away."""

    @property
    def beta_reflection(self) -> Tensor:
        """Amplitude on the reflection side, sin x."""
        return torch.sin(self.split_angle)

    @property
    def beta_transmission(self) -> Tensor:
        """Amplitude on the transmission side, cos x."""
        return torch.cos(self.split_angle)


@dataclass(frozen=True)
class Trc(_EnergySplitting):
    """Coupled coefficients of N elements, feasible for any angles: each field is [..., N]."""

    sign: Tensor
    """-1 or +1: theta_T = theta_R + sign pi/2."""

    @property
    def theta_transmission(self) -> Tensor:
        """theta_T [rad] in [-pi, pi) (eq. 1, 32)."""
        turned = self.theta_reflection + self.sign * (math.pi / 2) + math.pi
        wrapped = torch.remainder(turned, 2 * math.pi) - math.pi
        return torch.where(wrapped >= math.pi, wrapped - 2 * math.pi, wrapped)

    def coefficients(self) -> tuple[Tensor, Tensor]:
        """Diagonals of Phi_R and Phi_T (eq. 2), complex [..., N]."""
        cosine, sine = torch.cos(self.theta_reflection), torch.sin(self.theta_reflection)
        reflected, transmitted = self.beta_reflection, self.sign * self.beta_transmission
        return (
            torch.complex(cosine * reflected, sine * reflected),
            torch.complex(-sine * transmitted, cosine * transmitted),  # j sign e^{j theta_R}
        )


@dataclass(frozen=True)
class IndependentTrc(_EnergySplitting):
    """Coefficients of N elements whose phases are free on each side: each field is [..., N]."""

    theta_transmission: Tensor
    """[rad]"""

    @property
    def sign(self) -> Tensor:
        """+1 everywhere: it means nothing here, and messages have a place for it."""
        return torch.ones_like(self.theta_reflection)

    def coefficients(self) -> tuple[Tensor, Tensor]:
        """Diagonals of Phi_R and Phi_T (eq. 2), complex [..., N]."""
        reflected, transmitted = self.beta_reflection, self.beta_transmission
        return (
            torch.complex(torch.cos(self.theta_reflection) * reflected, torch.sin(self.theta_reflection) * reflected),
            torch.complex(
                torch.cos(self.theta_transmission) * transmitted, torch.sin(self.theta_transmission) * transmitted
            ),
        )


Coefficients = Trc | IndependentTrc
"""What any surface can be set to: both have theta_*, beta_*, split_angle, sign and coefficients()."""


def neutral_trc(elements: int, dtype: torch.dtype) -> Trc:
    """All phases zero, energy split evenly, signs +1: what a surface shows before anyone configured it."""
    return Trc(
        theta_reflection=torch.zeros(elements, dtype=dtype),
        split_angle=torch.full((elements,), math.pi / 4, dtype=dtype),
        sign=torch.ones(elements, dtype=dtype),
    )


def check_trc(trc: Coefficients, elements: int) -> None:
    """Raise TrcError unless every field is [..., N], finite and within its range (eq. 21b to 21f)."""
    phases = ("theta_reflection",) if isinstance(trc, Trc) else ("theta_reflection", "theta_transmission")
    for name in (*phases, "split_angle", "sign"):
        values: Tensor = getattr(trc, name)
        if values.shape[-1:] != (elements,):
            raise TrcError(f"{name}: shape {list(values.shape)}, the surface has {elements} elements")
        if not torch.isfinite(values).all():
            raise TrcError(f"{name}: not finite")
    for name in phases:
        _require_between(name, getattr(trc, name), -math.pi, math.pi, "[-pi, pi]")
    _require_between("split_angle", trc.split_angle, 0.0, math.pi / 2, "[0, pi/2]")
    if not (trc.sign.abs() == 1).all():
        raise TrcError("sign: must be -1 or 1")


def _require_between(name: str, values: Tensor, low: float, high: float, allowed: str) -> None:
    outside = (values < low - ANGLE_TOLERANCE_RAD) | (values > high + ANGLE_TOLERANCE_RAD)
    if outside.any():
        raise TrcError(f"{name}: {values[outside][0].item():g} is outside {allowed}")
