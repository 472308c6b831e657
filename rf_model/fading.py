"""Small-scale fading: unit-power scattering and its mix with a line-of-sight part (paper eq. 3)."""

import torch
from torch import Tensor

COMPLEX_OF = {torch.float32: torch.complex64, torch.float64: torch.complex128}


def rayleigh(shape: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype) -> Tensor:
    """CN(0, 1) of a shape; `dtype` is the real type (float32 or float64), the device the generator's."""
    return torch.randn(shape, generator=generator, dtype=COMPLEX_OF[dtype], device=generator.device)


def rician_weights(kappa: float) -> tuple[float, float]:
    """Amplitudes of the line-of-sight and of the scattered part: sqrt(k / (k + 1)), sqrt(1 / (k + 1))."""
    return (kappa / (kappa + 1.0)) ** 0.5, (1.0 / (kappa + 1.0)) ** 0.5
