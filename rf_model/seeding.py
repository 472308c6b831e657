"""Independent random streams that follow from whole numbers, as a seed and a slot."""

import numpy as np
import torch


def seed_of(*numbers: int) -> int:
    """A seed of 64 bits from numbers >= 0 (NumPy's `SeedSequence`); other numbers give an unrelated one."""
    return int(np.random.SeedSequence(numbers).generate_state(1, np.uint64)[0])


def generator_of(*numbers: int) -> torch.Generator:
    """A generator on the CPU, seeded by 63 of those bits."""
    return torch.Generator().manual_seed(seed_of(*numbers) >> 1)
