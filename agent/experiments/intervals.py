"""95 % intervals of means over independent worlds (normal approximation)."""

import math
from typing import NamedTuple

from torch import Tensor

Z_95 = 1.96


class Interval(NamedTuple):
    """A value and half the width of its 95 % interval."""

    value: float
    half_width: float


def mean_interval(samples: Tensor) -> Interval:
    """Mean of samples [n], n at least 2."""
    return Interval(samples.mean().item(), Z_95 * samples.std().item() / math.sqrt(len(samples)))


def ratio_interval(above: Tensor, below: Tensor) -> Interval:
    """Ratio of the means of paired samples [n], n at least 2 (delta method)."""
    ratio = above.mean().item() / below.mean().item()
    return Interval(ratio, mean_interval((above - ratio * below) / below.mean()).half_width)
