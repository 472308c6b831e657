"""Path loss in dB of tensors of distances [m]; frequencies in Hz."""

import math

import torch
from torch import Tensor

SPEED_OF_LIGHT_MPS = 299_792_458.0
"""TR 38.901 table 7.4.1-1 rounds it to 3e8 in the breakpoint distance, which is 0.006 dB beyond it."""


def amplitude(loss_db: Tensor) -> Tensor:
    """Amplitude gain 10^(-L/20)."""
    return torch.exp(loss_db * (-math.log(10.0) / 20.0))


def free_space_db(carrier_hz: float, distance: Tensor) -> Tensor:
    """Friis: 20 log10(4 pi d f / c)."""
    return 20.0 * torch.log10(distance) + 20.0 * math.log10(4.0 * math.pi * carrier_hz / SPEED_OF_LIGHT_MPS)


def paper_los_db(carrier_hz: float, distance: Tensor) -> Tensor:
    """Paper eq. 7, f in GHz, d the 3-D distance."""
    return 20.0 * math.log10(carrier_hz / 1e9) + 28.0 + 22.0 * torch.log10(distance)


def paper_nlos_db(carrier_hz: float, distance: Tensor, height_m: Tensor | float) -> Tensor:
    """Paper eq. 8 and 9; `height_m` is z_s, broadcasting with `distance`."""
    distance_db = 36.7 * torch.log10(distance) + (26.0 * math.log10(carrier_hz / 1e9) + 22.7)
    nlos = distance_db - 0.3 * (height_m - 1.5)
    return torch.maximum(nlos, paper_los_db(carrier_hz, distance))


def tr38901_umi_los_db(carrier_hz: float, distance_2d: Tensor, base_height_m: float, user_height_m: float) -> Tensor:
    """UMi street canyon, LoS (TR 38.901 table 7.4.1-1): 21 dB a decade, 40 beyond the breakpoint."""
    return _two_slopes_db(carrier_hz, distance_2d, base_height_m, user_height_m, 32.4, 21.0, 9.5)


def tr38901_umi_nlos_db(carrier_hz: float, distance_2d: Tensor, base_height_m: float, user_height_m: float) -> Tensor:
    """UMi street canyon, NLoS (TR 38.901 table 7.4.1-1)."""
    distance_3d = _distance_3d(distance_2d, base_height_m, user_height_m)
    nlos = 35.3 * torch.log10(distance_3d) + 22.4 + 21.3 * math.log10(carrier_hz / 1e9) - 0.3 * (user_height_m - 1.5)
    return torch.maximum(nlos, tr38901_umi_los_db(carrier_hz, distance_2d, base_height_m, user_height_m))


def tr38901_uma_los_db(carrier_hz: float, distance_2d: Tensor, base_height_m: float, user_height_m: float) -> Tensor:
    """UMa, LoS (TR 38.901 table 7.4.1-1): 22 dB a decade, 40 beyond the breakpoint; for users below 13 m."""
    return _two_slopes_db(carrier_hz, distance_2d, base_height_m, user_height_m, 28.0, 22.0, 9.0)


def tr38901_uma_nlos_db(carrier_hz: float, distance_2d: Tensor, base_height_m: float, user_height_m: float) -> Tensor:
    """UMa, NLoS (TR 38.901 table 7.4.1-1); for users below 13 m."""
    distance_3d = _distance_3d(distance_2d, base_height_m, user_height_m)
    nlos = 13.54 + 39.08 * torch.log10(distance_3d) + 20.0 * math.log10(carrier_hz / 1e9) - 0.6 * (user_height_m - 1.5)
    return torch.maximum(nlos, tr38901_uma_los_db(carrier_hz, distance_2d, base_height_m, user_height_m))


def _distance_3d(distance_2d: Tensor, base_height_m: float, user_height_m: float) -> Tensor:
    return (distance_2d * distance_2d + (base_height_m - user_height_m) ** 2).sqrt()


def _two_slopes_db(
    carrier_hz: float,
    distance_2d: Tensor,
    base_height_m: float,
    user_height_m: float,
    intercept_db: float,
    slope_db: float,
    breakpoint_db: float,
) -> Tensor:
    environment_height_m = 1.0
    breakpoint_m = (
        4.0
        * (base_height_m - environment_height_m)
        * (user_height_m - environment_height_m)
        * carrier_hz
        / SPEED_OF_LIGHT_MPS
    )
    log_distance = torch.log10(_distance_3d(distance_2d, base_height_m, user_height_m))
    carrier_db = 20.0 * math.log10(carrier_hz / 1e9)
    near = intercept_db + slope_db * log_distance + carrier_db
    beyond = (
        intercept_db
        + 40.0 * log_distance
        + carrier_db
        - breakpoint_db * math.log10(breakpoint_m**2 + (base_height_m - user_height_m) ** 2)
    )
    return torch.where(distance_2d <= breakpoint_m, near, beyond)
