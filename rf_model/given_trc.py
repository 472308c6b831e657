"""Coefficients as somebody writes them down, in any of three forms, to those of the scenario's surface."""

import math
from typing import Annotated

import torch
from pydantic import Field, Strict
from torch import Tensor

from rf_model.complex_pairs import Row
from rf_model.scenario import Scenario, StrictModel
from rf_model.star_ris import Coefficients, IndependentTrc, Trc, TrcError
from rf_model.surfaces import read_coefficients, surface_of

TOLERANCE = 1e-4
"""Of |beta_R|^2 + |beta_T|^2 = 1 and of phases pi/2 apart [rad]: four decimals do, and are then put right."""
NOTHING = 1e-9
"""Amplitudes below this have no phase."""

ANGLES: dict[str, tuple[str, ...]] = {
    "coupled": ("theta_reflection", "split_angle", "sign"),
    "independent": ("theta_reflection", "split_angle", "theta_transmission"),
    "dual": ("theta_reflection",),
    "conventional": ("theta_reflection",),
}
"""What an `Action` must say of each surface."""
ACTION_FIELDS = {"theta_reflection", "split_angle", "sign", "theta_transmission"}
AMPLITUDES = ("theta_reflection", "theta_transmission", "beta_reflection", "beta_transmission")
DIAGONALS = ("reflection", "transmission")

Angle = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)]
Angles = Annotated[tuple[Angle, ...], Strict(False)]
Amplitudes = Annotated[tuple[Annotated[float, Field(ge=0, le=2)], ...], Strict(False)]


class GivenTrc(StrictModel):
    """Coefficients of N elements in one of three forms.

    As an `Action` has them: `theta_reflection`, `split_angle` and `sign` for a coupled surface; `theta_reflection`,
    `split_angle` and `theta_transmission` for an independent one; `theta_reflection` for all others. As a
    `RisConfiguration`: `theta_*` and `beta_*`. Or the diagonals of Phi_R and Phi_T: `reflection` and `transmission`.
    """

    theta_reflection: Angles | None = None
    theta_transmission: Angles | None = None
    split_angle: Angles | None = None
    sign: Annotated[tuple[Annotated[int, Field(ge=-1, le=1)], ...], Strict(False)] | None = None
    beta_reflection: Amplitudes | None = None
    beta_transmission: Amplitudes | None = None
    reflection: Row | None = None
    transmission: Row | None = None


def read_given(scenario: Scenario, given: GivenTrc) -> Coefficients:
    """The coefficients, checked against the scenario's surface. Raises TrcError, whose text begins with `trc`."""
    lists = {name: getattr(given, name) for name in GivenTrc.model_fields}
    # An `Action` for any surface but the independent one has an empty theta_transmission.
    by_element = {name: torch.tensor(values, dtype=torch.float64) for name, values in lists.items() if values}
    names = set(by_element)
    for name, values in by_element.items():
        if len(values) != scenario.elements:
            raise TrcError(f"trc.{name}: {len(values)} values, must be {scenario.elements}, one for each element")
    if names == set(AMPLITUDES):
        return _from_amplitudes(scenario, **by_element)
    if names == set(DIAGONALS):
        return _from_diagonals(scenario, **by_element)
    try:
        if set(ANGLES[scenario.surface]) <= names <= ACTION_FIELDS:
            return _from_angles(scenario, **by_element)
    except TrcError as error:
        raise TrcError(f"trc.{error}") from error
    forms = "; or ".join(", ".join(form) for form in (ANGLES[scenario.surface], AMPLITUDES, DIAGONALS))
    raise TrcError(f"trc: {', '.join(sorted(names)) or 'nothing'} given; surface {scenario.surface} takes {forms}")


def _from_angles(scenario: Scenario, theta_reflection: Tensor, **others: Tensor) -> Coefficients:
    """As an action has them; what the surface leaves no choice of may be left out."""
    neutral = surface_of(scenario).neutral(torch.float64)
    return read_coefficients(
        scenario,
        theta_reflection,
        others.get("split_angle", neutral.split_angle),
        others.get("sign", neutral.sign),
        others.get("theta_transmission", torch.empty(0)),
    )


def _from_diagonals(scenario: Scenario, reflection: Tensor, transmission: Tensor) -> Coefficients:
    """Phi_R and Phi_T given as pairs of reals [N, 2]."""
    phi_r, phi_t = torch.view_as_complex(reflection), torch.view_as_complex(transmission)
    return _from_amplitudes(scenario, torch.angle(phi_r), torch.angle(phi_t), phi_r.abs(), phi_t.abs())


def _from_amplitudes(
    scenario: Scenario,
    theta_reflection: Tensor,
    theta_transmission: Tensor,
    beta_reflection: Tensor,
    beta_transmission: Tensor,
) -> Coefficients:
    energy = beta_reflection**2 + beta_transmission**2
    if (n := _first((energy - 1.0).abs() > TOLERANCE)) is not None:
        raise TrcError(f"trc: |beta_R|^2 + |beta_T|^2 = {energy[n]:g} at element {n}, must be 1")
    split = torch.atan2(beta_reflection, beta_transmission)
    if scenario.surface == "independent":
        trc: Coefficients = IndependentTrc(_wrapped(theta_reflection), split, _wrapped(theta_transmission))
    else:
        apart = _wrapped(theta_transmission - theta_reflection)
        both = (beta_reflection > NOTHING) & (beta_transmission > NOTHING)
        if (n := _first(both & ((apart.abs() - math.pi / 2).abs() > TOLERANCE))) is not None:
            raise TrcError(
                f"trc: theta_T - theta_R = {apart[n]:g} rad at element {n}, must be +-pi/2 on surface "
                f"{scenario.surface}"
            )
        sign = torch.where(both & (apart < 0), -1.0, 1.0).to(split)
        only_transmits = beta_reflection <= NOTHING
        theta = torch.where(only_transmits, theta_transmission - math.pi / 2, theta_reflection)
        trc = Trc(_wrapped(theta), split, sign)
    try:
        surface_of(scenario).check(trc)
    except TrcError as error:
        raise TrcError(f"trc: as angles, {error}") from error
    return trc


def _wrapped(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi]."""
    return torch.atan2(torch.sin(angle), torch.cos(angle))


def _first(wrong: Tensor) -> int | None:
    """Index of the first True."""
    return int(wrong.nonzero()[0, 0]) if wrong.any() else None
