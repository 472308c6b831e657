"""Fairness of rates [bit/s] over users, tensors [..., J] -> [...]."""

import torch
from torch import Tensor

LOWEST_RATE_BPS = 1.0
"""Rates count as at least this in the harmonic mean, so that a silent user costs nearly all and divides by nothing."""


def fair_rate_bps(rate_bps: Tensor) -> Tensor:
    """HFI times the sum rate, which is J^2 / sum(1 / R): J times the harmonic mean [bit/s]."""
    users = rate_bps.shape[-1]
    return rate_bps.clamp_min(LOWEST_RATE_BPS).reciprocal().sum(-1).reciprocal() * users**2


def hfi(rate_bps: Tensor) -> Tensor:
    """Harmonic fairness index (paper, eq. of HFI): harmonic over arithmetic mean, in [0, 1].

    0 when all users together have no more than J bit/s: the limit of a starved user is 0, and nothing jumps.
    """
    total = rate_bps.sum(-1)
    users = rate_bps.shape[-1]
    index = (fair_rate_bps(rate_bps) / total.clamp_min(users * LOWEST_RATE_BPS)).clamp_max(1.0)
    return torch.where(total > users * LOWEST_RATE_BPS, index, 0.0)


def jfi(rate_bps: Tensor) -> Tensor:
    """Jain's fairness index (sum R)^2 / (J sum R^2), in [1/J, 1]; 0 when nobody has a rate."""
    peak = rate_bps.amax(-1, keepdim=True)
    relative = rate_bps / torch.where(peak > 0, peak, 1.0)  # squares of bit/s would leave float32's exact range
    squares = (relative * relative).sum(-1)
    return relative.sum(-1) ** 2 / (rate_bps.shape[-1] * torch.where(squares > 0, squares, 1.0))
