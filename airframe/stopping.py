"""Stopping under a limited deceleration, in plain arithmetic (floats, tensors, numba)."""

from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from torch import Tensor

Real = TypeVar("Real", float, "Tensor")


def stop_distance(speed: Real, deceleration: float, reaction_s: float = 0.0) -> Real:
    """Distance [m] covered from `speed` [m/s] when braking at `deceleration` [m/s2] begins after `reaction_s`."""
    return speed * reaction_s + speed * speed / (2 * deceleration)
