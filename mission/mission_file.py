"""The mission file: YAML in, one frozen and validated `Mission` out, or one line that says what is wrong with it."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from agent.checkpoint import CheckpointError, read_metadata, require_fit
from agent.policy import PolicyConfig
from autopilot_bridge.config import BridgeConfig, Failsafe, Limits, LockstepClock, PacedClock
from autopilot_bridge.energy import Endurance
from autopilot_bridge.fence import Box, Cylinder, Fence, Polygon, Span, Vertices
from autopilot_bridge.signing import read_key
from autopilot_bridge.url import ALLOWED, EXAMPLE, parse_url
from mission.yaml_file import YamlError, read_mapping
from rf_model.config_errors import one_line
from rf_model.ris_control import RisControl
from rf_model.scenario import Scenario, ScenarioError, make_scenario

NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
EMBEDDED = "sitl"
SEVERAL = "vehicles"
"""What a mission of several vehicles has in place of `vehicle`."""
BRIDGE_FIELDS = {
    "autopilot": "vehicle.autopilot",
    "backend": "vehicle.backend",
    "signing_key": "vehicle.signing_key",
    "system_id": "vehicle.system_id",
    "parameters": "vehicle.parameters",
    "require": "vehicle.require",
    "allow_without": "vehicle.allow_without",
    "slot_s": "scenario.slot_s",
    "v_max_mps": "scenario.v_max_mps",
    "start_position_enu": "scenario.start_enu",
    "panel_heading_rad": "scenario.panel_heading_rad",
    "box": "scenario.box_enu",
    "home_distance_m": "limits.home_distance_m",
    "separation_m": "limits.separation_m",
}
"""Where the mission file says what the bridge's config takes from it."""
JOULES_PER_WH = 3600.0
ANY_CONTROL = "127.0.0.1:1"
"""Stands for the control socket while none is open yet."""

Margin = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
Parameters = dict[str, Annotated[float, Field(allow_inf_nan=False)]]


class MissionError(ValueError):
    """A mission that cannot be flown as written; one line naming file, field, value and what is allowed."""


def good_name(name: str) -> str:
    """A name that may be part of a path and of a key expression. Raises ValueError."""
    if not NAME.fullmatch(name):
        raise ValueError(f"{name!r} must be 1 to 32 letters, digits, '_' or '-'")
    return name


class Strict(BaseModel):
    """No value is converted, except whole numbers to floats: `slots: "10"` is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Sitl(Strict):
    """The embedded autopilot's own options."""

    personality: Literal["px4", "arducopter"] = "px4"
    """Which autopilot it plays."""
    parameters: Parameters = {}
    """Parameters it starts with, e.g. PX4's `SIH_KDV: 1.5` for more drag."""


class VehicleSection(Strict):
    """Which vehicle flies and how it is reached."""

    name: str = "star1"
    """Its place on the bus: `star/<name>/...`."""
    autopilot: str = EMBEDDED
    """`sitl` starts the embedded one; a URL reaches any other: udpin, udpout, tcp or serial."""
    backend: Literal["pymavlink", "mavsdk"] = "pymavlink"
    """The client library; MAVSDK flies at the vehicle's own pace at most, and cannot sign."""
    dialect: Literal["auto", "px4", "arducopter"] = "auto"
    """Which autopilot is expected; `auto`: whichever answers."""
    signing_key: Annotated[Path, Field(strict=False)] | None = None
    """MAVLink 2 signing: a file of 32 bytes or 64 hexadecimal digits, read at the start."""
    system_id: Annotated[int, Field(ge=1, le=255)] = 1
    parameters: Parameters = {}
    """Autopilot parameters that the bridge sets for the flight."""
    require: Annotated[tuple[Failsafe, ...], Field(strict=False)] = ()
    """Failsafes of the autopilot that the mission relies on, besides the two without which none flies."""
    allow_without: Annotated[tuple[Failsafe, ...], Field(strict=False)] = ()
    """Failsafes that it may fly without."""
    sitl: Sitl = Sitl()

    @field_validator("name")
    @classmethod
    def _name(cls, name: str) -> str:
        return good_name(name)

    @field_validator("autopilot")
    @classmethod
    def _autopilot(cls, autopilot: str) -> str:
        if autopilot != EMBEDDED:
            try:
                parse_url(autopilot)
            except ValueError:
                raise ValueError(f"{autopilot!r} must be '{EMBEDDED}', {ALLOWED}, {EXAMPLE}") from None
        return autopilot

    @model_validator(mode="after")
    def _can_sign(self) -> Self:
        if self.backend == "mavsdk" and self.signing_key is not None:
            raise ValueError("signing_key: backend 'mavsdk' cannot sign, 'pymavlink' can")
        return self

    @model_validator(mode="after")
    def _sitl_is_used(self) -> Self:
        if self.autopilot != EMBEDDED and self.sitl != Sitl():
            raise ValueError(f"sitl: only allowed with autopilot '{EMBEDDED}', not {self.autopilot!r}")
        return self


