"""The model-based reference: surface coefficients and beamforming of a slot whose channels are known."""

import math
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rf_model.channels import Channels
from rf_model.fairness import LOWEST_RATE_BPS
from rf_model.link import check_beamforming
from rf_model.reference.elements import Element, elements_of
from rf_model.scenario import Scenario
from rf_model.star_ris import Coefficients, IndependentTrc, Trc

Objective: TypeAlias = Literal["harmonic", "sum_rate"]
OBJECTIVES: tuple[Objective, ...] = ("harmonic", "sum_rate")


class ReferenceInputError(ValueError):
    """Something the reference cannot optimise; the text names it."""


@dataclass(frozen=True)
class Solution:
    """A surface and beams, with the channels' leading batch dimensions `...`, device and precision."""

    reflection: Tensor
    """Diagonal of Phi_R, complex [..., N]."""
    transmission: Tensor
    """Diagonal of Phi_T, complex [..., N]."""
    beamforming: Tensor
    """W, complex [..., M, J] sqrt(W)."""
    utility_bps: Tensor
    """The objective at the start and after each iteration, float64 [..., iterations + 1]: it never falls."""
    free_phases: bool
    """Some element's phases are independent."""

    @property
    def trc(self) -> Coefficients:
        """The coefficients as angles: `Trc`, or `IndependentTrc` where phases are free."""
        split = torch.atan2(self.reflection.abs(), self.transmission.abs())
        if self.free_phases:
            return IndependentTrc(torch.angle(self.reflection), split, torch.angle(self.transmission))
        beside = self.transmission * self.reflection.conj()
        sign = torch.where(beside.imag >= 0, 1.0, -1.0).to(beside.real.dtype)
        from_transmission = self.transmission * torch.complex(torch.zeros_like(sign), -sign)
        larger = torch.where(self.reflection.abs() >= self.transmission.abs(), self.reflection, from_transmission)
        return Trc(torch.angle(larger), split, sign)


def closed_form(scenario: Scenario, channels: Channels) -> Solution:
    """Regularised zero forcing with coefficients that align the strongest mode of H with each side's users.

    Arguments and errors are those of `solve`; `utility_bps` [..., 1] is harmonic.
    """
    return _solve(scenario, channels, -1, "harmonic", None, None)


def solve(
    scenario: Scenario,
    channels: Channels,
    iterations: int,
    objective: Objective = "harmonic",
    *,
    coefficients: tuple[Tensor, Tensor] | None = None,
    beamforming: Tensor | None = None,
) -> Solution:
    """Maximise the fair rate J^2 / sum(1 / R) (`harmonic`) or the sum rate over coefficients and beamforming.

    A strong local optimiser, nothing more: what it reaches is a reference for comparison. It takes SINR by powers
    (`sinr: power`) and, of the scenario, the surface, power limit, noise and bandwidth; sizes come from the channels,
    which may also hold NumPy arrays. Phases are continuous whatever `phase_bits`; `quantised` rounds a solution.

    The search starts at the closed form, or at `coefficients` (phi_R, phi_T), complex [..., N], moved to the nearest
    that the surface can do; with those, `beamforming` [..., M, J] may be given too and is where the beams start.

    One row is solved on the calling thread without the interpreter lock, more by numba's threads; no row depends on
    another. Raises ReferenceInputError, and BeamformingError for beams that break the power limit.
    """
    if iterations < 0:
        raise ReferenceInputError(f"iterations: {iterations} is not allowed: must be 0 or more")
    return _solve(scenario, channels, iterations, objective, coefficients, beamforming)


def quantised(
    scenario: Scenario, channels: Channels, solution: Solution, objective: Objective = "harmonic"
) -> Solution:
    """A solution for the scenario's surface with phases rounded to its `phase_bits`, and beams made anew for them.

    `utility_bps` [..., 1] is what is left. With continuous phases, the solution itself. Arguments as for `solve`.
    """
    if scenario.phase_bits is None:
        return solution
    step = 2 * math.pi / 2**scenario.phase_bits
    trc = solution.trc
    rounded = replace(trc, theta_reflection=torch.round(trc.theta_reflection / step) * step)
    if isinstance(rounded, IndependentTrc):
        rounded = replace(rounded, theta_transmission=torch.round(rounded.theta_transmission / step) * step)
    return _solve(scenario, channels, 0, objective, rounded.coefficients(), None)


