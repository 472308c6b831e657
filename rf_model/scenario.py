"""The scenario: one frozen, validated config that sets every switch of the radio world.

The paper leaves many things open and prints some that cannot be; each such point is a field here whose default is the
physically sound reading and whose other values are the readings that can be chosen instead. `docs/rf_model.md` maps
equations to functions and switches.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, Self, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from airframe.power import (
    Climb,
    Induced,
    Panel,
    RisArea,
    RotaryWing,
    VPerp,
    hover_induced_velocity,
    hover_power,
    panel_area_m2,
)
from rf_model.config_errors import lines

SPEED_OF_LIGHT_MPS = 299_792_458.0
PRINTED_INDUCED_VELOCITY_MPS = 4.028
GRAVITY_MPS2 = 9.80665
USER_HEIGHT_M = {"tr38901_umi": (1.5, 22.5), "tr38901_uma": (1.5, 13.0)}
"""Validity of TR 38.901 table 7.4.1-1; UMa's effective environment height is random from 13 m on (note 1)."""
VEHICLE_HEIGHT_M = {"tr36777_umi_av": (22.5, 300.0), "tr36777_uma_av": (22.5, 300.0)}
"""Validity of TR 36.777 tables B-1 and B-2; below, it refers to TR 38.901."""
BASE_STATION_HEIGHT_M = {"tr38901_umi": 10.0, "tr38901_uma": 25.0, "tr36777_umi_av": 10.0, "tr36777_uma_av": 25.0}
"""Heights that the tables were made for (TR 38.901 table 7.2-1, TR 36.777 annex A)."""
PATH_LOSS_SETS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "paper": {"bs_user": "paper", "bs_ris": "paper", "ris_user": "paper"},
        "3gpp": {"bs_user": "tr38901_uma", "bs_ris": "tr36777_uma_av", "ris_user": "elevation"},
    }
)
"""Names that stand for a model on each link."""

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Decibel = Annotated[float, Field(ge=-200, le=200)]
Metres = Annotated[float, Field(ge=-1e5, le=1e5)]
WindSpeed = Annotated[float, Field(ge=-50, le=50)]
# YAML has lists, no tuples; what is in them stays strict.
Point = Annotated[tuple[Metres, Metres, Metres], Strict(False)]
Interval = Annotated[tuple[Metres, Metres], Strict(False)]
Box = Annotated[tuple[Interval, Interval, Interval], Strict(False)]
StateExtra: TypeAlias = Literal["users", "time"]


def _in_order(extra: tuple[StateExtra, ...]) -> tuple[StateExtra, ...]:
    if len(set(extra)) < len(extra):
        raise ValueError(f"{', '.join(extra)}: each may be named once")
    return tuple(sorted(extra, reverse=True))  # users, time: the order in the state, whichever they are named in


class ScenarioError(ValueError):
    """A scenario that cannot be; the text names the field, the value and what is allowed, in one line."""


