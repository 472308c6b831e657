"""The surfaces that can be carried: what each is told by numbers in [-1, 1], and which coefficients it can have.

| surface | continuous numbers an element | signs an element | coefficients |
| --- | --- | --- | --- |
| `Coupled` | theta_R, split | theta_T - theta_R = +-pi/2 | energy split between both sides |
| `Independent` | theta_R, split, theta_T | none | energy split, phases free |
| `Dual` | theta | none | elements in turn only reflect (even n) and only transmit |
| `Conventional` | theta | none | only reflection |

`Dual` and `Conventional` are coupled surfaces with a fixed split and sign +1. With `phase_bits` the phases are
multiples of 2 pi / 2^bits (theta_T of a coupled element a quarter turn from one). No surface gives energy away.
"""

import math
from collections.abc import Callable, Mapping
from functools import lru_cache
from types import MappingProxyType
from typing import Protocol

import torch
from torch import Tensor

from rf_model.scenario import Scenario
from rf_model.star_ris import (
    ANGLE_TOLERANCE_RAD,
    Coefficients,
    IndependentTrc,
    Trc,
    TrcError,
    check_trc,
    neutral_trc,
)


class Surface(Protocol):
    """A surface of N elements."""

    continuous: int
    """Numbers for each element."""
    signs: int
    """Binary choices for each element."""

    def decode(self, continuous: Tensor, signs: Tensor) -> Coefficients:
        """Coefficients [..., N] from [..., continuous * N] and [..., signs * N], each quantity's N numbers in a row.

        Continuous numbers are clipped to [-1, 1]; a sign is + where its number is positive. What comes out is feasible
        for any finite numbers. Differentiable except in the signs; through a quantised phase as if it were not.
        """

    def encode(self, trc: Coefficients) -> tuple[Tensor, Tensor]:
        """Numbers [..., continuous * N] and [..., signs * N] of which `decode` makes these coefficients [..., N]."""

    def neutral(self, dtype: torch.dtype) -> Coefficients:
        """What the surface shows before anyone configured it [N]: phases zero, energy split evenly where it can."""

    def check(self, trc: Coefficients) -> None:
        """Raise TrcError unless the surface can have these coefficients [..., N]; the text names the field."""


def surface_of(scenario: Scenario) -> Surface:
    """The scenario's surface."""
    return _surface(scenario.surface, scenario.elements, scenario.phase_bits)


def read_coefficients(
    scenario: Scenario, theta_reflection: Tensor, split_angle: Tensor, sign: Tensor, theta_transmission: Tensor
) -> Coefficients:
    """Coefficients from the fields of a message, checked against the scenario's surface. Raises TrcError.

    `theta_transmission` [N] for the independent surface, empty for all others, whose follows from the rest.
    """
    if scenario.surface == "independent":
        trc: Coefficients = IndependentTrc(theta_reflection, split_angle, theta_transmission)
    elif theta_transmission.numel():
        raise TrcError(f"theta_transmission: must be empty, surface {scenario.surface} has no free one")
    else:
        trc = Trc(theta_reflection, split_angle, sign)
    surface_of(scenario).check(trc)
    return trc


class Coupled:
    """An energy-splitting STAR-RIS with coupled phases (paper eq. 1, 2)."""

    continuous = 2
    signs = 1

    def __init__(self, elements: int, phase_bits: int | None) -> None:
        self._elements = elements
        self._bits = phase_bits

    def decode(self, continuous: Tensor, signs: Tensor) -> Trc:
        theta, split = torch.split(continuous.clip(-1, 1), self._elements, dim=-1)
        return Trc(_phase(theta, self._bits), _split(split), torch.where(signs > 0, 1.0, -1.0))

    def encode(self, trc: Coefficients) -> tuple[Tensor, Tensor]:
        return torch.cat((_of_phase(trc.theta_reflection), _of_split(trc.split_angle)), dim=-1), trc.sign

    def neutral(self, dtype: torch.dtype) -> Trc:
        return neutral_trc(self._elements, dtype)

    def check(self, trc: Coefficients) -> None:
        check_trc(trc, self._elements)
        _require_grid("theta_reflection", trc.theta_reflection, self._bits)


