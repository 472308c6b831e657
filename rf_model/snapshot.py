"""One slot on its own, as somebody writes it down: positions, channels, coefficients and beams, validated.

Fields are named as in the bus messages, so that a recorded `SlotOpened`, `ChannelState` or `Action` can be pasted;
complex numbers are [re, im]. `rf_model.evaluation` says what it is worth.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, Strict, Tag, ValidationError, model_validator

from rf_model.complex_pairs import Matrix
from rf_model.config_errors import ALTERNATIVE, one_line
from rf_model.geometry import CLOSEST_M
from rf_model.given_trc import Angle, GivenTrc
from rf_model.ris_control import RisControl
from rf_model.scenario import VEHICLE_HEIGHT_M, Point, Scenario, ScenarioError, StrictModel


class SnapshotError(ScenarioError):
    """A snapshot that cannot be; the text names the field, the value and what is allowed, in one line."""


Speed = Annotated[float, Field(ge=-1000, le=1000)]
Beams = Annotated[
    Annotated[Literal["identity", "rzf"], Tag(f"{ALTERNATIVE}name")] | Annotated[Matrix, Tag(f"{ALTERNATIVE}matrix")],
    Discriminator(lambda value: f"{ALTERNATIVE}{'name' if isinstance(value, str) else 'matrix'}"),
]


class GivenChannels(StrictModel):
    """Channels in place of drawn ones, path loss and gains included (`Channels`)."""

    direct: Matrix
    """h_b, J x M."""
    bs_ris: Matrix
    """H, N x M."""
    ris_user: Matrix
    """h_s, J x N."""


class Snapshot(StrictModel):
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


def read_snapshot(fields: object) -> Snapshot:
    """A snapshot from a mapping of fields. Raises SnapshotError."""
    try:
        return Snapshot.model_validate(fields)
    except ValidationError as error:
        raise SnapshotError(one_line(error, Snapshot)) from error


def _require_apart(name: str, point: Sequence[float], what: str, other: Sequence[float]) -> None:
    distance = math.dist(point, other)
    if distance < CLOSEST_M:
        raise ValueError(f"{name}: {distance:g} m from {what}, must be at least {CLOSEST_M:g} m")
