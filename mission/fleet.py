"""Missions of several vehicles: `vehicles:` in place of `vehicle:`, each flown by a bridge of its own."""

import math
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from agent.policy import PolicyConfig
from autopilot_bridge.neighbours import usual_age_s
from autopilot_bridge.separation import Segment, nearest_points
from mission import mission_file
from mission.mission_file import (
    EMBEDDED,
    SEVERAL,
    Mission,
    MissionError,
    Shared,
    VehicleSection,
    read_fields,
    validated,
)
from rf_model.config_errors import one_line
from rf_model.scenario import ScenarioError, make_scenario
from rf_model.seeding import vehicle_seeds

VEHICLES_MAX = 100
RESERVED = ("logs",)
"""Names that the run folder needs itself."""


class FleetVehicle(VehicleSection):
    """One vehicle of several: the vehicle section, and what it alone has of the mission's fields."""

    start_enu: Annotated[tuple[float, float, float], Field(strict=False)] | None = None
    """In place of the scenario's, about this vehicle's own home."""
    policy: PolicyConfig | None = None
    """In place of the mission's."""


class Fleet(Shared):
    """Several vehicles' flights at the same time, every field with its value.

    Names that are not given are star1, star2, ...; system ids of embedded ones 1, 2, ...
    """

    clock: Literal["paced"] = "paced"
    vehicles: Annotated[tuple[FleetVehicle, ...], Field(strict=False)]
    vehicles_spacing_m: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] = 10.0
    """The embedded ones stand in a line, in the order of the list, each so far east of the one before."""

    @model_validator(mode="before")
    @classmethod
    def _number(cls, fields: Any) -> Any:  # noqa: ANN401 - whatever the file holds
        """Names and system ids by the place in the list."""
        if not isinstance(fields, dict):
            return fields
        if "vehicle" in fields:
            raise ValueError(f"{SEVERAL}: in place of vehicle, not beside it")
        if fields.get("clock") == "lockstep":
            raise ValueError("clock: 'lockstep' is for one vehicle, whose bridge owns the clock; several allow 'paced'")
        given = fields.get(SEVERAL)
        if not isinstance(given, list):
            return fields
        if not 2 <= len(given) <= VEHICLES_MAX:
            raise ValueError(f"{SEVERAL}: {len(given)} given, 2 to {VEHICLES_MAX} are allowed; one alone is `vehicle`")
        return fields | {SEVERAL: [_numbered(place, vehicle) for place, vehicle in enumerate(given, start=1)]}

    @model_validator(mode="after")
    def _told_apart(self) -> Self:
        self._once("name", [vehicle.name for vehicle in self.vehicles])
        self._once("system_id", [v.system_id if v.autopilot == EMBEDDED else None for v in self.vehicles])
        self._once("autopilot", [v.autopilot if v.autopilot != EMBEDDED else None for v in self.vehicles])
        for place, vehicle in enumerate(self.vehicles):
            if vehicle.name in RESERVED:
                raise ValueError(f"{SEVERAL}.{place}.name: {vehicle.name!r} is a name of the run folder's own")
        return self

    @model_validator(mode="after")
    def _each_can_fly(self) -> Self:
        assert self.missions
        return self

    @model_validator(mode="after")
    def _kept_apart(self) -> Self:
        """Homes, starts and the ways between them, where it is known how the vehicles stand."""
        if self.limits.separation_m == 0:
            return self
        apart_m = self.limits.separation_m + 2 * usual_age_s(self.speed) * self.limits.horizontal_mps
        embedded = [place for place, vehicle in enumerate(self.vehicles) if vehicle.autopilot == EMBEDDED]
        ways = {place: _way(self.missions[place], nth * self.vehicles_spacing_m) for nth, place in enumerate(embedded)}
        for number, place in enumerate(embedded):
            for before in embedded[:number]:
                ours, theirs = nearest_points(ways[place], ways[before])
                gap_m = math.dist(ours, theirs)
                if gap_m <= apart_m:
                    raise ValueError(
                        f"{SEVERAL}.{place}: the way from home to start comes within {gap_m:.1f} m of that of "
                        f"{self.vehicles[before].name!r}; limits.separation_m {self.limits.separation_m:g} at up to "
                        f"{self.limits.horizontal_mps:g} m/s and speed {self.speed:g} needs more than {apart_m:.1f} "
                        f"(vehicles_spacing_m is {self.vehicles_spacing_m:g})"
                    )
        return self

    @cached_property
    def missions(self) -> tuple[Mission, ...]:
        """What each vehicle flies, resolved for it alone."""
        seeds = vehicle_seeds(self.seed, [vehicle.name for vehicle in self.vehicles])
        return tuple(self._mission(place, seeds[vehicle.name]) for place, vehicle in enumerate(self.vehicles))

    def _mission(self, place: int, seed: int) -> Mission:
        """Raises ValueError."""
        vehicle = self.vehicles[place]
        here = f"{SEVERAL}.{place}"
        shared = {name: getattr(self, name) for name in Shared.model_fields}
        own: dict[str, object] = {"seed": seed}
        if vehicle.policy is not None:
            own["policy"] = vehicle.policy
        if vehicle.start_enu is not None:
            fields = self.scenario.model_dump(mode="json") | {"start_enu": list(vehicle.start_enu)}
            try:
                own["scenario"] = make_scenario(fields)
            except ScenarioError as error:
                raise ValueError(f"{here}.{error}") from error
        own["vehicle"] = VehicleSection(**{name: getattr(vehicle, name) for name in VehicleSection.model_fields})
        try:
            return Mission.model_validate(shared | own)
        except ValidationError as error:
            raise ValueError(one_line(error, Mission).replace("vehicle.", f"{here}.", 1)) from error

    def _once(self, field: str, values: Sequence[object]) -> None:
        for place, value in enumerate(values):
            if value is not None and value in values[:place]:
                first = self.vehicles[values.index(value)].name
                raise ValueError(
                    f"{SEVERAL}.{place}.{field}: {value!r} is that of {first!r} already; each needs its own"
                )