class LimitsSection(Limits):
    """What may be asked of the vehicle: speeds, acceleration, and the fence about the scenario's box."""

    model_config = ConfigDict(strict=True)

    fence_sideways_m: Margin = 10.0
    """How far outside the box the fence stands."""
    fence_vertically_m: Margin = 5.0
    home_distance_m: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """How far from home the vehicle may be, in plan."""
    separation_m: Margin = 0.0
    """Distance in plan that other vehicles are never to come nearer than."""


class FenceSection(Strict):
    """The fence, in place of one about the scenario's box: a box, a polygon with its altitudes, or a cylinder."""

    box: Box | None = None
    polygon: Vertices | None = None
    altitude: Span | None = None
    """Of the polygon."""
    cylinder: Cylinder | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        shapes = [name for name in ("box", "polygon", "cylinder") if getattr(self, name) is not None]
        if len(shapes) != 1:
            given = " and ".join(shapes) or "none"
            raise ValueError(
                f"{shapes[-1] if shapes else 'box'}: one of box, polygon, cylinder must be given, not {given}"
            )
        if (self.polygon is None) != (self.altitude is None):
            raise ValueError("altitude: must be given with polygon, and only there")
        return self

    @property
    def shape(self) -> Fence:
        if self.polygon is not None and self.altitude is not None:
            return Polygon(polygon=self.polygon, altitude=self.altitude)
        shape = self.box or self.cylinder
        assert shape is not None
        return shape


class EnergySection(Strict):
    """The pack, and the way home that must always be left in it; the power model is the scenario's."""

    pack_wh: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    margin: Annotated[float, Field(ge=0, le=5, allow_inf_nan=False)] = 0.3
    """This share more than the model says."""
    cruise_mps: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 5.0
    return_altitude_m: Annotated[float, Field(ge=0, le=1000)] = 30.0
    """How the autopilot returns: at this speed, at this height above home or higher."""


class Record(Strict):
    """What is recorded into the run folder."""

    tlog: bool = True
    mcap: bool = True


class Shared(Strict):
    """What a mission says whether one vehicle flies it or several."""

    name: str = "mission"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    scenario: Scenario
    """A preset's name, a mapping of fields with `preset:`, or all fields."""
    slots: Annotated[int, Field(ge=1, le=1_000_000)]
    """Slots to fly; the scenario's when not given."""
    clock: Literal["lockstep", "paced"] = "lockstep"
    speed: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False)] = 1.0
    """Vehicle seconds per wall second; only with `clock: paced`."""
    policy: PolicyConfig = PolicyConfig()
    ris: RisControl = RisControl()
    """Who sets the surface and the beams: a mode's name, or a mapping with `mode:`."""
    limits: LimitsSection = LimitsSection()
    fence: FenceSection | None = None
    """None: the scenario's box and `limits.fence_sideways_m`, `limits.fence_vertically_m` about it."""
    energy: EnergySection | None = None
    """None: nobody looks after the way home but the autopilot's own battery failsafe."""
    tracking: Literal["position", "none"] = "position"
    """How slots are flown: closed on the planned position, or open loop, for comparison."""
    yaw: Literal["panel", "face_users"] = "panel"
    """The panel's normal: at `scenario.panel_heading_rad`, or towards `scenario.user_centre_enu`."""
    restart: Literal["once", "never"] = "once"
    """Whether a radio or agent node that dies is started again."""
    record: Record = Record()
    at_end: Literal["return", "land"] = "return"
    output: Annotated[Path, Field(strict=False)] = Path("runs")
    """Folder for run folders, relative to where the command runs."""

    @model_validator(mode="before")
    @classmethod
    def _resolve(cls, fields: Any) -> Any:  # noqa: ANN401 - whatever the file holds
        """Build the scenario, and let `slots` and the scenario's agree."""
        if not isinstance(fields, dict):
            return fields
        given = fields.get("scenario", "physical_small")
        scenario = given if isinstance(given, Scenario) else _scenario(given)
        slots = fields.get("slots")
        if slots is None:
            slots = scenario.slots
        elif type(slots) is int and slots > 0:
            scenario = scenario.model_copy(update={"slots": slots})
        return fields | {"scenario": scenario, "slots": slots}

    @field_validator("name")
    @classmethod
    def _name(cls, name: str) -> str:
        return good_name(name)

    @model_validator(mode="after")
    def _ris_fits(self) -> Self:
        self.ris.require_fit(self.scenario)
        return self


