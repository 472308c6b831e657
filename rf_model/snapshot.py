"""One slot on its own: positions, channels, coefficients and beams in; path losses, rates, power and reward out.

`read_snapshot` validates what somebody wrote down, `evaluate` computes. Fields are named as in the bus messages, so
that a recorded `SlotOpened`, `ChannelState` or `Action` can be pasted; complex numbers are [re, im].
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import torch
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    ValidationError,
    model_validator,
)
from torch import Tensor

from airframe.power import power_terms
from rf_model.channels import Channels, Fading, LinkGains, draw_fading, faded_channels, link_gains
from rf_model.config_errors import ALTERNATIVE, one_line
from rf_model.geometry import CLOSEST_M, panel_frame
from rf_model.link import BeamformingError, check_beamforming, effective_channel, identity_beamforming
from rf_model.reward import reward
from rf_model.ris_control import RisControl, reference_solution
from rf_model.scenario import VEHICLE_HEIGHT_M, Point, Scenario, ScenarioError
from rf_model.star_ris import Coefficients, IndependentTrc, Trc, TrcError
from rf_model.surfaces import read_coefficients, surface_of
from rf_model.world import slot_rates

TOLERANCE = 1e-4
"""Of |beta_R|^2 + |beta_T|^2 = 1 and of phases pi/2 apart [rad]: four decimals do, and are then put right."""
NOTHING = 1e-9
"""Amplitudes below this have no phase."""

ANGLES: dict[str, tuple[str, ...]] = {
    "coupled": ("theta_reflection", "split_angle", "sign"),
    "independent": ("theta_reflection", "split_angle", "theta_transmission"),
    "dual": ("theta_reflection",),
    "conventional": ("theta_reflection",),
}
"""What an `Action` must say of each surface."""
ACTION_FIELDS = {"theta_reflection", "split_angle", "sign", "theta_transmission"}
AMPLITUDES = ("theta_reflection", "theta_transmission", "beta_reflection", "beta_transmission")
DIAGONALS = ("reflection", "transmission")


class SnapshotError(ScenarioError):
    """A snapshot that cannot be; the text names the field, the value and what is allowed, in one line."""


def _pair(value: object) -> object:
    if isinstance(value, list | tuple) and len(value) == 2:
        return value
    raise ValueError(f"{value!r} must be [re, im]")


Speed = Annotated[float, Field(ge=-1000, le=1000)]
Angle = Annotated[float, Field(ge=-2 * math.pi, le=2 * math.pi)]
Part = Annotated[float, Field(ge=-1e6, le=1e6)]
Complex = Annotated[tuple[Part, Part], Strict(False), BeforeValidator(_pair)]
Angles = Annotated[tuple[Angle, ...], Strict(False)]
Amplitudes = Annotated[tuple[Annotated[float, Field(ge=0, le=2)], ...], Strict(False)]
Row = Annotated[tuple[Complex, ...], Strict(False)]
Matrix = Annotated[tuple[Row, ...], Strict(False)]
Beams = Annotated[
    Annotated[Literal["identity", "rzf"], Tag(f"{ALTERNATIVE}name")] | Annotated[Matrix, Tag(f"{ALTERNATIVE}matrix")],
    Discriminator(lambda value: f"{ALTERNATIVE}{'name' if isinstance(value, str) else 'matrix'}"),
]


class _Frozen(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class GivenChannels(_Frozen):
    """Channels in place of drawn ones, path loss and gains included (`Channels`)."""

    direct: Matrix
    """h_b, J x M."""
    bs_ris: Matrix
    """H, N x M."""
    ris_user: Matrix
    """h_s, J x N."""


class GivenTrc(_Frozen):
    """Coefficients of N elements in one of three forms.

    As an `Action` has them: `theta_reflection`, `split_angle` and `sign` for a coupled surface; `theta_reflection`,
    `split_angle` and `theta_transmission` for an independent one; `theta_reflection` for all others. As a
    `RisConfiguration`: `theta_*` and `beta_*`. Or the diagonals of Phi_R and Phi_T: `reflection` and `transmission`.
    """

    theta_reflection: Angles | None = None
    theta_transmission: Angles | None = None
    split_angle: Angles | None = None
    sign: Annotated[tuple[Annotated[int, Field(ge=-1, le=1)], ...], Strict(False)] | None = None
    beta_reflection: Amplitudes | None = None
    beta_transmission: Amplitudes | None = None
    reflection: Row | None = None
    transmission: Row | None = None


class Snapshot(_Frozen):
    """Everything that one slot's rates and power depend on."""

    scenario: Scenario
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Of the fading, when no channels are given."""
    position_enu: Point
    """The vehicle, and the surface with it [m]."""
    velocity_enu: Annotated[tuple[Speed, Speed, Speed], Strict(False)] = (0.0, 0.0, 0.0)
    """Over ground [m/s]."""
    attitude_rad: Annotated[tuple[Angle, Angle, Angle], Strict(False)] | None = None
    """Roll, pitch, yaw; level at the scenario's `panel_heading_rad` when not given. Roll and pitch count with
    `attitude: flown` only."""
    users_enu: Annotated[tuple[Point, ...], Strict(False), Field(min_length=1)]
    """J positions, all at the scenario's `user_height_m` [m]."""
    channels: GivenChannels | None = None
    ris: RisControl = RisControl()
    """`agent`: `trc` and `beamforming` of this file; `closed_form`, `optimised`: both from the reference."""
    trc: GivenTrc | None = None
    """None given: the surface's neutral setting."""
    beamforming: Beams | None = None
    """W, M x J [sqrt(W)]; `identity` (the default): equal power on one antenna for each user; `rzf`: regularised zero
    forcing of the effective channel, equal powers."""

    @property
    def attitude(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw [rad]."""
        return self.attitude_rad or (0.0, 0.0, self.scenario.panel_heading_rad)

    @model_validator(mode="after")
    def _sound(self) -> Self:
        scenario, users, base_station = self.scenario, self.users_enu, self.scenario.base_station_enu
        if len(users) != scenario.users:
            raise ValueError(f"users_enu: {len(users)} positions, but scenario.users is {scenario.users}")
        for j, user in enumerate(users):
            if abs(user[2] - scenario.user_height_m) > 1e-6:
                raise ValueError(
                    f"users_enu.{j}: z = {user[2]:g} is not scenario.user_height_m ({scenario.user_height_m:g})"
                )
        _require_apart("position_enu", self.position_enu, "the base station", base_station)
        for j, user in enumerate(users):
            _require_apart(f"users_enu.{j}", user, "the surface (position_enu)", self.position_enu)
            _require_apart(f"users_enu.{j}", user, "the base station", base_station)
        model, height = scenario.path_loss.bs_ris, self.position_enu[2]
        lowest, highest = VEHICLE_HEIGHT_M.get(model, (-math.inf, math.inf))
        if not scenario.extrapolate and not lowest < height <= highest:
            raise ValueError(
                f"position_enu: z = {height:g} is not within ({lowest:g}, {highest:g}], what path_loss.bs_ris {model} "
                "is valid for; set scenario.extrapolate: true to use it all the same"
            )
        self.ris.require_fit(scenario)
        for name in ("trc", "beamforming"):
            if self.ris.by_itself and getattr(self, name) is not None:
                raise ValueError(
                    f"{name}: not allowed with ris {self.ris.mode!r}, which sets it; leave out one of them"
                )
        return self


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


def read_snapshot(fields: object) -> Snapshot:
    """A snapshot from a mapping of fields. Raises SnapshotError."""
    try:
        return Snapshot.model_validate(fields)
    except ValidationError as error:
        raise SnapshotError(one_line(error, Snapshot)) from error


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
    if snapshot.channels is not None:
        channels = _given_channels(scenario, snapshot.channels, channels.transmission)
    trc, beams = _decision(snapshot, channels)

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
        channels={name: _pairs(getattr(channels, name)) for name in GivenChannels.model_fields},
        trc={name: getattr(trc, name).tolist() for name in AMPLITUDES},
        beamforming=_pairs(beams),
    )
    totals = (evaluation.sum_rate_bps, evaluation.fair_rate_bps, evaluation.energy_j, evaluation.reward)
    if not all(map(math.isfinite, (*evaluation.sinr, *totals))):
        raise SnapshotError("scenario: its numbers are too extreme, the results are not finite")
    return evaluation


def _require_apart(name: str, point: Sequence[float], what: str, other: Sequence[float]) -> None:
    distance = math.dist(point, other)
    if distance < CLOSEST_M:
        raise ValueError(f"{name}: {distance:g} m from {what}, must be at least {CLOSEST_M:g} m")


def _given_channels(scenario: Scenario, given: GivenChannels, transmission: Tensor) -> Channels:
    J, M, N = scenario.users, scenario.antennas, scenario.elements
    return Channels(
        direct=_matrix("channels.direct", given.direct, "J x M", J, M),
        bs_ris=_matrix("channels.bs_ris", given.bs_ris, "N x M", N, M),
        ris_user=_matrix("channels.ris_user", given.ris_user, "J x N", J, N),
        transmission=transmission,
    )


def _decision(snapshot: Snapshot, channels: Channels) -> tuple[Coefficients, Tensor]:
    """Coefficients and beams that the snapshot asks for, checked."""
    scenario = snapshot.scenario
    if snapshot.ris.by_itself:
        solution = reference_solution(scenario, snapshot.ris, channels)
        return solution.trc, solution.beamforming
    surface = surface_of(scenario)
    trc = surface.neutral(torch.float64) if snapshot.trc is None else _given_trc(scenario, snapshot.trc)
    match snapshot.beamforming:
        case None | "identity":
            return trc, identity_beamforming(scenario, torch.complex128)
        case "rzf":
            return trc, _zero_forcing(scenario, effective_channel(channels, trc))
        case given:
            beams = _matrix("beamforming", given, "M x J", scenario.antennas, scenario.users)
    try:
        check_beamforming(beams, scenario)
    except BeamformingError as error:
        raise SnapshotError(str(error)) from error
    return trc, beams


def _zero_forcing(scenario: Scenario, channel: Tensor) -> Tensor:
    """Beams [M, J] of equal power p, each along (sigma^2 / p I + sum of conj(g) g^T)^-1 conj(g), for g_j [J, M]."""
    power = scenario.p_max_w if scenario.p_max == "per_user" else scenario.p_max_w / scenario.users
    outer = channel.mH @ channel
    regularised = outer + torch.eye(scenario.antennas, dtype=outer.dtype) * (scenario.noise_w / power)
    beams: Tensor = torch.linalg.solve(regularised, channel.mH)
    sizes = torch.linalg.vector_norm(beams, dim=0)
    return beams * (math.sqrt(power) / torch.where(sizes > 0, sizes, 1.0))


def _given_trc(scenario: Scenario, given: GivenTrc) -> Coefficients:
    lists = {name: getattr(given, name) for name in GivenTrc.model_fields}
    # An `Action` for any surface but the independent one has an empty theta_transmission.
    by_element = {name: torch.tensor(values, dtype=torch.float64) for name, values in lists.items() if values}
    names = set(by_element)
    for name, values in by_element.items():
        if len(values) != scenario.elements:
            raise SnapshotError(f"trc.{name}: {len(values)} values, must be {scenario.elements}, one for each element")
    if names == set(AMPLITUDES):
        return _from_amplitudes(scenario, **by_element)
    if names == set(DIAGONALS):
        return _from_diagonals(scenario, **by_element)
    try:
        if set(ANGLES[scenario.surface]) <= names <= ACTION_FIELDS:
            return _from_angles(scenario, **by_element)
    except TrcError as error:
        raise SnapshotError(f"trc.{error}") from error
    forms = "; or ".join(", ".join(form) for form in (ANGLES[scenario.surface], AMPLITUDES, DIAGONALS))
    raise SnapshotError(f"trc: {', '.join(sorted(names)) or 'nothing'} given; surface {scenario.surface} takes {forms}")


def _from_angles(scenario: Scenario, theta_reflection: Tensor, **others: Tensor) -> Coefficients:
    """As an action has them; what the surface leaves no choice of may be left out."""
    neutral = surface_of(scenario).neutral(torch.float64)
    return read_coefficients(
        scenario,
        theta_reflection,
        others.get("split_angle", neutral.split_angle),
        others.get("sign", neutral.sign),
        others.get("theta_transmission", torch.empty(0)),
    )


def _from_diagonals(scenario: Scenario, reflection: Tensor, transmission: Tensor) -> Coefficients:
    """Phi_R and Phi_T given as pairs of reals [N, 2]."""
    phi_r, phi_t = torch.view_as_complex(reflection), torch.view_as_complex(transmission)
    return _from_amplitudes(scenario, torch.angle(phi_r), torch.angle(phi_t), phi_r.abs(), phi_t.abs())


def _from_amplitudes(
    scenario: Scenario,
    theta_reflection: Tensor,
    theta_transmission: Tensor,
    beta_reflection: Tensor,
    beta_transmission: Tensor,
) -> Coefficients:
    energy = beta_reflection**2 + beta_transmission**2
    if (n := _first((energy - 1.0).abs() > TOLERANCE)) is not None:
        raise SnapshotError(f"trc: |beta_R|^2 + |beta_T|^2 = {energy[n]:g} at element {n}, must be 1")
    split = torch.atan2(beta_reflection, beta_transmission)
    if scenario.surface == "independent":
        trc: Coefficients = IndependentTrc(_wrapped(theta_reflection), split, _wrapped(theta_transmission))
    else:
        apart = _wrapped(theta_transmission - theta_reflection)
        both = (beta_reflection > NOTHING) & (beta_transmission > NOTHING)
        if (n := _first(both & ((apart.abs() - math.pi / 2).abs() > TOLERANCE))) is not None:
            raise SnapshotError(
                f"trc: theta_T - theta_R = {apart[n]:g} rad at element {n}, must be +-pi/2 on surface "
                f"{scenario.surface}"
            )
        sign = torch.where(both & (apart < 0), -1.0, 1.0).to(split)
        only_transmits = beta_reflection <= NOTHING
        theta = torch.where(only_transmits, theta_transmission - math.pi / 2, theta_reflection)
        trc = Trc(_wrapped(theta), split, sign)
    try:
        surface_of(scenario).check(trc)
    except TrcError as error:
        raise SnapshotError(f"trc: as angles, {error}") from error
    return trc


def _wrapped(angle: Tensor) -> Tensor:
    """The same angle in [-pi, pi]."""
    return torch.atan2(torch.sin(angle), torch.cos(angle))


def _first(wrong: Tensor) -> int | None:
    """Index of the first True."""
    return int(wrong.nonzero()[0, 0]) if wrong.any() else None


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


def _matrix(name: str, given: Sequence[Sequence[Sequence[float]]], sizes: str, rows: int, columns: int) -> Tensor:
    """Complex [rows, columns]. Raises SnapshotError unless it has that shape."""
    widths = sorted({len(row) for row in given})
    if len(given) != rows or widths != [columns]:
        shape = f"{len(given)} x {'/'.join(map(str, widths)) or 0}"
        raise SnapshotError(f"{name}: {shape}, must be {sizes} = {rows} x {columns} of [re, im]")
    return torch.view_as_complex(torch.tensor(given, dtype=torch.float64))


def _pairs(matrix: Tensor) -> list[list[list[float]]]:
    pairs: list[list[list[float]]] = torch.view_as_real(matrix).tolist()
    return pairs