class Independent:
    """An energy-splitting STAR-RIS whose phases are free on each side: what coupling costs is measured against it."""

    continuous = 3
    signs = 0

    def __init__(self, elements: int, phase_bits: int | None) -> None:
        self._elements = elements
        self._bits = phase_bits

    def decode(self, continuous: Tensor, signs: Tensor) -> IndependentTrc:
        reflection, split, transmission = torch.split(continuous.clip(-1, 1), self._elements, dim=-1)
        return IndependentTrc(_phase(reflection, self._bits), _split(split), _phase(transmission, self._bits))

    def encode(self, trc: Coefficients) -> tuple[Tensor, Tensor]:
        phases = _of_phase(trc.theta_reflection), _of_phase(trc.theta_transmission)
        return torch.cat((phases[0], _of_split(trc.split_angle), phases[1]), dim=-1), trc.sign[..., :0]

    def neutral(self, dtype: torch.dtype) -> IndependentTrc:
        zeros = torch.zeros(self._elements, dtype=dtype)
        return IndependentTrc(zeros, zeros + math.pi / 4, zeros)

    def check(self, trc: Coefficients) -> None:
        check_trc(trc, self._elements)
        _require_grid("theta_reflection", trc.theta_reflection, self._bits)
        _require_grid("theta_transmission", trc.theta_transmission, self._bits)


class _FixedSplit:
    """Elements that each serve one side only; only their phases are free."""

    continuous = 1
    signs = 0

    def __init__(self, elements: int, phase_bits: int | None, every: int) -> None:
        self._elements = elements
        self._bits = phase_bits
        self._split_angle = torch.zeros(elements, dtype=torch.float64)
        self._split_angle[::every] = math.pi / 2

    def decode(self, continuous: Tensor, signs: Tensor) -> Trc:
        theta = _phase(continuous.clip(-1, 1), self._bits)
        split = (self._split_angle * _below(theta.dtype)).to(theta)
        return Trc(theta, split.expand_as(theta), torch.ones_like(theta))

    def encode(self, trc: Coefficients) -> tuple[Tensor, Tensor]:
        return _of_phase(trc.theta_reflection), trc.sign[..., :0]

    def neutral(self, dtype: torch.dtype) -> Trc:
        zeros = torch.zeros(self._elements, dtype=dtype)
        return Trc(zeros, self._split_angle.to(dtype), zeros + 1)

    def check(self, trc: Coefficients) -> None:
        check_trc(trc, self._elements)
        _require_grid("theta_reflection", trc.theta_reflection, self._bits)
        wrong = (trc.split_angle - self._split_angle).abs() > ANGLE_TOLERANCE_RAD
        if wrong.any():
            n = int(wrong.nonzero()[0, -1])
            raise TrcError(
                f"split_angle: {trc.split_angle[wrong][0].item():g} of element {n}, "
                f"which has {self._split_angle[n].item():g} fixed"
            )
        if not (trc.sign == 1).all():
            raise TrcError("sign: must be 1, elements that serve one side have none")


class Dual(_FixedSplit):
    """A reflecting and a transmitting surface that share the panel, element by element in turn (mode switching)."""

    def __init__(self, elements: int, phase_bits: int | None) -> None:
        super().__init__(elements, phase_bits, every=2)


class Conventional(_FixedSplit):
    """A surface that only reflects."""

    def __init__(self, elements: int, phase_bits: int | None) -> None:
        super().__init__(elements, phase_bits, every=1)


_SURFACES: Mapping[str, Callable[[int, int | None], Surface]] = MappingProxyType(
    {"coupled": Coupled, "independent": Independent, "dual": Dual, "conventional": Conventional}
)


@lru_cache(maxsize=64)
def _surface(kind: str, elements: int, phase_bits: int | None) -> Surface:
    with torch.inference_mode(False):  # what is kept may be needed for gradients later
        return _SURFACES[kind](elements, phase_bits)


def _below(dtype: torch.dtype) -> float:
    """Just below 1, so that limits hold exactly also when the result is read in double precision."""
    return 1.0 - 2.0 * torch.finfo(dtype).eps


def _phase(number: Tensor, bits: int | None) -> Tensor:
    """[-1, 1] to [-pi, pi], or to the nearest of 2^bits phases; those even over the circle."""
    below = _below(number.dtype)
    if bits is None:
        return number * (math.pi * below)
    half = 1 << (bits - 1)
    steps = torch.round(number * half)
    nearest = torch.where(steps == half, -half, steps) * (math.pi * below / half)
    if not number.requires_grad:
        return nearest
    free = number * math.pi
    return free + (nearest - free).detach()


def _split(number: Tensor) -> Tensor:
    """[-1, 1] to [0, pi/2]."""
    return (number + 1) * (math.pi / 4 * _below(number.dtype))


def _of_phase(theta: Tensor) -> Tensor:
    """`_phase` undone."""
    return (theta / math.pi).clip(-1, 1)


def _of_split(angle: Tensor) -> Tensor:
    """`_split` undone."""
    return (angle * (4 / math.pi) - 1).clip(-1, 1)


def _require_grid(name: str, theta: Tensor, bits: int | None) -> None:
    if bits is None:
        return
    step = 2 * math.pi / 2**bits
    off = (theta / step - torch.round(theta / step)).abs() * step > 2 * ANGLE_TOLERANCE_RAD
    if off.any():
        raise TrcError(f"{name}: {theta[off][0].item():g} is not one of the {2**bits} phases of {bits} bits")