class Mission(Shared):
    """One vehicle's flight, every field with its value."""

    vehicle: VehicleSection = VehicleSection()

    @model_validator(mode="after")
    def _clock_fits(self) -> Self:
        autopilot = self.vehicle.autopilot
        if self.clock == "lockstep" and autopilot != EMBEDDED:
            raise ValueError(f"clock: 'lockstep' needs vehicle.autopilot '{EMBEDDED}'; {autopilot!r} allows 'paced'")
        if self.clock == "lockstep" and self.speed != 1.0:
            raise ValueError(f"speed: {self.speed:g} is only allowed with clock 'paced', not 'lockstep'")
        if self.vehicle.backend == "mavsdk" and (self.clock == "lockstep" or self.speed > 1.0):
            given = "lockstep" if self.clock == "lockstep" else f"speed {self.speed:g}"
            raise ValueError(f"vehicle.backend: 'mavsdk' needs clock 'paced' at speed 1 at most, not {given}")
        if self.speed > 1.0 and autopilot != EMBEDDED:
            raise ValueError(
                f"speed: {self.speed:g} needs vehicle.autopilot '{EMBEDDED}'; {autopilot!r} allows 1 at most"
            )
        return self

    @property
    def embedded(self) -> bool:
        """Whether the embedded autopilot flies."""
        return self.vehicle.autopilot == EMBEDDED


AnyMission = TypeVar("AnyMission", bound=Shared)


def load(path: Path, vehicle_name: str | None = None, **overrides: object) -> Mission:
    """Read one vehicle's mission; `overrides` replace top-level fields (None leaves a field alone).

    Raises MissionError.
    """
    fields = read_fields(path, Mission, overrides)
    if SEVERAL in fields:
        raise MissionError(
            f"{path}: {SEVERAL}: several fly; allowed here is a mission of one, as in the vehicle's folder"
        )
    if vehicle_name is not None and isinstance(fields.setdefault("vehicle", {}), dict):
        fields["vehicle"]["name"] = vehicle_name
    return validated(path, Mission, fields)


def read_fields(path: Path, model: type[Shared], overrides: Mapping[str, object]) -> dict[str, Any]:
    """What a mission file says, with `overrides` in place, before it is looked at. Raises MissionError."""
    try:
        fields = read_mapping(path, model.model_fields)
    except YamlError as error:
        raise MissionError(str(error)) from error
    fields |= {name: value for name, value in overrides.items() if value is not None}
    fields.setdefault("name", path.stem)
    return fields


def validated(path: Path, model: type[AnyMission], fields: dict[str, Any]) -> AnyMission:
    """The mission that `fields`, read from `path`, describe. Raises MissionError."""
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        raise MissionError(f"{path}: {one_line(error, model)}") from error