class StrictModel(BaseModel):
    """A frozen config in which no value is converted, except whole numbers to floats: `users: "6"` is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class PathLoss(StrictModel):
    """Path-loss model of each link, because no 3GPP model fits all; a set's name (`paper`, `3gpp`) stands for three."""

    bs_user: Literal["paper", "tr38901_umi", "tr38901_uma"] = "paper"
    """Base station to user, always without line of sight: eq. 8 and 9, or TR 38.901 table 7.4.1-1."""
    bs_ris: Literal["paper", "tr36777_uma_av", "tr36777_umi_av"] = "paper"
    """Base station to surface: always with line of sight (eq. 7), or TR 36.777 tables B-1 and B-2, line of sight drawn
    for every slot."""
    ris_user: Literal["paper", "free_space", "elevation"] = "paper"
    """Surface to user: eq. 7 (and 9), free space, or free space with the excess of urban air-to-ground links (1 dB in
    line of sight, 20 dB without); `Scenario.ris_user` says when the line of sight holds."""

    @model_validator(mode="before")
    @classmethod
    def _named_set(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        if value not in PATH_LOSS_SETS:
            raise ValueError(
                f"{value!r} is not one of the sets {', '.join(PATH_LOSS_SETS)}; "
                "or name a model for each of bs_user, bs_ris, ris_user"
            )
        return PATH_LOSS_SETS[value]


class Scenario(StrictModel):
    """Geometry, radio, surface, users, vehicle and reward of one radio world.

    The defaults are the preset `physical_1km`; take another with `preset(name, **overrides)`, or in a file by its name
    alone or as `preset:` beside the fields that differ.
    """

    SHORTHANDS: ClassVar[tuple[str, ...]] = ("preset",)
    """Keys that stand for fields."""

    # Time
    slots: Annotated[int, Field(ge=1, le=1_000_000)] = 30
    slot_s: Annotated[float, Field(ge=0.1, le=60)] = 1.0
    timing: Literal["pre", "post"] = "pre"
    """`pre`: the rate of a slot is that of the channels at its opening; the move acts on the next slot's. `post`: it is
    that of the channels at the next opening, after the move, which nobody has observed when deciding."""

    # Sizes
    antennas: Annotated[int, Field(ge=1, le=256)] = 4
    """M, a line along y at the base station."""
    users: Annotated[int, Field(ge=1, le=256)] = 4
    """J."""
    reflection_users: Annotated[int, Field(ge=0)] | None = None
    """P, the users that start on the base station's side of the panel (they come first); none given: half of J."""
    rows: Annotated[int, Field(ge=1, le=64)] = 16
    columns: Annotated[int, Field(ge=1, le=64)] = 16
    """The surface has N = rows x columns separately controlled elements."""
    group: Annotated[int, Field(ge=1, le=16)] = 1
    """A controlled element is a square of group x group physical ones, which share its coefficients."""
    mu: Annotated[float, Field(ge=1, le=16)] = 2.0
    """Physical elements are spaced lambda / mu."""

    # Surface
    surface: Literal["coupled", "independent", "dual", "conventional"] = "coupled"
    """`coupled`: STAR-RIS with theta_T = theta_R +- pi/2; `independent`: STAR-RIS with free phases on both sides;
    `dual`: elements in turn only reflect and only transmit; `conventional`: all only reflect."""
    phase_bits: Annotated[int, Field(ge=1, le=3)] | None = None
    """Each phase takes one of 2^bits values; none given: any."""
    element_loss_db: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Loss of an element on whatever it reflects or transmits."""

    # Geometry
    box_enu: Box = ((-100.0, 100.0), (-100.0, 100.0), (30.0, 120.0))
    """Where the vehicle may be: (min, max) of x, y and z [m]."""
    start_enu: Point = (0.0, 0.0, 60.0)
    base_station_enu: Point = (-1000.0, 0.0, 25.0)
    panel_heading_rad: Annotated[float, Field(ge=-math.pi, le=math.pi)] = 0.0
    """Yaw held in flight: the panel's normal is (cos yaw, sin yaw, 0)."""
    attitude: Literal["level", "flown"] = "level"
    """`level`: the panel stands upright; `flown`: it rolls and pitches with the vehicle (yaw always counts)."""
    region: Literal["geometric", "fixed"] = "geometric"
    """Which users the surface serves by transmission: those beyond the panel's plane, or the last J - P, always."""

    # Users
    user_centre_enu: Interval = (0.0, 0.0)
    user_radius_m: Annotated[tuple[NonNegative, Positive], Strict(False)] = (20.0, 100.0)
    user_half_angle_rad: Annotated[float, Field(gt=0, le=math.pi / 2)] = math.pi / 2
    """Users start in two sectors of this ring about the centre, this far to either side of the panel's axis."""
    user_height_m: Annotated[float, Field(ge=0, le=30)] = 1.5
    user_speed_mps: Annotated[float, Field(ge=0, le=50)] = 1.5
    mobility: Literal["random", "directional"] = "random"
    """`random`: own headings, noise 0.5 rad a slot; `directional`: one common start heading, noise 0.05."""
    user_bounds: Literal["sector", "none"] = "sector"
    """`sector`: a user that would leave its sector stays for the slot and turns round; `none`: users walk on."""

    # Radio
    carrier_hz: Annotated[float, Field(ge=0.5e9, le=100e9)] = 5e9
    bandwidth_hz: Positive = 1e6
    p_max_dbm: Annotated[float, Field(ge=-100, le=100)] = 29.0
    p_max: Literal["total", "per_user"] = "total"
    """Constraint 21g: on the sum over users, or on each user's beam."""
    qos_bps: NonNegative = 200e3
    sinr: Literal["power", "amplitude"] = "power"
    """`amplitude` is eq. 13 as printed: amplitudes, interferers added coherently, over a noise power."""
    noise: Literal["thermal", "total", "density"] = "thermal"
    """`thermal`: -174 dBm/Hz and the noise figure; `total`: `noise_dbm` in all; `density`: `noise_dbm` per hertz."""
    noise_figure_db: Annotated[float, Field(ge=0, le=50)] = 7.0
    noise_dbm: Decibel = -95.0
    """The paper's table, read by `noise: total` and `density`."""

    # Links
    path_loss: PathLoss = PathLoss()
    extrapolate: bool = False
    """Use path-loss models also for heights that they are not valid for."""
    nlos_height: Literal["user", "uav"] = "user"
    """z_s of eq. 9: the receiving user's height, or the vehicle's, as printed."""
    kappa: Annotated[float, Field(ge=0, le=1e6)] = 5.0
    """Rician factor, linear."""
    ris_user: Literal["p_los", "nlos", "los"] = "p_los"
    """Surface to user: line of sight drawn by its probability at the elevation, never, or always."""
    direct: Literal["on", "blocked"] = "on"
    direct_extra_db: Decibel = 40.0
    """Obstruction of the direct link."""
    ris_gain_db: Decibel = 18.0
    """Element gain of the surface, once on the cascade."""
    bs_gain_db: Decibel = 0.0
    """Sector gain of the base station, on both its links."""
    array: Literal["planar", "literal"] = "planar"
    """Phases of the surface by direction cosines in its frame, or eq. 6 as printed."""

    # Channel state information
    csi_error_variance: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Variance of the estimation error of each channel coefficient, relative to its link's mean power in the slot."""
    csi_delay_slots: Annotated[int, Field(ge=0, le=1000)] = 0
    """Age of the channels that the agent observes (in the first slots: those of slot 0)."""

    # Vehicle
    motion: Literal["spherical", "cartesian"] = "spherical"
    """How a policy's move decodes: (distance, elevation, azimuth), or a vector clipped in its norm."""
    v_max_mps: Annotated[float, Field(gt=0, le=100)] = 10.0
    climb_up_mps: Annotated[float, Field(gt=0, le=100)] | None = 3.0
    climb_down_mps: Annotated[float, Field(gt=0, le=100)] | None = 1.5
    """None: limited by `v_max_mps` only."""
    weight_n: Annotated[float, Field(gt=0, le=1e4)] = 25.0
    induced: Induced = "sqrt"
    induced_velocity: Literal["consistent", "paper"] = "consistent"
    """v_i: sqrt(W / (2 rho A)), or the 4.028 m/s printed."""
    climb: Climb = "nonnegative"
    v_perp: VPerp = "normal"
    ris_area: RisArea = "paper"
    drag_coefficient: NonNegative = 2.1
    ris_mass_kg_per_m2: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Mass of the panel, for each square metre of elements, which the vehicle carries on top of `weight_n`."""
    wind_enu: Annotated[tuple[WindSpeed, WindSpeed, WindSpeed], Strict(False)] = (0.0, 0.0, 0.0)
    """Velocity of the air over ground [m/s]; power is that of the velocity through the air."""

    # Reward and observation
    alpha: NonNegative = 1.0
    """Weight of the fair rate [1 / (Mbit/s)]."""
    beta: NonNegative = 0.1
    """Weight of the power, relative to hovering without a panel."""
    state_norm: Literal["link_reference", "raw"] = "link_reference"
    """Observations divide each link by the root of its mean gain at the start and positions by the box, or nothing."""
    state_extra: Annotated[tuple[StateExtra, ...], Strict(False), AfterValidator(_in_order)] = ()
    """What is observed beyond eq. 22: where the users are as seen from the vehicle, and the part of `slots` gone by."""

    @model_validator(mode="before")
    @classmethod
    def _from_preset(cls, value: object) -> object:
        if isinstance(value, str):
            if value not in PRESETS:
                raise ValueError(f"{value!r} is not one of {', '.join(PRESETS)}")
            return PRESETS[value].model_dump()
        if not isinstance(value, Mapping):
            raise ValueError(f"{value!r} must be a preset's name or a mapping of scenario fields")
        if "preset" not in value:
            return value
        fields = dict(value)
        name = fields.pop("preset")
        if not isinstance(name, str) or name not in PRESETS:
            raise ValueError(f"preset: {name!r} is not one of {', '.join(PRESETS)}")
        of_preset = PRESETS[name].model_dump()
        if isinstance(fields.get("path_loss"), Mapping):
            fields["path_loss"] = of_preset["path_loss"] | dict(fields["path_loss"])
        return of_preset | fields

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for axis, (low, high) in zip("xyz", self.box_enu, strict=True):
            if not low < high:
                raise ValueError(f"box_enu: {axis} from {low:g} to {high:g} is empty; the minimum must come first")
        for axis, value, (low, high) in zip("xyz", self.start_enu, self.box_enu, strict=True):
            if not low <= value <= high:
                raise ValueError(f"start_enu: {axis} = {value:g} is outside box_enu ({low:g} to {high:g})")
        if self.box_enu[2][0] <= self.user_height_m:
            raise ValueError(
                f"box_enu: lowest z {self.box_enu[2][0]:g} must be above user_height_m ({self.user_height_m:g})"
            )
        if math.dist(self.base_station_enu, self.start_enu) < 1.0:
            raise ValueError("base_station_enu: must be at least 1 m from start_enu")
        if not self.user_radius_m[0] < self.user_radius_m[1]:
            inner, outer = self.user_radius_m
            raise ValueError(
                f"user_radius_m: {inner:g} to {outer:g} is empty; the inner radius must be the smaller one"
            )
        if self.reflection_users is not None and self.reflection_users > self.users:
            raise ValueError(f"reflection_users: {self.reflection_users} is more than users ({self.users})")
        if self.surface == "dual" and self.elements < 2:
            raise ValueError("surface: dual needs at least 2 elements, one for each side")
        if not self.extrapolate:
            self._require_valid_heights()
        return self

    def _require_valid_heights(self) -> None:
        but = "set extrapolate: true to use it all the same"
        bs_user, bs_ris = self.path_loss.bs_user, self.path_loss.bs_ris
        lowest, highest = USER_HEIGHT_M.get(bs_user, (-math.inf, math.inf))
        if not lowest <= self.user_height_m <= highest:
            raise ValueError(
                f"user_height_m: {self.user_height_m:g} is outside {lowest:g} to {highest:g}, what "
                f"path_loss.bs_user {bs_user} is valid for; {but}"
            )
        lowest, highest = VEHICLE_HEIGHT_M.get(bs_ris, (-math.inf, math.inf))
        low, high = self.box_enu[2]
        if not (lowest < low and high <= highest):
            raise ValueError(
                f"box_enu: z from {low:g} to {high:g} is not within ({lowest:g}, {highest:g}], what "
                f"path_loss.bs_ris {bs_ris} is valid for; {but}"
            )
        for link, model in (("bs_user", bs_user), ("bs_ris", bs_ris)):
            made_for = BASE_STATION_HEIGHT_M.get(model)
            if made_for is not None and self.base_station_enu[2] != made_for:
                raise ValueError(
                    f"base_station_enu: z = {self.base_station_enu[2]:g} is not {made_for:g}, what "
                    f"path_loss.{link} {model} is valid for; {but}"
                )

    @property
    def elements(self) -> int:
        """N, the controlled elements of the surface."""
        return self.rows * self.columns

    @property
    def reflection_count(self) -> int:
        """P, the users that start on the reflection side."""
        return self.users // 2 if self.reflection_users is None else self.reflection_users

    @cached_property
    def p_max_w(self) -> float:
        """P_max [W]."""
        return dbm_to_w(self.p_max_dbm)

    @cached_property
    def noise_w(self) -> float:
        """sigma^2 over the whole band [W]."""
        in_band_db = 10.0 * math.log10(self.bandwidth_hz)
        if self.noise == "thermal":
            return dbm_to_w(-174.0 + self.noise_figure_db + in_band_db)
        return dbm_to_w(self.noise_dbm + (in_band_db if self.noise == "density" else 0.0))

    @cached_property
    def wavelength_m(self) -> float:
        """lambda [m]."""
        return SPEED_OF_LIGHT_MPS / self.carrier_hz

    @cached_property
    def wing(self) -> RotaryWing:
        """The vehicle's rotary wing with this scenario's readings of eq. 16, carrying the panel's weight."""
        return self._wing(self.weight_n + self.ris_mass_kg * GRAVITY_MPS2)

    def _wing(self, weight_n: float) -> RotaryWing:
        paper = RotaryWing()
        consistent = hover_induced_velocity(weight_n, paper.air_density, paper.disc_area_m2)
        return paper._replace(
            weight_n=weight_n,
            induced=self.induced,
            induced_velocity_mps=(
                consistent if self.induced_velocity == "consistent" else PRINTED_INDUCED_VELOCITY_MPS
            ),
            climb=self.climb,
        )

    @property
    def ris_mass_kg(self) -> float:
        """Mass of the panel: every element has its square of the spacing, whatever `ris_area` says of the drag."""
        rows, columns = self.rows * self.group, self.columns * self.group
        return self.ris_mass_kg_per_m2 * panel_area_m2(rows, columns, self.wavelength_m / self.mu, "full")

    @cached_property
    def panel(self) -> Panel:
        """The surface as the air sees it: all physical elements (eq. 17)."""
        area = panel_area_m2(
            self.rows * self.group, self.columns * self.group, self.wavelength_m / self.mu, self.ris_area
        )
        return Panel(area_m2=area, drag_coefficient=self.drag_coefficient, v_perp=self.v_perp)

    @cached_property
    def hover_power_w(self) -> float:
        """P_hover [W] without a panel, which the reward measures power by."""
        return hover_power(self._wing(self.weight_n))


def dbm_to_w(power_dbm: float) -> float:
    """Power in watts."""
    return float(10.0 ** ((power_dbm - 30.0) / 10.0))


def make_scenario(fields: object) -> Scenario:
    """A scenario from a preset's name or a mapping of fields, with `preset` or defaults for those unnamed.

    Raises ScenarioError with a one-line text.
    """
    try:
        return Scenario.model_validate(fields)
    except ValidationError as error:
        raise ScenarioError("; ".join(lines(error, Scenario))) from error


_LITERAL: dict[str, Any] = {
    "timing": "post",
    "rows": 4,
    "columns": 4,
    "region": "fixed",
    "p_max": "per_user",
    "sinr": "amplitude",
    "noise": "density",
    "nlos_height": "uav",
    "ris_user": "nlos",
    "direct_extra_db": 0.0,
    "ris_gain_db": 0.0,
    "array": "literal",
    "climb_up_mps": None,
    "climb_down_mps": None,
    "induced": "paper",
    "induced_velocity": "paper",
    "climb": "signed",
    "v_perp": "speed",
}

_SMALL: dict[str, Any] = {"rows": 4, "columns": 4, "group": 4, "ris_gain_db": 42.0, "motion": "cartesian"}

_PROTOTYPE: dict[str, Any] = {
    **_SMALL,
    "group": 1,
    "motion": "spherical",
    "ris_user": "los",
    "region": "fixed",
    "user_centre_enu": (0.0, 50.0),
    "user_half_angle_rad": 0.45 * math.pi,
    "user_bounds": "none",
    "mobility": "directional",
    "climb_up_mps": None,
    "climb_down_mps": None,
    "induced_velocity": "paper",
    "climb": "signed",
}

PRESETS: Mapping[str, Scenario] = MappingProxyType(
    {
        "paper_literal": Scenario(**_LITERAL),
        "physical_1km": Scenario(),
        "physical_small": Scenario(**_SMALL),
        "prototype_s4": Scenario(**_PROTOTYPE),
    }
)
"""`paper_literal`: near the paper as printed (the surface hardly matters in it). `physical_1km`: sound physics with 256
elements. `physical_small`: its cheap twin, 16 groups of 4 x 4, for training and the demo. `prototype_s4`: the scenario
of the design's prototype figures."""


def preset(name: str, **overrides: Any) -> Scenario:  # noqa: ANN401 - any field, validated by the scenario
    """A preset with some fields replaced.

    Raises ScenarioError, in one line, for an unknown preset or field and for values that are not allowed.
    """
    return make_scenario({"preset": name, **overrides})