def _solve(
    scenario: Scenario,
    channels: Channels,
    iterations: int,
    objective: Objective,
    coefficients: tuple[Tensor, Tensor] | None,
    beamforming: Tensor | None,
) -> Solution:
    from rf_model.reference import kernel  # numba is slow to import

    if scenario.sinr != "power":
        raise ReferenceInputError(f"sinr: {scenario.sinr!r} is not allowed: the reference takes powers only")
    if objective not in OBJECTIVES:
        raise ReferenceInputError(f"objective: {objective!r} is not one of {', '.join(OBJECTIVES)}")
    if beamforming is not None and coefficients is None:
        raise ReferenceInputError("beamforming: given without coefficients to start from")

    direct, bs_ris, ris_user, transmission = _require_channels(channels)
    batch_shape, (J, M), N = direct.shape[:-2], direct.shape[-2:], bs_ris.shape[-2]
    scale = math.sqrt(scenario.p_max_w / scenario.noise_w)
    h_b, h_s = _rows(direct, J, M) * scale, _rows(ris_user, J, N)
    H = np.ascontiguousarray(_rows(bs_ris, N, M).transpose(0, 2, 1)) * scale
    for name, link in (("direct", h_b), ("bs_ris", H), ("ris_user", h_s)):
        if not np.isfinite(link).all():
            raise ReferenceInputError(f"{name}: not finite")
    rows = len(h_b)
    side = transmission.reshape(rows, J).cpu().numpy().astype(np.int64)
    element = elements_of(scenario.surface, N).numpy()

    phi, beams = np.zeros((rows, 2, N), np.complex128), np.zeros((rows, J, M), np.complex128)
    start = kernel.FROM_CLOSED_FORM
    if coefficients is not None:
        start = kernel.FROM_COEFFICIENTS
        for place, given in enumerate(coefficients):
            if given.shape != (*batch_shape, N):
                raise ReferenceInputError(f"coefficients: shape {list(given.shape)}, must be {[*batch_shape, N]}")
            phi[:, place] = _rows(given, N)
        if not np.isfinite(phi).all():
            raise ReferenceInputError("coefficients: not finite")
    if beamforming is not None:
        check_beamforming(beamforming, scenario)
        start = kernel.FROM_BOTH
        beams[:] = _rows(beamforming.expand(*batch_shape, M, J), M, J).transpose(0, 2, 1) / math.sqrt(scenario.p_max_w)

    bandwidth = scenario.bandwidth_hz / math.log(2.0)
    goal = (scenario.p_max == "per_user", objective == "harmonic", LOWEST_RATE_BPS / bandwidth)
    history = np.zeros((rows, max(iterations, 0) + 1))
    if rows == 1:
        slot = kernel.Slot(h_b[0], H[0], h_s[0], side[0], element, *goal)
        kernel.solve_slot(slot, iterations, start, phi[0], beams[0], history[0])
    elif rows:
        kernel.solve_slots(h_b, H, h_s, side, element, *goal, iterations, start, phi, beams, history)

    W = beams.transpose(0, 2, 1) * math.sqrt(scenario.p_max_w)

    def result(array: NDArray[np.complex128], *shape: int) -> Tensor:
        return torch.from_numpy(array).reshape(*batch_shape, *shape).to(direct.device, direct.dtype)

    return Solution(
        reflection=result(phi[:, kernel.REFLECTION], N),
        transmission=result(phi[:, kernel.TRANSMISSION], N),
        beamforming=result(W, M, J),
        utility_bps=torch.from_numpy(history * bandwidth).reshape(*batch_shape, history.shape[-1]).to(direct.device),
        free_phases=bool((element == Element.INDEPENDENT).any()),
    )


def _require_channels(channels: Channels) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The fields as tensors. Raises ReferenceInputError unless their shapes agree."""
    direct, bs_ris, ris_user, transmission = (
        torch.as_tensor(field) for field in (channels.direct, channels.bs_ris, channels.ris_user, channels.transmission)
    )
    *batch, J, M = direct.shape
    N = bs_ris.shape[-2]
    shapes = {
        "direct": (direct, [*batch, J, M]),
        "bs_ris": (bs_ris, [*batch, N, M]),
        "ris_user": (ris_user, [*batch, J, N]),
        "transmission": (transmission, [*batch, J]),
    }
    for name, (field, shape) in shapes.items():
        if list(field.shape) != shape:
            raise ReferenceInputError(f"{name}: shape {list(field.shape)}, must be {shape}")
    if 0 in (J, M, N):
        raise ReferenceInputError(f"channels: {J} users, {M} antennas, {N} elements; each must be 1 or more")
    return direct, bs_ris, ris_user, transmission


def _rows(values: Tensor, *shape: int) -> NDArray[np.complex128]:
    """A tensor [..., *shape] as a contiguous complex128 array [rows, *shape]."""
    return np.ascontiguousarray(
        values.detach().reshape(math.prod(values.shape[: -len(shape)]), *shape).cpu().numpy(), dtype=np.complex128
    )
