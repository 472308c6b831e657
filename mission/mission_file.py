"""The mission file: YAML in, one frozen and validated `Mission` out, or one line that says what is wrong with it."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from agent.checkpoint import CheckpointError, read_metadata, require_fit
from agent.policy import PolicyConfig
from autopilot_bridge.config import Box, BridgeConfig, Limits, LockstepClock, PacedClock, udpin_address
from mission.yaml_file import YamlError, read_mapping
from rf_model.config_errors import one_line
from rf_model.ris_control import RisControl
from rf_model.scenario import Scenario, ScenarioError, make_scenario

NAME = re.compile(r"[A-Za-z0-9_-]{1,32}")
EMBEDDED = "sitl"
BRIDGE_FIELDS = {
    "autopilot": "vehicle.autopilot",
    "system_id": "vehicle.system_id",
    "parameters": "vehicle.parameters",
    "slot_s": "scenario.slot_s",
    "v_max_mps": "scenario.v_max_mps",
    "start_position_enu": "scenario.start_enu",
    "panel_heading_rad": "scenario.panel_heading_rad",
    "box": "scenario.box_enu",
}
"""Where the mission file says what the bridge's config takes from it."""
ANY_CONTROL = "127.0.0.1:1"
"""Stands for the control socket while none is open yet."""

Margin = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
Parameters = dict[str, Annotated[float, Field(allow_inf_nan=False)]]


class MissionError(ValueError):
    """A mission that cannot be flown as written; one line naming file, field, value and what is allowed."""


class _Strict(BaseModel):
    """No value is converted, except whole numbers to floats: `slots: "10"` is a mistake."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Sitl(_Strict):
    """The embedded autopilot's own options."""

    parameters: Parameters = {}
    """PX4 parameters it starts with, e.g. `SIH_KDV: 1.5` for more drag."""


class VehicleSection(_Strict):
    """Which vehicle flies and how it is reached."""

    name: str = "star1"
    """Its place on the bus: `star/<name>/...`."""
    autopilot: str = EMBEDDED
    """`sitl` starts the embedded one; `udpin://HOST:PORT` waits there for any other."""
    backend: Literal["pymavlink"] = "pymavlink"
    dialect: Literal["px4"] = "px4"
    system_id: Annotated[int, Field(ge=1, le=255)] = 1
    parameters: Parameters = {}
    """Autopilot parameters that the bridge sets at preflight."""
    sitl: Sitl = Sitl()

    @field_validator("name")
    @classmethod
    def _name(cls, name: str) -> str:
        if not NAME.fullmatch(name):
            raise ValueError(f"{name!r} must be 1 to 32 letters, digits, '_' or '-'")
        return name

    @field_validator("autopilot")
    @classmethod
    def _autopilot(cls, autopilot: str) -> str:
        if autopilot != EMBEDDED:
            try:
                udpin_address(autopilot)
            except ValueError:
                raise ValueError(
                    f"{autopilot!r} must be '{EMBEDDED}' or udpin://HOST:PORT, e.g. udpin://127.0.0.1:14540"
                ) from None
        return autopilot

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


class Record(_Strict):
    """What is recorded into the run folder."""

    tlog: bool = True
    mcap: bool = True


