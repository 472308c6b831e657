"""What the bridge must know before it flies: validated, frozen, complete. `mission/` fills it from the mission file."""

import math
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

Vec3 = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Span = tuple[Finite, Finite]


class Strict(BaseModel):
    """Base of all parts: frozen, unknown fields refused."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Box(Strict):
    """Axis-aligned volume in ENU about home [m]; each span is (min, max)."""

    x: Span
    y: Span
    z: Span

    @field_validator("x", "y", "z")
    @classmethod
    def _ordered(cls, span: Span) -> Span:
        if span[0] >= span[1]:
            raise ValueError(f"{span}: the minimum must be below the maximum")
        return span

    @property
    def spans(self) -> tuple[Span, Span, Span]:
        return self.x, self.y, self.z

    def contains(self, point: Vec3, margin: float = 0.0) -> bool:
        """Whether `point` lies at least `margin` [m] inside every face."""
        return all(low + margin <= c <= high - margin for c, (low, high) in zip(point, self.spans, strict=True))

    def grown(self, sideways: float, vertically: float) -> "Box":
        """The box with its faces moved outward [m]."""
        return Box(
            x=(self.x[0] - sideways, self.x[1] + sideways),
            y=(self.y[0] - sideways, self.y[1] + sideways),
            z=(self.z[0] - vertically, self.z[1] + vertically),
        )

    def hull(self, point: Vec3) -> "Box":
        """The smallest box that holds this one and `point`."""
        x, y, z = ((min(low, c), max(high, c)) for c, (low, high) in zip(point, self.spans, strict=True))
        return Box(x=x, y=y, z=z)


class Limits(Strict):
    """What a plan may ask of the vehicle. The autopilot's own limits, read at preflight, tighten these."""

    horizontal_mps: Positive = 10.0
    up_mps: Positive = 3.0
    down_mps: Positive = 1.5
    acceleration_mps2: Positive = 3.0

    def within(self, horizontal_mps: float, up_mps: float, down_mps: float) -> "Limits":
        """These limits, tightened to the autopilot's."""
        return Limits(
            horizontal_mps=min(self.horizontal_mps, horizontal_mps),
            up_mps=min(self.up_mps, up_mps),
            down_mps=min(self.down_mps, down_mps),
            acceleration_mps2=self.acceleration_mps2,
        )


class LockstepClock(Strict):
    """The bridge owns vehicle time, through the SITL's control socket (`host:port`)."""

    kind: Literal["lockstep"] = "lockstep"
    control: str

    @field_validator("control")
    @classmethod
    def _endpoint(cls, control: str) -> str:
        endpoint(control)
        return control


class PacedClock(Strict):
    """The autopilot owns vehicle time, `speed` times as fast as the wall clock."""

    kind: Literal["paced"] = "paced"
    speed: Annotated[float, Field(gt=0, le=100, allow_inf_nan=False)] = 1.0


class BridgeConfig(Strict):
    """Everything the bridge node takes; see each field."""

    autopilot: str = "udpin://127.0.0.1:14540"
    """Where MAVLink comes in: `udpin://HOST:PORT`."""
    system_id: Annotated[int, Field(ge=1, le=255)] = 1
    """The vehicle's MAVLink system id; frames of all others are logged and ignored."""
    dialect: Literal["px4"] = "px4"
    clock: Annotated[LockstepClock | PacedClock, Field(discriminator="kind")]
    slots: Annotated[int, Field(ge=1)]
    slot_s: Annotated[float, Field(ge=0.2, le=60)] = 1.0
    """Slot length [s of vehicle time], a multiple of 0.1 s."""
    v_max_mps: Positive = 10.0
    """An action may ask for v_max * slot_s at most (constraint 21h)."""
    start_position_enu: tuple[Finite, Finite, Finite]
    panel_heading_rad: Finite = 0.0
    """Yaw held for the whole flight: the ENU heading of the panel's normal (0 = east)."""
    box: Box
    """The scenario's volume: plans stay inside and can stop inside."""
    fence: Box | None = None
    """What the vehicle must never leave in the slots; None: the box and 10 m sideways, 5 m up and down."""
    limits: Limits = Limits()
    action_deadline_fraction: Annotated[float, Field(gt=0, le=1)] = 0.25
    action_wait_wall_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    """Lockstep only: how long vehicle time stands still for an action."""
    grace_s: Annotated[float, Field(gt=0, le=3600)] = 15.0
    """Vehicle time without one good action after which the vehicle is sent home."""
    await_restart: bool = True
    """Lockstep: wait for an action also while the agent or rf node is dead, since it will be restarted."""
    at_end: Literal["return", "land"] = "return"
    takeoff_altitude_m: Annotated[float, Field(ge=1, le=100)] = 5.0
    setpoint_hz: Literal[20, 40, 50] = 20
    """Setpoints per second of vehicle time; the bridge steps at this rate."""
    parameters: dict[str, float | int] = {}
    """Autopilot parameters to set at preflight."""
    autostart: bool = False
    """Fly without waiting for the `start` command."""

    @field_validator("autopilot")
    @classmethod
    def _autopilot(cls, url: str) -> str:
        udpin_address(url)
        return url

    @field_validator("slot_s")
    @classmethod
    def _whole_samples(cls, slot_s: float) -> float:
        if not math.isclose(slot_s * 10, round(slot_s * 10), abs_tol=1e-6):
            raise ValueError(f"{slot_s:g}: must be a multiple of 0.1 s, the track's sampling")
        return slot_s

    @model_validator(mode="after")
    def _volumes(self) -> Self:
        if not self.box.contains(self.start_position_enu):
            raise ValueError(f"start_position_enu: {self.start_position_enu} is outside the box {self.box.spans}")
        if self.fence is not None:
            for axis, (low, high), (fence_low, fence_high) in zip("xyz", self.box.spans, self.fence.spans, strict=True):
                if fence_low > low or fence_high < high:
                    raise ValueError(
                        f"fence.{axis}: ({fence_low:g}, {fence_high:g}) must hold the box's ({low:g}, {high:g})"
                    )
        return self

    @property
    def slot_fence(self) -> Box:
        """What the vehicle must not leave while slots run."""
        return self.fence if self.fence is not None else self.box.grown(sideways=10.0, vertically=5.0)

    @property
    def flight_fence(self) -> Box:
        """What it must not leave between takeoff and slot 0: the slots' fence, reaching down to home."""
        return self.slot_fence.hull((-10.0, -10.0, -1.0)).hull((10.0, 10.0, 0.0))

    @property
    def tick_ms(self) -> int:
        """The bridge's step of vehicle time [ms]."""
        return 1000 // self.setpoint_hz

    @property
    def deadline_s(self) -> float:
        """Vehicle time from a slot's opening within which its action must come."""
        return self.action_deadline_fraction * self.slot_s


def udpin_address(url: str) -> tuple[str, int]:
    """(host, port) of `udpin://HOST:PORT`. Raises ValueError for anything else."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise ValueError(f"{url!r}: {error}") from None
    if parts.scheme != "udpin" or not host or port is None or parts.path:
        raise ValueError(f"{url!r}: only udpin://HOST:PORT is supported, e.g. udpin://127.0.0.1:14540")
    return host, port


def endpoint(text: str) -> tuple[str, int]:
    """(host, port) of `HOST:PORT`. Raises ValueError for anything else."""
    host, colon, port = text.rpartition(":")
    if not (host and colon and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError(f"{text!r}: must be HOST:PORT with a port of 1 to 65535")
    return host, int(port)
