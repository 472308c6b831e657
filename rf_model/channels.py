"""The three channels of a slot (paper sec. III-B): base station to user, to surface, and surface to user."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from rf_model import path_loss
from rf_model.arrays import line_response, literal_response, planar_response
from rf_model.fading import rayleigh, rician_weights
from rf_model.geometry import beyond_panel, constant, horizontal_distance, offset_and_distance, panel_frame
from rf_model.scenario import Scenario

BLOCKED_DB = 20.0
"""Extra loss of a surface-to-user link whose line of sight is blocked."""
ELEVATION_EXCESS_DB = (1.0, 20.0)
"""Loss beyond free space with and without line of sight, urban (the source of `line_of_sight_probability`)."""


@dataclass(frozen=True)
class Channels:
    """Complex amplitudes including path loss and gains, with leading batch dimensions `...`."""

    direct: Tensor
    """h_b [..., J, M]."""
    bs_ris: Tensor
    """H [..., N, M]; carries the surface's gain and loss, so that the cascade has them once."""
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
    """[...] with line of sight."""
    bs_ris_blocked: Tensor
    """[...] without."""
    bs_ris_sight: Tensor | float
    """Probability of line of sight [...]."""
    ris_user: Tensor
    """[..., J] with line of sight."""
    ris_user_blocked: Tensor
    """[..., J] without."""
    ris_user_sight: Tensor | float
    """Probability of line of sight [..., J]."""

    @property
    def bs_ris_power(self) -> Tensor:
        """Mean power gain [...] over line of sight and none."""
        return self.bs_ris_sight * self.bs_ris**2 + (1.0 - self.bs_ris_sight) * self.bs_ris_blocked**2

    @property
    def ris_user_power(self) -> Tensor:
        """Mean power gain [..., J] over line of sight and none."""
        return self.ris_user_sight * self.ris_user**2 + (1.0 - self.ris_user_sight) * self.ris_user_blocked**2


@dataclass(frozen=True)
class Fading:
    """All that is random in the channels of a slot, or of a block of slots (one more dimension in front)."""

    direct: Tensor
    """CN(0, 1) of h_b as pairs of reals [..., J, M, 2]: products of complex and real tensors would first turn the real
    one complex."""
    bs_ris: Tensor
    """Of H [..., N, M, 2]."""
    ris_user: Tensor
    """Of h_s [..., J, N, 2]."""
    user_sight: Tensor | None
    """Even over [0, 1) [..., J]: below its probability, a surface-to-user link is in sight; None: nothing to draw."""
    bs_sight: Tensor | None
    """The same for the link from base station to surface [...]."""

    def slot(self, index: int) -> "Fading":
        """One slot of a block."""
        return Fading(
            self.direct[index],
            self.bs_ris[index],
            self.ris_user[index],
            None if self.user_sight is None else self.user_sight[index],
            None if self.bs_sight is None else self.bs_sight[index],
        )


def line_of_sight_probability(elevation_sine: Tensor) -> Tensor:
    """1 / (1 + 9.61 exp(-0.16 (el - 9.61))), el in degrees, from sin el [...].

    Urban air-to-ground links of Al-Hourani, Kandeepan, Lardner, "Optimal LAP Altitude for Maximum Coverage", 2014.
    """
    elevation_rad = torch.asin(elevation_sine.clamp(-1.0, 1.0))
    return torch.sigmoid(math.degrees(0.16) * elevation_rad - (0.16 * 9.61 + math.log(9.61)))


def link_gains(scenario: Scenario, position_enu: Tensor, users_enu: Tensor) -> LinkGains:
    """Gains for a vehicle [..., 3] and users [..., J, 3]."""
    base_station = constant(scenario.base_station_enu, position_enu.dtype, position_enu.device)
    _, to_base_station = offset_and_distance(position_enu, base_station)
    offset, to_users = offset_and_distance(position_enu.unsqueeze(-2), users_enu)
    elevation_sine = -offset[..., 2] / to_users
    return _link_gains(scenario, position_enu, users_enu, base_station, to_base_station, to_users, elevation_sine)


