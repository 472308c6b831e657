"""Path loss in dB and line-of-sight probability of tensors of distances [m]; frequencies in Hz."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import torch
from torch import Tensor

SPEED_OF_LIGHT_MPS = 299_792_458.0
"""TR 38.901 table 7.4.1-1 rounds it to 3e8 in the breakpoint distance, which is 0.006 dB beyond it."""


def amplitude(loss_db: Tensor) -> Tensor:
    """Amplitude gain 10^(-L/20)."""
    return torch.exp(loss_db * (-math.log(10.0) / 20.0))


@dataclass(frozen=True)
class LogDistance:
    """A loss that is linear in the distance's logarithm: in dB, and as the power law that this is of the amplitude."""

    at_1_m_db: float
    slope_db: float
    """For each decade."""

    def db(self, distance: Tensor) -> Tensor:
        """L = L(1 m) + slope log10 d."""
        return self.slope_db * torch.log10(distance) + self.at_1_m_db

    def amplitude(self, distance: Tensor, gain_db: Tensor | float = 0.0) -> Tensor:
        """`amplitude` of the loss less a gain: 10^((G - L(1 m)) / 20) d^(-slope / 20)."""
        return distance ** (self.slope_db / -20.0) * 10.0 ** ((gain_db - self.at_1_m_db) / 20.0)


@lru_cache(maxsize=16)
def free_space(carrier_hz: float) -> LogDistance:
    """Friis: 20 log10(4 pi d f / c)."""
    return LogDistance(20.0 * math.log10(4.0 * math.pi * carrier_hz / SPEED_OF_LIGHT_MPS), 20.0)


@lru_cache(maxsize=16)
def paper_los(carrier_hz: float) -> LogDistance:
    """Paper eq. 7, f in GHz, d the 3-D distance."""
    return LogDistance(20.0 * math.log10(carrier_hz / 1e9) + 28.0, 22.0)


@lru_cache(maxsize=16)
def _paper_ground(carrier_hz: float) -> LogDistance:
    """Paper eq. 9 for users at 1.5 m."""
    return LogDistance(26.0 * math.log10(carrier_hz / 1e9) + 22.7, 36.7)


def free_space_db(carrier_hz: float, distance: Tensor) -> Tensor:
    """Friis: 20 log10(4 pi d f / c)."""
    return free_space(carrier_hz).db(distance)


def paper_los_db(carrier_hz: float, distance: Tensor) -> Tensor:
    """Paper eq. 7, f in GHz, d the 3-D distance."""
    return paper_los(carrier_hz).db(distance)


def paper_nlos_db(carrier_hz: float, distance: Tensor, height_m: Tensor | float) -> Tensor:
    """Paper eq. 8 and 9; `height_m` is z_s, broadcasting with `distance`."""
    nlos = _paper_ground(carrier_hz).db(distance) - _height_gain_db(height_m)
    return torch.maximum(nlos, paper_los_db(carrier_hz, distance))


def paper_nlos_amplitude(carrier_hz: float, distance: Tensor, height_m: Tensor | float, gain_db: float = 0.0) -> Tensor:
    """`amplitude` of `paper_nlos_db` less a gain: the greater loss is the smaller amplitude."""
    nlos = _paper_ground(carrier_hz).amplitude(distance, gain_db + _height_gain_db(height_m))
    return torch.minimum(nlos, paper_los(carrier_hz).amplitude(distance, gain_db))


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


def tr36777_uma_av_los_db(carrier_hz: float, distance_3d: Tensor, height_m: Tensor) -> Tensor:
    """UMa-AV, LoS (TR 36.777 table B-2): for vehicles above 22.5 and up to 300 m, whatever their height."""
    return 28.0 + 22.0 * torch.log10(distance_3d) + 20.0 * math.log10(carrier_hz / 1e9)


