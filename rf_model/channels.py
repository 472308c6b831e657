"""The three channels of a slot (paper sec. III-B): base station to user, to surface, and surface to user."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from rf_model import path_loss
from rf_model.arrays import line_response, literal_response, planar_response
from rf_model.fading import rayleigh, rician_weights
from rf_model.geometry import beyond_panel, horizontal_distance, offset_and_distance, panel_cosines
from rf_model.scenario import Scenario

BLOCKED_DB = 20.0
"""Extra loss of a surface-to-user link whose line of sight is blocked."""


@dataclass(frozen=True)
class Channels:
    """Complex amplitudes including path loss and gains, with leading batch dimensions `...`."""

    direct: Tensor
    """h_b [..., J, M]."""
    bs_ris: Tensor
    """H [..., N, M]; carries the surface's gain, so that the cascade has it once."""
    ris_user: Tensor
    """h_s [..., J, N]."""
    transmission: Tensor
    """Whether the surface serves the user by transmission [..., J], bool."""


@dataclass(frozen=True)
class LinkGains:
    """Large-scale amplitude gains of the links, antenna gains included; the direct one as if `direct` were on."""

    direct: Tensor
    """[..., J]"""
    bs_ris: Tensor
    """[...]"""
    ris_user: Tensor
    """[..., J] with line of sight."""
    ris_user_blocked: Tensor
    """[..., J] without."""


def line_of_sight_probability(elevation_sine: Tensor) -> Tensor:
    """1 / (1 + 9.61 exp(-0.16 (el - 9.61))), el in degrees (air-to-ground, urban), from sin el [...]."""
    elevation_deg = torch.rad2deg(torch.asin(elevation_sine.clamp(-1.0, 1.0)))
    return torch.sigmoid(0.16 * (elevation_deg - 9.61) - math.log(9.61))


def link_gains(scenario: Scenario, position_enu: Tensor, users_enu: Tensor) -> LinkGains:
    """Gains for a vehicle [..., 3] and users [..., J, 3]."""
    base_station = position_enu.new_tensor(scenario.base_station_enu)
    _, to_base_station = offset_and_distance(position_enu, base_station)
    _, to_users = offset_and_distance(position_enu.unsqueeze(-2), users_enu)
    return _link_gains(scenario, position_enu, users_enu, base_station, to_base_station, to_users)


