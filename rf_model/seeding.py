"""Independent random streams that follow from whole numbers, as a seed and a slot."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import torch


def seed_of(*numbers: int) -> int:
    """A seed of 64 bits from numbers >= 0 (NumPy's `SeedSequence`); other numbers give an unrelated one."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0])


def generator_of(*numbers: int) -> "torch.Generator":
    """A generator on the CPU, seeded by 63 of those bits."""
    import torch  # who only reads a mission, as each bridge, is spared it

    return torch.Generator().manual_seed(seed_of(*numbers) >> 1)


def vehicle_seeds(seed: int, vehicles: Sequence[str]) -> dict[str, int]:
    """A seed for each vehicle: the first has `seed` itself, every other one that follows from `seed` and its name."""
    seeds = {name: seed_of(seed, *name.encode()) >> 1 for name in vehicles}
    return seeds | {vehicles[0]: seed}
