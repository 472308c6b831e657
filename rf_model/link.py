"""From channels, coefficients and beamforming to SINR and rates (paper eq. 12-14)."""

import math
from functools import lru_cache
from typing import Literal

import torch
from torch import Tensor

from rf_model.channels import Channels
from rf_model.scenario import Scenario
from rf_model.star_ris import Coefficients

POWER_TOLERANCE = 1e-6
"""Relative slack at the power limit, for beams computed in float32."""


class BeamformingError(ValueError):
    """A beamforming matrix that the base station cannot send; the text names what is wrong."""


def effective_channel(channels: Channels, trc: Coefficients) -> Tensor:
    """g_j = h_b^T + h_s^T Phi_c H, no conjugate (eq. 12), [..., J, M]; c is the user's side of the panel."""
    reflection, transmission = trc.coefficients()
    phi = torch.where(channels.transmission.unsqueeze(-1), transmission.unsqueeze(-2), reflection.unsqueeze(-2))
    return channels.direct + (channels.ris_user * phi) @ channels.bs_ris


def sinr(received: Tensor, noise_w: float, reading: Literal["power", "amplitude"] = "power") -> Tensor:
    """SINR [..., J] from received amplitudes [..., J, J], user j's of stream k at (j, k).

    `power`: powers of the other streams added; `amplitude`: eq. 13 as printed, |own| / (|sum of others| + sigma^2).
    """
    others = _others(received.shape[-1], received.real.dtype, received.device)
    if reading == "power":
        power = _squared(received)
        return power.diagonal(dim1=-2, dim2=-1) / ((power * others).sum(-1) + noise_w)
    return received.diagonal(dim1=-2, dim2=-1).abs() / ((received * others).sum(-1).abs() + noise_w)


def rate_bps(sinr: Tensor, bandwidth_hz: float) -> Tensor:
    """R = B log2(1 + SINR) (eq. 14)."""
    return torch.log1p(sinr) * (bandwidth_hz / math.log(2.0))


def identity_beamforming(scenario: Scenario, dtype: torch.dtype) -> Tensor:
    """Equal power on one antenna for each user (antennas repeat when J > M), complex [M, J] [sqrt(W)]."""
    antennas = torch.arange(scenario.users) % scenario.antennas
    beams = torch.nn.functional.one_hot(antennas, scenario.antennas).T
    return (beams * math.sqrt(scenario.p_max_w / scenario.users)).to(dtype)


def check_beamforming(beamforming: Tensor, scenario: Scenario) -> None:
    """Raise BeamformingError unless W is [..., M, J], finite and within the power limit (eq. 21g)."""
    shape = (scenario.antennas, scenario.users)
    if beamforming.shape[-2:] != shape:
        raise BeamformingError(f"beamforming: shape {list(beamforming.shape)}, must be M x J = {shape[0]} x {shape[1]}")
    if not torch.isfinite(torch.view_as_real(beamforming)).all():
        raise BeamformingError("beamforming: not finite")
    powers = _squared(beamforming).sum(-2)
    per = "in all"
    if scenario.p_max == "total":
        powers = powers.sum(-1)
    else:
        per = "for a user"
    highest = powers.max().item()
    if highest > scenario.p_max_w * (1.0 + POWER_TOLERANCE):
        raise BeamformingError(f"beamforming: {highest:g} W {per} is above p_max ({scenario.p_max_w:g} W)")


@lru_cache(maxsize=16)
def _others(users: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """[J, J]: 1 for the streams of other users, 0 for the own, kept because every slot asks for it."""
    with torch.inference_mode(False):  # what is kept may be needed for gradients later
        return 1.0 - torch.eye(users, dtype=dtype, device=device)


def _squared(values: Tensor) -> Tensor:
    return torch.view_as_real(values).square().sum(-1)
