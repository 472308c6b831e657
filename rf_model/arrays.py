"""Array responses [..., M] and [..., N]: unit-modulus phases relative to the first antenna or element."""

import math
from functools import lru_cache

import torch
from torch import Tensor


def line_response(sine: Tensor, antennas: int) -> Tensor:
    """Paper eq. 5 with half-wavelength spacing: e^{j pi m sin psi}, m = 0..M-1, from sin psi [...]."""
    return _phasor(sine.unsqueeze(-1) * _steps(antennas, math.pi, sine.dtype, sine.device))


def planar_response(column_cosine: Tensor, row_cosine: Tensor, rows: int, columns: int, spacing: float) -> Tensor:
    """Eq. 6 corrected: e^{j 2 pi spacing (col u + row w)} with row = n // columns, col = n % columns.

    `column_cosine` u and `row_cosine` w [...] are direction cosines in the panel's frame; `spacing` is in wavelengths.
    """
    steps = _steps(max(rows, columns), 2.0 * math.pi * spacing, column_cosine.dtype, column_cosine.device)
    along = _phasor(torch.stack((row_cosine, column_cosine), dim=-1).unsqueeze(-1) * steps)
    return (along[..., 0, :rows].unsqueeze(-1) * along[..., 1, :columns].unsqueeze(-2)).flatten(-2)


def literal_response(
    normal_cosine: Tensor, column_cosine: Tensor, row_cosine: Tensor, elements: int, columns: int, spacing: float
) -> Tensor:
    """Eq. 6 as printed, n = 1..N, except that its second exponent gets the j without which it is no phase.

    Phase 2 pi spacing (n - 1) (floor(n / Nx) sin theta sin phi + (n mod Nx) sin theta cos phi), with theta the azimuth
    from the panel's normal and phi the elevation. The factor n - 1 makes it quadratic in n.
    """
    horizontal = (normal_cosine * normal_cosine + column_cosine * column_cosine).sqrt()
    sin_azimuth = column_cosine / horizontal.clamp_min(1e-12)
    index = _steps(elements, 1.0, normal_cosine.dtype, normal_cosine.device) + 1
    row = torch.div(index, columns, rounding_mode="floor")
    steps = row * (sin_azimuth * row_cosine).unsqueeze(-1) + (index % columns) * (sin_azimuth * horizontal).unsqueeze(
        -1
    )
    return _phasor(2.0 * math.pi * spacing * (index - 1) * steps)


@lru_cache(maxsize=64)
def _steps(size: int, step: float, dtype: torch.dtype, device: torch.device) -> Tensor:
    """0, step, 2 step, ..., kept because every slot asks for the same few."""
    with torch.inference_mode(False):  # what is kept may be needed for gradients later
        return torch.arange(size, dtype=dtype, device=device) * step


def _phasor(phase: Tensor) -> Tensor:
    return torch.complex(torch.cos(phase), torch.sin(phase))