def draw_fading(scenario: Scenario, batch: tuple[int, ...], generator: torch.Generator, dtype: torch.dtype) -> Fading:
    """Fading of a batch shape, on the generator's device; `dtype` is the real type.

    Up to three draws, each for the whole batch: scattering (h_b, H, h_s in a row), users' lines of sight, the base
    station's.
    """
    J, M, N = scenario.users, scenario.antennas, scenario.elements
    scattered = torch.view_as_real(rayleigh((*batch, J * M + N * M + J * N), generator, dtype))
    direct, bs_ris, ris_user = torch.split(scattered, [J * M, N * M, J * N], dim=-2)

    def uniform(shape: tuple[int, ...]) -> Tensor:
        return torch.rand(shape, generator=generator, dtype=dtype, device=generator.device)

    return Fading(
        direct=torch.unflatten(direct, -2, (J, M)),
        bs_ris=torch.unflatten(bs_ris, -2, (N, M)),
        ris_user=torch.unflatten(ris_user, -2, (J, N)),
        user_sight=uniform((*batch, J)) if scenario.ris_user == "p_los" else None,
        bs_sight=uniform(batch) if scenario.path_loss.bs_ris != "paper" else None,
    )


def draw_channels(
    scenario: Scenario, position_enu: Tensor, yaw_rad: Tensor, users_enu: Tensor, generator: torch.Generator
) -> Channels:
    """Block-fading channels of one slot for upright panels at [..., 3] with yaw [...] and users [..., J, 3].

    Real dtype and device are those of `position_enu`, which the generator must share.
    """
    fading = draw_fading(scenario, tuple(position_enu.shape[:-1]), generator, position_enu.dtype)
    return faded_channels(scenario, position_enu, panel_frame(yaw_rad), users_enu, fading)


def faded_channels(
    scenario: Scenario, position_enu: Tensor, frame: Tensor, users_enu: Tensor, fading: Fading
) -> Channels:
    """Channels for vehicles [..., 3] with panel frames [..., 3, 3] and users [..., J, 3] in a given fading.

    The base station's link to the users is Rayleigh; the surface's links are Rician with line of sight (eq. 3, 4) and
    Rayleigh without. A position that is not finite makes its own row's channels so, and no other's.
    """
    batch = position_enu.shape[:-1]
    J, M = scenario.users, scenario.antennas
    base_station = constant(scenario.base_station_enu, position_enu.dtype, position_enu.device)
    ends = torch.cat((base_station.expand(*batch, 1, 3), users_enu), dim=-2)
    offset, distance = offset_and_distance(position_enu.unsqueeze(-2), ends)
    direction = offset / distance.unsqueeze(-1)
    cosines = direction @ frame.mT
    gains = _link_gains(
        scenario, position_enu, users_enu, base_station, distance[..., 0], distance[..., 1:], -direction[..., 1:, 2]
    )
    responses = _panel_response(scenario, cosines)

    h_b = fading.direct * gains.direct[..., None, None]
    if scenario.direct == "blocked":
        h_b = torch.zeros_like(h_b)

    los, scattered = _rician(scenario, gains.bs_ris, gains.bs_ris_blocked, gains.bs_ris_sight, fading.bs_sight)
    H = fading.bs_ris * scattered[..., None, None, None]
    if los is not None:
        # Eq. 4 has the conjugate of eq. 5 at the angle of departure, which is eq. 5 at the opposite direction.
        towards_surface = line_response(direction[..., 0, 1], M)
        steered = responses[..., 0, :].unsqueeze(-1) * towards_surface.unsqueeze(-2)
        H = torch.addcmul(H, torch.view_as_real(steered), los[..., None, None, None])

    los, scattered = _rician(scenario, gains.ris_user, gains.ris_user_blocked, gains.ris_user_sight, fading.user_sight)
    h_s = fading.ris_user * scattered[..., None, None]
    if los is not None:
        h_s = torch.addcmul(h_s, torch.view_as_real(responses[..., 1:, :]), los[..., None, None])

    if scenario.region == "geometric":
        transmission = beyond_panel(cosines[..., 1:, 0], cosines[..., 0, 0])
    else:
        order = torch.arange(J, device=position_enu.device)
        transmission = (order >= scenario.reflection_count).expand(*batch, J)
    return Channels(
        direct=torch.view_as_complex(h_b),
        bs_ris=torch.view_as_complex(H),
        ris_user=torch.view_as_complex(h_s),
        transmission=transmission,
    )