def check(mission: Mission) -> None:
    """Refuse, before anything starts, a checkpoint that is missing or does not fit, and volumes that cannot be flown.

    Raises MissionError.
    """
    checkpoint = mission.policy.checkpoint_path
    if checkpoint is not None:
        try:
            require_fit(checkpoint, read_metadata(checkpoint), mission.scenario)
        except CheckpointError as error:
            raise MissionError(f"policy.checkpoint: {error}") from error
    bridge_config(mission, control=ANY_CONTROL)
    if mission.vehicle.signing_key is not None:
        try:
            read_key(mission.vehicle.signing_key)
        except ValueError as error:
            raise MissionError(f"vehicle.signing_key: {error}") from error


def dump(mission: Shared) -> str:
    """The resolved mission as YAML that reads back to the same mission."""
    return yaml.safe_dump(mission.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def bridge_config(
    mission: Mission,
    *,
    autopilot: str | None = None,
    control: str | None = None,
    autostart: bool = False,
    put_back: bool = True,
) -> BridgeConfig:
    """What the bridge node takes from a mission.

    `autopilot` is the URL of the embedded one; `control` is its control socket (HOST:PORT), which lockstep needs;
    `put_back` is false for an autopilot that ends with the flight. Raises MissionError.
    """
    scenario = mission.scenario
    x, y, z = scenario.box_enu
    limits = mission.limits
    url = autopilot or ("udpin://127.0.0.1:14540" if mission.embedded else mission.vehicle.autopilot)
    if mission.clock == "lockstep" and control is None:
        raise MissionError("clock: 'lockstep' needs the autopilot's control socket: give --control HOST:PORT")
    try:
        return BridgeConfig(
            autopilot=url,
            system_id=mission.vehicle.system_id,
            backend=mission.vehicle.backend,
            dialect=mission.vehicle.dialect,
            signing_key=mission.vehicle.signing_key,
            clock=LockstepClock(control=control)
            if mission.clock == "lockstep" and control
            else PacedClock(speed=mission.speed),
            slots=mission.slots,
            slot_s=scenario.slot_s,
            v_max_mps=scenario.v_max_mps,
            start_position_enu=scenario.start_enu,
            panel_heading_rad=scenario.panel_heading_rad,
            box=Box(x=x, y=y, z=z),
            face_enu=scenario.user_centre_enu if mission.yaw == "face_users" else None,
            tracking=mission.tracking,
            fence=_fence(mission),
            home_distance_m=limits.home_distance_m,
            separation_m=limits.separation_m,
            endurance=_endurance(mission),
            limits=Limits(**{name: getattr(limits, name) for name in Limits.model_fields}),
            await_restart=mission.restart == "once",
            at_end=mission.at_end,
            parameters=mission.vehicle.parameters,
            require=mission.vehicle.require,
            allow_without=mission.vehicle.allow_without,
            put_back=put_back,
            autostart=autostart,
        )
    except ValidationError as error:
        line = one_line(error, BridgeConfig)
        name = re.match(r"\w*", line)[0]  # type: ignore[index]  # \w* always matches
        raise MissionError(BRIDGE_FIELDS.get(name, name) + line.removeprefix(name)) from error


def _fence(mission: Mission) -> Fence:
    if mission.fence is not None:
        return mission.fence.shape
    x, y, z = mission.scenario.box_enu
    limits = mission.limits
    return Box(x=x, y=y, z=z).grown(limits.fence_sideways_m, limits.fence_vertically_m)


def _endurance(mission: Mission) -> Endurance | None:
    energy, scenario = mission.energy, mission.scenario
    if energy is None:
        return None
    return Endurance(
        pack_j=energy.pack_wh * JOULES_PER_WH,
        margin=energy.margin,
        cruise_mps=energy.cruise_mps,
        return_altitude_m=energy.return_altitude_m,
        wing=scenario.wing,
        panel=scenario.panel,
    )


def action_deadline_s(mission: Mission) -> float:
    """Vehicle time after a slot's opening when its action is late. Raises MissionError."""
    return bridge_config(mission, control=ANY_CONTROL).deadline_s


def _scenario(given: object) -> Scenario:
    """A preset's name, `{preset: ..., overrides}`, or all fields. Raises ValueError (pydantic shows it)."""
    try:
        return make_scenario(given)
    except ScenarioError as error:
        raise ValueError(f"scenario{'.' if isinstance(given, Mapping) else ': '}{error}") from error
