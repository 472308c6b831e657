"""Array responses [..., M] and [..., N]: unit-modulus phases relative to the first antenna or element."""

import math

import torch
from torch import Tensor


def line_response(sine: Tensor, antennas: int) -> Tensor:
    """Paper eq. 5 with half-wavelength spacing: e^{j pi m sin psi}, m = 0..M-1, from sin psi [...]."""
    return _phasor(math.pi * sine.unsqueeze(-1) * _count(antennas, sine))


def planar_response(column_cosine: Tensor, row_cosine: Tensor, rows: int, columns: int, spacing: float) -> Tensor:
    """Eq. 6 corrected: e^{j 2 pi spacing (col u + row w)} with row = n // columns, col = n % columns.

    `column_cosine` u and `row_cosine` w [...] are direction cosines in the panel's frame; `spacing` is in wavelengths.
    """
    wavenumber = 2.0 * math.pi * spacing
    along_columns = _phasor(wavenumber * column_cosine.unsqueeze(-1) * _count(columns, column_cosine))
    along_rows = _phasor(wavenumber * row_cosine.unsqueeze(-1) * _count(rows, row_cosine))
    return (along_rows.unsqueeze(-1) * along_columns.unsqueeze(-2)).flatten(-2)


def literal_response(
    normal_cosine: Tensor, column_cosine: Tensor, row_cosine: Tensor, elements: int, columns: int, spacing: float
) -> Tensor:
    """Eq. 6 as printed, n = 1..N, except that its second exponent gets the j without which it is no phase.

    Phase 2 pi spacing (n - 1) (floor(n / Nx) sin theta sin phi + (n mod Nx) sin theta cos phi), with theta the azimuth
    from the panel's normal and phi the elevation. The factor n - 1 makes it quadratic in n.
    """
    horizontal = (normal_cosine * normal_cosine + column_cosine * column_cosine).sqrt()
    sin_azimuth = column_cosine / horizontal.clamp_min(1e-12)
    index = _count(elements, normal_cosine) + 1
    row = torch.div(index, columns, rounding_mode="floor")
    steps = row * (sin_azimuth * row_cosine).unsqueeze(-1) + (index % columns) * (sin_azimuth * horizontal).unsqueeze(
        -1
    )
    return _phasor(2.0 * math.pi * spacing * (index - 1) * steps)


def _count(size: int, like: Tensor) -> Tensor:
    return torch.arange(size, dtype=like.dtype, device=like.device)


def _phasor(phase: Tensor) -> Tensor:
    return torch.complex(torch.cos(phase), torch.sin(phase))
