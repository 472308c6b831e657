"""The mission file: YAML in, one frozen and validated `Mission` out, or one line that says what is wrong with it."""

import re
from collections.abc import Hashable, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from agent.checkpoint import CheckpointError, read_metadata, require_fit
from agent.policy import PolicyConfig
from autopilot_bridge.config import Box, BridgeConfig, Limits, LockstepClock, PacedClock, udpin_address
from rf_model.scenario import PRESETS, Scenario, ScenarioError, make_scenario, preset

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

VALUE_MAX = 80
"""Longer values are not shown in an error."""

Margin = Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)]
Parameters = dict[str, Annotated[float, Field(allow_inf_nan=False)]]


class MissionError(ValueError):
    """A mission that cannot be flown as written; one line naming file, field, value and what is allowed."""


class _Loader(yaml.SafeLoader):
    """YAML in which a key given twice is a mistake, and `1e3` a number as in YAML 1.2."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                line = key.start_mark.line + 1
                if key.value in lines:
                    raise MissionError(f"{key.value}: given twice, in lines {lines[key.value]} and {line}")
                lines[key.value] = line
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


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

    @property
    def embedded(self) -> bool:
        """Whether the embedded autopilot flies."""
        return self.vehicle.autopilot == EMBEDDED


def load(path: Path, vehicle_name: str | None = None, **overrides: object) -> Mission:
    """Read a mission file; `overrides` replace top-level fields (None leaves a field alone). Raises MissionError."""
    try:
        fields = yaml.load(path.read_text(encoding="utf-8"), _Loader)
    except MissionError as error:
        raise MissionError(f"{path}: {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise MissionError(f"{path}: {why}") from error
    except yaml.YAMLError as error:
        raise MissionError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(fields, dict):
        raise MissionError(f"{path}: must hold a mapping of fields ({', '.join(Mission.model_fields)})")
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


def one_line(error: ValidationError, model: type[BaseModel]) -> str:
    """The first thing that is wrong: field, value, what is allowed; and how many more there are."""
    details = error.errors()
    more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
    return f"{_line(details[0], model)}{more}"


def _line(detail: ErrorDetails, model: type[BaseModel]) -> str:
    field = ".".join(str(part) for part in detail["loc"])
    if detail["type"] == "extra_forbidden":
        return f"{field}: unknown key, allowed are {', '.join(_fields_at(model, detail['loc'][:-1]))}"
    if detail["type"] == "missing":
        return f"{field}: missing"
    message = detail["msg"].removeprefix("Value error, ")
    if detail["type"] == "value_error":
        # Validators of whole sections begin with the name of the field that they mean.
        of_section = isinstance(detail["input"], Mapping | BaseModel)
        return f"{field}{'.' if field and of_section else ': ' if field else ''}{message}"
    value = repr(detail["input"])
    if len(value) > VALUE_MAX:
        value = "..."
    return f"{field}: {value} is not allowed: {message[:1].lower()}{message[1:]}"


def _fields_at(model: type[BaseModel], parents: tuple[int | str, ...]) -> list[str]:
    for part in parents:
        inner = model.model_fields[str(part)].annotation if str(part) in model.model_fields else None
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            model = inner
    return list(model.model_fields)


def _scenario(given: object) -> Scenario:
    """A preset's name, `{preset: ..., overrides}`, or all fields. Raises ValueError (pydantic shows it)."""
    if isinstance(given, str):
        try:
            return preset(given)
        except ScenarioError as error:
            raise ValueError(f"scenario: {str(error).removeprefix('preset: ')}") from error
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise ValueError(f"scenario: {given!r} must be a preset's name or a mapping of scenario fields")
    fields = dict(given)
    known = ["preset", *Scenario.model_fields]
    for name in fields:
        if name not in known:
            raise ValueError(f"scenario.{name}: unknown key, {_nearest(name, known)}")
    try:
        if "preset" not in fields:
            return make_scenario(fields)
        name = fields.pop("preset")
        if not isinstance(name, str):
            raise ScenarioError(f"preset: {name!r} is not one of {', '.join(PRESETS)}")
        return preset(name, **fields)
    except ScenarioError as error:
        raise ValueError(f"scenario.{error}") from error


def _nearest(name: str, known: list[str]) -> str:
    """What somebody who wrote `name` may have meant; all there is when nothing is like it."""
    near = get_close_matches(name, known)
    return f"did you mean {' or '.join(near)}?" if near else f"allowed are {', '.join(known)}"