def tr36777_uma_av_nlos_db(carrier_hz: float, distance_3d: Tensor, height_m: Tensor) -> Tensor:
    """UMa-AV, NLoS (TR 36.777 table B-2): for vehicles up to 100 m; above, the line of sight is certain.

    The table has no maximum with the LoS loss; here it is never less, which matters nearer than 10 m only.
    """
    slope = 46.0 - 7.0 * _log_height(height_m)
    nlos = slope * torch.log10(distance_3d) + (20.0 * math.log10(40.0 * math.pi * carrier_hz / 3e9) - 17.5)
    return torch.maximum(nlos, tr36777_uma_av_los_db(carrier_hz, distance_3d, height_m))


def tr36777_umi_av_los_db(carrier_hz: float, distance_3d: Tensor, height_m: Tensor) -> Tensor:
    """UMi-AV, LoS (TR 36.777 table B-2): at least free space; for vehicles above 22.5 and up to 300 m."""
    slope = 22.25 - 0.5 * _log_height(height_m)
    los = slope * torch.log10(distance_3d) + (30.9 + 20.0 * math.log10(carrier_hz / 1e9))
    return torch.maximum(los, free_space_db(carrier_hz, distance_3d))


def tr36777_umi_av_nlos_db(carrier_hz: float, distance_3d: Tensor, height_m: Tensor) -> Tensor:
    """UMi-AV, NLoS (TR 36.777 table B-2): for vehicles above 22.5 and up to 300 m."""
    slope = 43.2 - 7.6 * _log_height(height_m)
    nlos = slope * torch.log10(distance_3d) + (32.4 + 20.0 * math.log10(carrier_hz / 1e9))
    return torch.maximum(nlos, tr36777_umi_av_los_db(carrier_hz, distance_3d, height_m))


def tr36777_uma_av_los_probability(distance_2d: Tensor, height_m: Tensor) -> Tensor:
    """UMa-AV (TR 36.777 table B-1): 1 within d1 = max(460 log10 h - 700, 18) and above 100 m."""
    log_height = _log_height(height_m)
    probability = _aerial_los_probability(distance_2d, 460.0 * log_height - 700.0, 4300.0 * log_height - 3800.0)
    return torch.where(height_m > 100.0, 1.0, probability)


def tr36777_umi_av_los_probability(distance_2d: Tensor, height_m: Tensor) -> Tensor:
    """UMi-AV (TR 36.777 table B-1): 1 within d1 = max(294.05 log10 h - 432.94, 18)."""
    log_height = _log_height(height_m)
    return _aerial_los_probability(distance_2d, 294.05 * log_height - 432.94, 233.98 * log_height - 0.95)


@dataclass(frozen=True)
class Aerial:
    """One of TR 36.777's models of the link from a base station to a vehicle in the air (annex B)."""

    los_db: Callable[[float, Tensor, Tensor], Tensor]
    """Of carrier, 3-D distance and the vehicle's height; so is `nlos_db`."""
    nlos_db: Callable[[float, Tensor, Tensor], Tensor]
    los_probability: Callable[[Tensor, Tensor], Tensor]
    """Of horizontal distance and height."""


AERIAL: Mapping[str, Aerial] = MappingProxyType(
    {
        "tr36777_uma_av": Aerial(tr36777_uma_av_los_db, tr36777_uma_av_nlos_db, tr36777_uma_av_los_probability),
        "tr36777_umi_av": Aerial(tr36777_umi_av_los_db, tr36777_umi_av_nlos_db, tr36777_umi_av_los_probability),
    }
)
"""By their names in `PathLoss.bs_ris`."""


def _height_gain_db(height_m: Tensor | float) -> Tensor | float:
    """What a user above 1.5 m gains in eq. 9."""
    return 0.3 * (height_m - 1.5)


def _aerial_los_probability(distance_2d: Tensor, d1: Tensor, p1: Tensor) -> Tensor:
    """d1 / d + exp(-d / p1) (1 - d1 / d) beyond d1; both at least what keeps the form a probability."""
    share = (d1.clamp_min(18.0) / distance_2d).clamp_max(1.0)
    return share + torch.exp(-distance_2d / p1.clamp_min(1.0)) * (1.0 - share)


def _log_height(height_m: Tensor) -> Tensor:
    """log10 of a height, which counts as at least 1.5 m (the lowest that TR 36.777 knows)."""
    return torch.log10(height_m.clamp_min(1.5))


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