def _rician(
    scenario: Scenario, clear: Tensor, blocked: Tensor, sight: Tensor | float, drawn: Tensor | None
) -> tuple[Tensor | None, Tensor]:
    """Amplitudes of a link's line-of-sight part (None: it has none) and of its scattered part."""
    los_weight, scattered_weight = rician_weights(scenario.kappa)
    if isinstance(sight, Tensor):
        assert drawn is not None
        seen = drawn < sight
        return clear * los_weight * seen, torch.where(seen, clear * scattered_weight, blocked)
    if sight == 0.0:
        return None, blocked
    return clear * los_weight, clear * scattered_weight


def _link_gains(
    scenario: Scenario,
    position_enu: Tensor,
    users_enu: Tensor,
    base_station: Tensor,
    bs_distance: Tensor,
    user_distance: Tensor,
    elevation_sine: Tensor,
) -> LinkGains:
    carrier, models = scenario.carrier_hz, scenario.path_loss
    nlos_height = scenario.user_height_m if scenario.nlos_height == "user" else position_enu[..., 2:3]

    direct_gain_db = scenario.bs_gain_db - scenario.direct_extra_db
    if models.bs_user == "paper":
        _, direct_distance = offset_and_distance(base_station, users_enu)
        direct = path_loss.paper_nlos_amplitude(carrier, direct_distance, nlos_height, direct_gain_db)
    else:
        ground = {"tr38901_umi": path_loss.tr38901_umi_nlos_db, "tr38901_uma": path_loss.tr38901_uma_nlos_db}
        direct_db = ground[models.bs_user](
            carrier, horizontal_distance(base_station, users_enu), scenario.base_station_enu[2], scenario.user_height_m
        )
        direct = path_loss.amplitude(direct_db - direct_gain_db)

    bs_ris_gain_db = scenario.bs_gain_db + scenario.ris_gain_db - scenario.element_loss_db
    bs_sight: Tensor | float = 1.0
    if models.bs_ris == "paper":
        bs_ris = bs_ris_blocked = path_loss.paper_los(carrier).amplitude(bs_distance, bs_ris_gain_db)
    else:
        aerial = path_loss.AERIAL[models.bs_ris]
        height = position_enu[..., 2]
        bs_ris = path_loss.amplitude(aerial.los_db(carrier, bs_distance, height) - bs_ris_gain_db)
        bs_ris_blocked = path_loss.amplitude(aerial.nlos_db(carrier, bs_distance, height) - bs_ris_gain_db)
        bs_sight = aerial.los_probability(horizontal_distance(base_station, position_enu), height)

    clear_model = path_loss.paper_los if models.ris_user == "paper" else path_loss.free_space
    clear_excess_db, blocked_excess_db = ELEVATION_EXCESS_DB if models.ris_user == "elevation" else (0.0, BLOCKED_DB)
    ris_user = clear_model(carrier).amplitude(user_distance, -clear_excess_db)
    if models.ris_user == "paper" and scenario.ris_user == "nlos":
        ris_user_blocked = path_loss.paper_nlos_amplitude(carrier, user_distance, nlos_height)
    else:
        ris_user_blocked = ris_user * 10.0 ** ((clear_excess_db - blocked_excess_db) / 20.0)
    return LinkGains(
        direct=direct,
        bs_ris=bs_ris,
        bs_ris_blocked=bs_ris_blocked,
        bs_ris_sight=bs_sight,
        ris_user=ris_user,
        ris_user_blocked=ris_user_blocked,
        ris_user_sight=(
            line_of_sight_probability(elevation_sine)
            if scenario.ris_user == "p_los"
            else float(scenario.ris_user == "los")
        ),
    )


def _panel_response(scenario: Scenario, cosines: Tensor) -> Tensor:
    """[..., N] for direction cosines [..., 3] along the panel's normal, columns and rows."""
    spacing = scenario.group / scenario.mu
    normal, column, row = cosines.unbind(-1)
    if scenario.array == "planar":
        return planar_response(column, row, scenario.rows, scenario.columns, spacing)
    return literal_response(normal, column, row, scenario.elements, scenario.columns, spacing)