class Mission(_Strict):
    """One flight, every field with its value."""

    name: str = "mission"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    scenario: Scenario
    """A preset's name, a mapping of fields with `preset:`, or all fields."""
    slots: Annotated[int, Field(ge=1, le=1_000_000)]
    """Slots to fly; the scenario's when not given."""
    vehicle: VehicleSection = VehicleSection()
    clock: Literal["lockstep", "paced"] = "lockstep"
    speed: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False)] = 1.0
    """Vehicle seconds per wall second; only with `clock: paced`."""
    policy: PolicyConfig = PolicyConfig()
    ris: RisControl = RisControl()
    """Who sets the surface and the beams: a mode's name, or a mapping with `mode:`."""
    limits: LimitsSection = LimitsSection()
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
        if not NAME.fullmatch(name):
            raise ValueError(f"{name!r} must be 1 to 32 letters, digits, '_' or '-'")
        return name

    @model_validator(mode="after")
    def _clock_fits(self) -> Self:
        autopilot = self.vehicle.autopilot
        if self.clock == "lockstep" and autopilot != EMBEDDED:
            raise ValueError(f"clock: 'lockstep' needs vehicle.autopilot '{EMBEDDED}'; {autopilot!r} allows 'paced'")
        if self.clock == "lockstep" and self.speed != 1.0:
            raise ValueError(f"speed: {self.speed:g} is only allowed with clock 'paced', not 'lockstep'")
        if self.speed > 1.0 and autopilot != EMBEDDED:
            raise ValueError(
                f"speed: {self.speed:g} needs vehicle.autopilot '{EMBEDDED}'; {autopilot!r} allows 1 at most"
            )
        return self

    @model_validator(mode="after")
    def _ris_fits(self) -> Self:
        self.ris.require_fit(self.scenario)
        return self

    @property
    def embedded(self) -> bool:
        """Whether the embedded autopilot flies."""
        return self.vehicle.autopilot == EMBEDDED


def load(path: Path, vehicle_name: str | None = None, **overrides: object) -> Mission:
    """Read a mission file; `overrides` replace top-level fields (None leaves a field alone). Raises MissionError."""
    try:
        fields = read_mapping(path, Mission.model_fields)
    except YamlError as error:
        raise MissionError(str(error)) from error
    fields |= {name: value for name, value in overrides.items() if value is not None}
    fields.setdefault("name", path.stem)
    if vehicle_name is not None and isinstance(fields.setdefault("vehicle", {}), dict):
        fields["vehicle"]["name"] = vehicle_name
    try:
        return Mission.model_validate(fields)
    except ValidationError as error:
        raise MissionError(f"{path}: {one_line(error, Mission)}") from error


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


def dump(mission: Mission) -> str:
    """The resolved mission as YAML that `load` reads back to the same mission."""
    return yaml.safe_dump(mission.model_dump(mode="json"), sort_keys=False, allow_unicode=True)


def bridge_config(
    mission: Mission, *, autopilot: str | None = None, control: str | None = None, autostart: bool = False
) -> BridgeConfig:
    """What the bridge node takes from a mission.

    `autopilot` is the URL of the embedded one; `control` is its control socket (HOST:PORT), which lockstep needs.
    Raises MissionError.
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
            dialect=mission.vehicle.dialect,
            clock=LockstepClock(control=control)
            if mission.clock == "lockstep" and control
            else PacedClock(speed=mission.speed),
            slots=mission.slots,
            slot_s=scenario.slot_s,
            v_max_mps=scenario.v_max_mps,
            start_position_enu=scenario.start_enu,
            panel_heading_rad=scenario.panel_heading_rad,
            box=Box(x=x, y=y, z=z),
            fence=Box(x=x, y=y, z=z).grown(limits.fence_sideways_m, limits.fence_vertically_m),
            limits=Limits(**{name: getattr(limits, name) for name in Limits.model_fields}),
            await_restart=mission.restart == "once",
            at_end=mission.at_end,
            parameters=mission.vehicle.parameters,
            autostart=autostart,
        )
    except ValidationError as error:
        line = one_line(error, BridgeConfig)
        name = re.match(r"\w*", line)[0]  # type: ignore[index]  # \w* always matches
        raise MissionError(BRIDGE_FIELDS.get(name, name) + line.removeprefix(name)) from error


def action_deadline_s(mission: Mission) -> float:
    """Vehicle time after a slot's opening when its action is late. Raises MissionError."""
    return bridge_config(mission, control=ANY_CONTROL).deadline_s


def _scenario(given: object) -> Scenario:
    """A preset's name, `{preset: ..., overrides}`, or all fields. Raises ValueError (pydantic shows it)."""
    try:
        return make_scenario(given)
    except ScenarioError as error:
        raise ValueError(f"scenario{'.' if isinstance(given, Mapping) else ': '}{error}") from error