def draw_channels(
    scenario: Scenario, position_enu: Tensor, yaw_rad: Tensor, users_enu: Tensor, generator: torch.Generator
) -> Channels:
    """Block-fading channels of one slot for vehicles [..., 3] with yaw [...] and users [..., J, 3].

    The base station's link to the surface is Rician (eq. 3, 4), that to the users Rayleigh, that of the surface to the
    users Rician with line of sight and Rayleigh without. Real dtype and device are those of `position_enu`, which the
    generator must share. Two draws from the generator: all scattering, then all line-of-sight events.
    """
    batch = position_enu.shape[:-1]
    J, M, N = scenario.users, scenario.antennas, scenario.elements
    base_station = position_enu.new_tensor(scenario.base_station_enu)
    bs_offset, bs_distance = offset_and_distance(position_enu, base_station)
    user_offset, user_distance = offset_and_distance(position_enu.unsqueeze(-2), users_enu)
    bs_cosines = panel_cosines(bs_offset, bs_distance, yaw_rad)
    user_cosines = panel_cosines(user_offset, user_distance, yaw_rad.unsqueeze(-1))
    gains = _link_gains(scenario, position_enu, users_enu, base_station, bs_distance, user_distance)

    scattered = rayleigh((*batch, J * M + N * M + J * N), generator, position_enu.dtype)
    direct, bs_ris, ris_user = torch.split(scattered, [J * M, N * M, J * N], dim=-1)
    los_weight, scattered_weight = rician_weights(scenario.kappa)

    direct_gain = gains.direct if scenario.direct == "on" else torch.zeros_like(gains.direct)
    h_b = direct.reshape(*batch, J, M) * direct_gain.unsqueeze(-1)

    departure = line_response(-bs_offset[..., 1] / bs_distance, M)
    arrival = _panel_response(scenario, bs_cosines)
    los = (arrival * (gains.bs_ris * los_weight).unsqueeze(-1)).unsqueeze(-1) * departure.conj().unsqueeze(-2)
    H = los + bs_ris.reshape(*batch, N, M) * (gains.bs_ris * scattered_weight)[..., None, None]

    los_amplitude = gains.ris_user * los_weight
    scattered_amplitude = gains.ris_user * scattered_weight
    if scenario.ris_user == "p_los":
        sight = torch.rand((*batch, J), generator=generator, dtype=position_enu.dtype, device=generator.device)
        clear = sight < line_of_sight_probability(-user_cosines[2])
        los_amplitude = los_amplitude * clear
        scattered_amplitude = torch.where(clear, scattered_amplitude, gains.ris_user_blocked)
    elif scenario.ris_user == "nlos":
        los_amplitude = torch.zeros_like(los_amplitude)
        scattered_amplitude = gains.ris_user_blocked
    h_s = ris_user.reshape(*batch, J, N) * scattered_amplitude.unsqueeze(-1)
    if scenario.ris_user != "nlos":
        h_s = h_s + _panel_response(scenario, user_cosines) * los_amplitude.unsqueeze(-1)

    if scenario.region == "geometric":
        transmission = beyond_panel(user_cosines[0], bs_cosines[0])
    else:
        order = torch.arange(J, device=position_enu.device)
        transmission = (order >= scenario.reflection_count).expand(*batch, J)
    return Channels(direct=h_b, bs_ris=H, ris_user=h_s, transmission=transmission)


def _link_gains(
    scenario: Scenario,
    position_enu: Tensor,
    users_enu: Tensor,
    base_station: Tensor,
    bs_distance: Tensor,
    user_distance: Tensor,
) -> LinkGains:
    carrier = scenario.carrier_hz
    height = scenario.user_height_m if scenario.nlos_height == "user" else position_enu[..., 2:3]

    if scenario.path_loss.bs_user == "paper":
        _, direct_distance = offset_and_distance(base_station, users_enu)
        direct_db = path_loss.paper_nlos_db(carrier, direct_distance, height)
    else:
        model = {"tr38901_umi": path_loss.tr38901_umi_nlos_db, "tr38901_uma": path_loss.tr38901_uma_nlos_db}
        direct_db = model[scenario.path_loss.bs_user](
            carrier, horizontal_distance(base_station, users_enu), scenario.base_station_enu[2], scenario.user_height_m
        )
    direct = path_loss.amplitude(direct_db + (scenario.direct_extra_db - scenario.bs_gain_db))

    bs_ris_db = path_loss.paper_los_db(carrier, bs_distance) - (scenario.bs_gain_db + scenario.ris_gain_db)

    los_db = (
        path_loss.paper_los_db(carrier, user_distance)
        if scenario.path_loss.ris_user == "paper"
        else path_loss.free_space_db(carrier, user_distance)
    )
    if scenario.ris_user == "nlos" and scenario.path_loss.ris_user == "paper":
        blocked_db = path_loss.paper_nlos_db(carrier, user_distance, height)
    else:
        blocked_db = los_db + BLOCKED_DB
    return LinkGains(
        direct=direct,
        bs_ris=path_loss.amplitude(bs_ris_db),
        ris_user=path_loss.amplitude(los_db),
        ris_user_blocked=path_loss.amplitude(blocked_db),
    )


def _panel_response(scenario: Scenario, cosines: tuple[Tensor, Tensor, Tensor]) -> Tensor:
    spacing = scenario.group / scenario.mu
    normal, column, row = cosines
    if scenario.array == "planar":
        return planar_response(column, row, scenario.rows, scenario.columns, spacing)
    return literal_response(normal, column, row, scenario.elements, scenario.columns, spacing)
