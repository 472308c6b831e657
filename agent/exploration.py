"""Exploration: Ornstein-Uhlenbeck noise on the continuous half (paper eq. 29), epsilon-greedy signs (eq. 31)."""

import math

import torch
from torch import Tensor


def decayed(start: float, end: float, progress: float, fraction: float) -> float:
    """Linear from `start` to `end` over the first `fraction` of the run (`progress` runs from 0 to 1)."""
    return start + (end - start) * min(1.0, progress / fraction)


class OrnsteinUhlenbeck:
    """Unit-variance OU noise, one process per environment and action dimension: N_OU(0, sigma^2) of eq. 29 over sigma.

    x <- (1 - theta) x + sqrt(1 - (1 - theta)^2) n keeps the variance at exactly 1, so the noise scale is the standard
    deviation of what is added, whatever theta is.
    """

    def __init__(self, shape: tuple[int, int], theta: float) -> None:
        self.keep = 1 - theta
        self.value = torch.zeros(shape)

    def step(self, generator: torch.Generator) -> Tensor:
        """The next noise [B, A]."""
        fresh = torch.randn(self.value.shape, generator=generator)
        self.value = self.keep * self.value + math.sqrt(1 - self.keep**2) * fresh
        return self.value


def epsilon_greedy(signs: Tensor, epsilon: float, generator: torch.Generator) -> Tensor:
    """Signs [B, N], each replaced by a random one with probability `epsilon`."""
    random_signs = torch.randint(2, signs.shape, generator=generator) * 2.0 - 1.0
    return torch.where(torch.rand(signs.shape, generator=generator) < epsilon, random_signs, signs)


def random_actions(shape: tuple[int, int], continuous: int, generator: torch.Generator) -> Tensor:
    """Whole raw actions [B, A] for the warm-up: uniform in [-1, 1], then signs."""
    action = torch.rand(shape, generator=generator) * 2 - 1
    action[:, continuous:] = torch.where(action[:, continuous:] > 0, 1.0, -1.0)
    return action
