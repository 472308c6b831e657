"""What the training environment and the rf node ask of the radio model in a slot."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from airframe.power import drag_force, total_power
from rf_model.channels import Channels, link_gains
from rf_model.fairness import fair_rate_bps, hfi, jfi
from rf_model.geometry import constant
from rf_model.link import effective_channel, rate_bps, sinr
from rf_model.scenario import Scenario
from rf_model.star_ris import Coefficients


@dataclass(frozen=True)
class Rates:
    """What the users get in a slot, with leading batch dimensions `...`."""

    sinr: Tensor
    """[..., J]"""
    rate_bps: Tensor
    """[..., J]"""
    fair_rate_bps: Tensor
    """[...] HFI times the sum rate."""

    @property
    def sum_rate_bps(self) -> Tensor:
        """[...]"""
        return self.rate_bps.sum(-1)

    @property
    def hfi(self) -> Tensor:
        """[...]"""
        return hfi(self.rate_bps)

    @property
    def jfi(self) -> Tensor:
        """[...]"""
        return jfi(self.rate_bps)


@dataclass(frozen=True)
class ReferenceGains:
    """One amplitude for each kind of link: the root of its mean power gain at the start position."""

    direct: float
    bs_ris: float
    ris_user: float


def slot_rates(scenario: Scenario, channels: Channels, trc: Coefficients, beamforming: Tensor) -> Rates:
    """Rates for channels and TRCs [..., N] of one batch shape and beamforming [..., M, J] (eq. 12-14)."""
    received = effective_channel(channels, trc) @ beamforming
    ratio = sinr(received, scenario.noise_w, scenario.sinr)
    rate = rate_bps(ratio, scenario.bandwidth_hz)
    return Rates(sinr=ratio, rate_bps=rate, fair_rate_bps=fair_rate_bps(rate))


def slot_power(scenario: Scenario, velocity_enu: Tensor, yaw_rad: Tensor) -> Tensor:
    """Total power (eq. 19) [W], [...], at a velocity over ground [..., 3] with the panel's normal at yaw [...].

    It is that of the velocity through the air: over ground less the scenario's wind. A single velocity on the CPU that
    asks for no gradient is computed in floats by the same formula, because small tensors cost fifty times as much.
    """
    alone = velocity_enu.numel() == 3 and velocity_enu.shape[:-1] == yaw_rad.shape
    if alone and velocity_enu.is_cpu and not _differentiated(velocity_enu, yaw_rad):
        ground, yaw = velocity_enu.flatten().tolist(), yaw_rad.item()
        x, y, z = (over - wind for over, wind in zip(ground, scenario.wind_enu, strict=True))
        power = total_power(scenario.wing, scenario.panel, x, y, z, math.cos(yaw), math.sin(yaw))
        return torch.full_like(yaw_rad, power, dtype=velocity_enu.dtype)
    if any(scenario.wind_enu):
        velocity_enu = velocity_enu - constant(scenario.wind_enu, velocity_enu.dtype, velocity_enu.device)
    x, y, z = velocity_enu.unbind(-1)
    return total_power(scenario.wing, scenario.panel, x, y, z, torch.cos(yaw_rad), torch.sin(yaw_rad))


def track_power(scenario: Scenario, time_s: Tensor, velocity_enu: Tensor, yaw_rad: Tensor) -> Tensor:
    """Mean power [W] over a flown track: velocities over ground [T, 3] at two or more increasing times [T]."""
    power = slot_power(scenario, velocity_enu, yaw_rad)
    return torch.trapezoid(power, time_s) / (time_s[-1] - time_s[0])


def steady_tilt(scenario: Scenario, velocity_enu: Tensor, yaw_rad: Tensor) -> tuple[Tensor, Tensor]:
    """MAVLink's roll and pitch [...] [rad] at which thrust holds weight and drag at a constant velocity [..., 3]."""
    x, y = (velocity_enu[..., axis] - scenario.wind_enu[axis] for axis in (0, 1))
    cosine, sine = torch.cos(yaw_rad), torch.sin(yaw_rad)
    east, north = drag_force(scenario.wing, scenario.panel, x, y, cosine, sine)
    forward, left = east * cosine + north * sine, north * cosine - east * sine
    weight = torch.full_like(forward, scenario.wing.weight_n)
    return -torch.atan2(left, torch.hypot(forward, weight)), -torch.atan2(forward, weight)


def reference_gains(scenario: Scenario) -> ReferenceGains:
    """Root mean power gain of each link, the vehicle at its start and users all over their sectors (`state_norm`).

    Averaged over a fixed grid of equal areas, so that it is a constant of the scenario; a blocked direct link counts as
    if it were on.
    """
    start = torch.tensor(scenario.start_enu, dtype=torch.float64)
    users = _user_grid(scenario)
    gains = link_gains(scenario, start, users)
    return ReferenceGains(
        direct=math.sqrt((gains.direct**2).mean().item()),
        bs_ris=math.sqrt(gains.bs_ris_power.item()),
        ris_user=math.sqrt(gains.ris_user_power.mean().item()),
    )


def _differentiated(*tensors: Tensor) -> bool:
    return torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)


def _user_grid(scenario: Scenario, radii: int = 16, angles: int = 16) -> Tensor:
    """Midpoints of equal areas of both sectors [2 * radii * angles, 3]."""
    inner, outer = scenario.user_radius_m
    fraction = (torch.arange(radii, dtype=torch.float64) + 0.5) / radii
    radius = (inner**2 + fraction * (outer**2 - inner**2)).sqrt()
    spread = ((torch.arange(angles, dtype=torch.float64) + 0.5) / angles * 2 - 1) * scenario.user_half_angle_rad
    heading = scenario.panel_heading_rad
    angle = torch.cat((heading + spread, heading + math.pi + spread))
    x = scenario.user_centre_enu[0] + radius[:, None] * torch.cos(angle)
    y = scenario.user_centre_enu[1] + radius[:, None] * torch.sin(angle)
    return torch.stack((x, y, torch.full_like(x, scenario.user_height_m)), dim=-1).flatten(0, 1)
