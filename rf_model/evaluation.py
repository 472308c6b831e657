"""What a snapshot is worth: rates of the true channels, power at a constant velocity, reward."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from airframe.power import power_terms
from rf_model.channels import Channels, Fading, LinkGains, draw_fading, faded_channels, link_gains
from rf_model.complex_pairs import ShapeError, to_matrix, to_pairs
from rf_model.geometry import panel_frame
from rf_model.given_trc import AMPLITUDES, read_given
from rf_model.link import BeamformingError, check_beamforming, effective_channel, identity_beamforming
from rf_model.reference.uncompiled import zero_forcing
from rf_model.reward import reward
from rf_model.ris_control import reference_solution
from rf_model.scenario import Scenario
from rf_model.snapshot import GivenChannels, Snapshot, SnapshotError
from rf_model.star_ris import Coefficients, TrcError
from rf_model.surfaces import surface_of
from rf_model.world import slot_rates


@dataclass(frozen=True)
class Link:
    """One link's large scale: the path-loss model's values, without antenna gains and `direct_extra_db`."""

    distance_m: float
    line_of_sight_probability: float
    line_of_sight: bool | None
    """Whether the channel was drawn with line of sight; None: channels are given, nobody knows."""
    path_loss_los_db: float | None
    """None: never with line of sight."""
    path_loss_nlos_db: float | None
    """None: never without."""


@dataclass(frozen=True)
class Links:
    """The links of a slot, by user where there are several."""

    direct: list[Link]
    bs_ris: Link
    ris_user: list[Link]


@dataclass(frozen=True)
class Evaluation:
    """What a snapshot is worth. Lists are by user; complex numbers are [re, im]."""

    links: Links
    regions: list[Literal["reflection", "transmission"]]
    noise_w: float
    transmit_power_w: float
    sinr: list[float]
    rate_bps: list[float]
    below_qos: list[bool]
    sum_rate_bps: float
    fair_rate_bps: float
    hfi: float
    jfi: float
    power_terms_w: dict[str, float]
    """blade, induced, parasite, climb, panel_drag."""
    power_w: float
    energy_j: float
    """Of a whole slot at this velocity."""
    reward: float
    channels: dict[str, list[list[list[float]]]]
    """As `Snapshot.channels` takes them; so are the next two."""
    trc: dict[str, list[float]]
    beamforming: list[list[list[float]]]


def evaluate(snapshot: Snapshot) -> Evaluation:
    """Rates of the true channels and power at a constant velocity, as a `LinkReport` has them, in double precision.

    Raises SnapshotError for matrices of wrong shape, coefficients that the surface cannot have and beams above the
    power limit.
    """
    scenario = snapshot.scenario
    position = torch.tensor(snapshot.position_enu, dtype=torch.float64)
    users = torch.tensor(snapshot.users_enu, dtype=torch.float64)
    roll, pitch, yaw = torch.tensor(snapshot.attitude, dtype=torch.float64)
    frame = panel_frame(yaw) if scenario.attitude == "level" else panel_frame(yaw, roll, pitch)
    fading = draw_fading(scenario, (), torch.Generator().manual_seed(snapshot.seed), torch.float64)
    channels = faded_channels(scenario, position, frame, users, fading)
    try:
        if snapshot.channels is not None:
            channels = _given_channels(scenario, snapshot.channels, channels.transmission)
        trc, beams = _decision(snapshot, channels)
    except (ShapeError, TrcError, BeamformingError) as error:
        raise SnapshotError(str(error)) from error

    rates = slot_rates(scenario, channels, trc, beams)
    terms = _power_terms(snapshot)
    power = sum(terms.values())
    evaluation = Evaluation(
        links=_links(snapshot, link_gains(scenario, position, users), None if snapshot.channels else fading),
        regions=["transmission" if beyond else "reflection" for beyond in channels.transmission.tolist()],
        noise_w=scenario.noise_w,
        transmit_power_w=beams.abs().square().sum().item(),
        sinr=rates.sinr.tolist(),
        rate_bps=rates.rate_bps.tolist(),
        below_qos=(rates.rate_bps < scenario.qos_bps).tolist(),
        sum_rate_bps=rates.sum_rate_bps.item(),
        fair_rate_bps=rates.fair_rate_bps.item(),
        hfi=rates.hfi.item(),
        jfi=rates.jfi.item(),
        power_terms_w=terms,
        power_w=power,
        energy_j=power * scenario.slot_s,
        reward=reward(scenario, rates.fair_rate_bps, torch.tensor(power, dtype=torch.float64)).item(),
        channels={name: to_pairs(getattr(channels, name)) for name in GivenChannels.model_fields},
        trc={name: getattr(trc, name).tolist() for name in AMPLITUDES},
        beamforming=to_pairs(beams),
    )
    totals = (evaluation.sum_rate_bps, evaluation.fair_rate_bps, evaluation.energy_j, evaluation.reward)
    if not all(map(math.isfinite, (*evaluation.sinr, *totals))):
        raise SnapshotError("scenario: its numbers are too extreme, the results are not finite")
    return evaluation


def _given_channels(scenario: Scenario, given: GivenChannels, transmission: Tensor) -> Channels:
    J, M, N = scenario.users, scenario.antennas, scenario.elements
    return Channels(
        direct=to_matrix("channels.direct", given.direct, "J x M", J, M),
        bs_ris=to_matrix("channels.bs_ris", given.bs_ris, "N x M", N, M),
        ris_user=to_matrix("channels.ris_user", given.ris_user, "J x N", J, N),
        transmission=transmission,
    )


def _decision(snapshot: Snapshot, channels: Channels) -> tuple[Coefficients, Tensor]:
    """Coefficients and beams that the snapshot asks for, checked."""
    scenario = snapshot.scenario
    if snapshot.ris.by_itself:
        solution = reference_solution(scenario, snapshot.ris, channels)
        return solution.trc, solution.beamforming
    surface = surface_of(scenario)
    trc = surface.neutral(torch.float64) if snapshot.trc is None else read_given(scenario, snapshot.trc)
    match snapshot.beamforming:
        case None | "identity":
            return trc, identity_beamforming(scenario, torch.complex128)
        case "rzf":
            return trc, zero_forcing(scenario, effective_channel(channels, trc))
        case given:
            beams = to_matrix("beamforming", given, "M x J", scenario.antennas, scenario.users)
    check_beamforming(beams, scenario)
    return trc, beams


def _power_terms(snapshot: Snapshot) -> dict[str, float]:
    """Summands of eq. 19 [W] at the velocity through the air."""
    scenario = snapshot.scenario
    x, y, z = (ground - wind for ground, wind in zip(snapshot.velocity_enu, scenario.wind_enu, strict=True))
    yaw = snapshot.attitude[2]
    return power_terms(scenario.wing, scenario.panel, x, y, z, math.cos(yaw), math.sin(yaw))._asdict()


def _links(snapshot: Snapshot, gains: LinkGains, fading: Fading | None) -> Links:
    """Path losses by the scenario's models: the gains without what antennas and obstruction add."""
    scenario, position, users = snapshot.scenario, snapshot.position_enu, snapshot.users_enu
    base_station = scenario.base_station_enu
    direct_gain_db = scenario.bs_gain_db - scenario.direct_extra_db
    bs_ris_gain_db = scenario.bs_gain_db + scenario.ris_gain_db - scenario.element_loss_db
    bs_ris = _link(
        math.dist(base_station, position),
        *_sights(gains.bs_ris_sight, None if fading is None else fading.bs_sight, 1)[0],
        los_db=bs_ris_gain_db + _loss_db(gains.bs_ris.item()),
        nlos_db=bs_ris_gain_db + _loss_db(gains.bs_ris_blocked.item()),
    )
    sights = _sights(gains.ris_user_sight, None if fading is None else fading.user_sight, len(users))
    clear, blocked = gains.ris_user.tolist(), gains.ris_user_blocked.tolist()
    return Links(
        direct=[
            Link(math.dist(base_station, user), 0.0, False, None, direct_gain_db + _loss_db(gain))
            for user, gain in zip(users, gains.direct.tolist(), strict=True)
        ],
        bs_ris=bs_ris,
        ris_user=[
            _link(math.dist(position, user), *sights[j], los_db=_loss_db(clear[j]), nlos_db=_loss_db(blocked[j]))
            for j, user in enumerate(users)
        ],
    )


def _link(distance_m: float, probability: float, sight: bool | None, *, los_db: float, nlos_db: float) -> Link:
    return Link(
        distance_m, probability, sight, los_db if probability > 0 else None, nlos_db if probability < 1 else None
    )


def _sights(probability: Tensor | float, drawn: Tensor | None, links: int) -> list[tuple[float, bool | None]]:
    """Each link's probability of line of sight, and whether it has it, where that is known."""
    p = torch.as_tensor(probability, dtype=torch.float64).expand(links)
    seen = [None] * links if drawn is None else (drawn < p).expand(links).tolist()
    return [(q, bool(q) if q in (0.0, 1.0) else sight) for q, sight in zip(p.tolist(), seen, strict=True)]


def _loss_db(amplitude: float) -> float:
    return -20.0 * math.log10(amplitude)