def load(path: Path, **overrides: object) -> Mission | Fleet:
    """Read a mission file of one vehicle or several; `overrides` as `mission_file.load`. Raises MissionError."""
    fields = read_fields(path, Mission, overrides)
    return validated(path, Fleet, fields) if SEVERAL in fields else validated(path, Mission, fields)


def missions(flown: Mission | Fleet) -> tuple[Mission, ...]:
    """What each vehicle flies."""
    return flown.missions if isinstance(flown, Fleet) else (flown,)


def served(path: Path, names: Sequence[str] = ()) -> tuple[Mission, ...]:
    """The missions of vehicles `names`, or of all: what a node that serves several takes.

    A file of one vehicle may be taken for others too: the first has the mission's seed, every other one a seed that
    follows from it and its name. Raises MissionError.
    """
    flown = load(path)
    if isinstance(flown, Fleet):
        by_name = {mission.vehicle.name: mission for mission in flown.missions}
        for name in names:
            if name not in by_name:
                raise MissionError(f"{path}: no vehicle {name!r}; allowed are {', '.join(by_name)}")
        return tuple(by_name[name] for name in names or by_name)
    if not names:
        return (flown,)
    seeds = vehicle_seeds(flown.seed, names)
    return tuple(
        flown.model_copy(update={"seed": seeds[name], "vehicle": flown.vehicle.model_copy(update={"name": name})})
        for name in names
    )


def one_of(path: Path, name: str | None) -> tuple[Mission, tuple[str, ...]]:
    """The mission of vehicle `name`, or of the only one, and the names of the others: what a bridge takes.

    Raises MissionError.
    """
    flown = load(path)
    if name is None and isinstance(flown, Fleet):
        names = ", ".join(vehicle.name for vehicle in flown.vehicles)
        raise MissionError(f"{path}: a bridge flies one vehicle: give --vehicle, one of {names}")
    (mission,) = served(path, [name] if name is not None else [])
    others = [one.vehicle.name for one in missions(flown) if one.vehicle.name != mission.vehicle.name]
    return mission, tuple(others) if isinstance(flown, Fleet) else ()


def check(flown: Mission | Fleet) -> None:
    """`mission_file.check` of each vehicle's mission. Raises MissionError."""
    if isinstance(flown, Mission):
        mission_file.check(flown)
        return
    for place, mission in enumerate(flown.missions):
        try:
            mission_file.check(mission)
        except MissionError as error:
            line, here = str(error), f"{SEVERAL}.{place}."
            if line.startswith("vehicle."):
                line = here + line.removeprefix("vehicle.")
            elif line.startswith("policy.") and flown.vehicles[place].policy is not None:
                line = here + line
            raise MissionError(line) from error


def _numbered(place: int, vehicle: object) -> object:
    if not isinstance(vehicle, dict):
        return vehicle
    embedded = vehicle.get("autopilot", EMBEDDED) == EMBEDDED
    return {"name": f"star{place}", **({"system_id": place} if embedded else {})} | vehicle


def _way(mission: Mission, home_m: float) -> Segment:
    """From home, so far east, to the start, in plan."""
    east, north, _ = mission.scenario.start_enu
    return (home_m, 0.0), (home_m + east, north)
