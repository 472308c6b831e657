"""What the bridge must know before it flies: validated, frozen, complete. `mission/` fills it from the mission file."""

import math
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from airframe.slot_profile import Agility, SpeedLimits, Vector
from autopilot_bridge.deadman import Deadman
from autopilot_bridge.energy import Endurance
from autopilot_bridge.fence import Box, Fence, Strict, holds_box
from autopilot_bridge.url import parse_url

Failsafe = Literal["offboard_loss", "battery_failsafe", "gcs_loss", "geofence"]
"""What an autopilot does by itself when our stream stops, the battery is low, the ground station silent, its fence
breached."""
REQUIRED: tuple[Failsafe, ...] = ("offboard_loss", "battery_failsafe")
"""Without these no flight begins, unless the mission says so by name."""

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Limits(Strict):
    """What a plan may ask of the vehicle. The autopilot's own limits, read at preflight, tighten these."""

    horizontal_mps: Positive = 10.0
    up_mps: Positive = 3.0
    down_mps: Positive = 1.5
    acceleration_mps2: Positive = 3.0
    """Of a horizontal change of velocity, and of every other one where there is no vertical limit of its own."""
    vertical_acceleration_mps2: Positive | None = None
    """Of a vertical change; slanting ones lie on the ellipsoid between the two."""
    jerk_mps3: Positive | None = None
    """Of a horizontal change of acceleration, vertically in proportion; None: none, accelerations may jump."""

    @property
    def vertical_mps2(self) -> float:
        """The vertical acceleration limit."""
        return self.vertical_acceleration_mps2 or self.acceleration_mps2

    @property
    def speeds(self) -> SpeedLimits:
        return SpeedLimits(self.horizontal_mps, self.up_mps, self.down_mps)

    @property
    def agility(self) -> Agility:
        jerk = math.inf if self.jerk_mps3 is None else self.jerk_mps3
        return Agility(self.acceleration_mps2, jerk, self.vertical_mps2 / self.acceleration_mps2)

    def time_to_change(self, velocity: Vector) -> Vector:
        """Time [s] that a straight change by `velocity` (..., 3) [m/s] takes without a jerk limit; shape (...)."""
        level = (velocity[..., 0] ** 2 + velocity[..., 1] ** 2) / self.acceleration_mps2**2
        time_s: Vector = np.sqrt(level + (velocity[..., 2] / self.vertical_mps2) ** 2)
        return time_s

    def within(
        self,
        horizontal_mps: float = math.inf,
        up_mps: float = math.inf,
        down_mps: float = math.inf,
        acceleration_mps2: float = math.inf,
        vertical_acceleration_mps2: float = math.inf,
        jerk_mps3: float = math.inf,
    ) -> "Limits":
        """These limits, tightened to the autopilot's; infinity where it has none."""
        vertical = min(self.vertical_mps2, vertical_acceleration_mps2)
        jerk = min(self.jerk_mps3 or math.inf, jerk_mps3)
        level = min(self.acceleration_mps2, acceleration_mps2)
        return Limits(
            horizontal_mps=min(self.horizontal_mps, horizontal_mps),
            up_mps=min(self.up_mps, up_mps),
            down_mps=min(self.down_mps, down_mps),
            acceleration_mps2=level,
            vertical_acceleration_mps2=None if vertical == level else vertical,
            jerk_mps3=None if math.isinf(jerk) else jerk,
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
    """Where MAVLink comes in: udpin://HOST:PORT, udpout://HOST:PORT, tcp://HOST:PORT or serial://DEVICE:BAUD."""
    backend: Literal["pymavlink", "mavsdk"] = "pymavlink"
    """The client library that asks the autopilot for things."""
    system_id: Annotated[int, Field(ge=1, le=255)] = 1
    """The vehicle's MAVLink system id; frames of all others are logged and ignored."""
    dialect: Literal["auto", "px4", "arducopter"] = "auto"
    """Which autopilot is expected; `auto`: whichever of them answers."""
    signing_key: Path | None = None
    """MAVLink 2 signing: a file of 32 bytes or 64 hexadecimal digits; None: frames are neither signed nor checked."""
    clock: Annotated[LockstepClock | PacedClock, Field(discriminator="kind")]
    slots: Annotated[int, Field(ge=1)]
    slot_s: Annotated[float, Field(ge=0.2, le=60)] = 1.0
    """Slot length [s of vehicle time], a multiple of 0.1 s."""
    v_max_mps: Positive = 10.0
    """An action may ask for v_max * slot_s at most (constraint 21h)."""
    start_position_enu: tuple[Finite, Finite, Finite]
    panel_heading_rad: Finite = 0.0
    """Yaw held for the whole flight: the ENU heading of the panel's normal (0 = east)."""
    face_enu: tuple[Finite, Finite] | None = None
    """A place (east, north) that the panel's normal points at instead."""
    tracking: Literal["position", "none"] = "position"
    """How slots are flown: closed on the reference's position, or its velocity alone, open loop (for comparison)."""
    box: Box
    """The scenario's volume: plans stay inside and can stop inside."""
    fence: Fence | None = None
    """What the vehicle must never leave in the slots; None: the box and 10 m sideways, 5 m up and down."""
    home_distance_m: Positive | None = None
    """How far from home the vehicle may be, in plan; None: as far as the fence lets it."""
    separation_m: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """Distance in plan that other vehicles are never to come nearer than."""
    endurance: Endurance | None = None
    """Pack and power model: motion that would make the return impossible is clipped; used up: return. None: neither."""
    limits: Limits = Limits()
    action_deadline_fraction: Annotated[float, Field(gt=0, le=1)] = 0.25
    action_wait_wall_s: Annotated[float, Field(ge=0, le=600)] = 5.0
    """Lockstep only: how long vehicle time stands still for an action."""
    hold_mode_s: Annotated[float, Field(gt=0, le=3600)] = 5.0
    """Without one good action for so long (two slots at least) the autopilot's own hold mode is asked for."""
    grace_s: Annotated[float, Field(gt=0, le=3600)] = 15.0
    """Without one good action, or position, for so long (three slots at least) the vehicle is sent home."""
    return_s: Annotated[float, Field(gt=0, le=3600)] = 300.0
    """A vehicle sent home that is not on the ground after so long is told to land where it is."""
    await_restart: bool = True
    """Lockstep: wait for an action also while the agent or rf node is dead, since it will be restarted."""
    at_end: Literal["return", "land"] = "return"
    takeoff_altitude_m: Annotated[float, Field(ge=1, le=100)] = 5.0
    setpoint_hz: Literal[20, 40, 50] = 20
    """Setpoints per second of vehicle time; the bridge steps at this rate."""
    parameters: dict[str, float | int] = Field(default={})
    """Autopilot parameters to set at preflight."""
    require: tuple[Failsafe, ...] = ()
    """Failsafes of the autopilot that this flight stands on besides `REQUIRED`."""
    allow_without: tuple[Failsafe, ...] = ()
    """Failsafes that it may fly without."""
    put_back: bool = True
    """Whether parameters changed for the flight are put back after it; not for an autopilot that ends with it."""
    state_folder: Path | None = None
    """Where the journal of changed parameters lies; None: the user's ($XDG_STATE_HOME/aerialstar)."""
    autostart: bool = False
    """Fly without waiting for the `start` command."""

    @field_validator("autopilot")
    @classmethod
    def _autopilot(cls, url: str) -> str:
        parse_url(url)
        return url

    @field_validator("slot_s")
    @classmethod
    def _whole_samples(cls, slot_s: float) -> float:
        if not math.isclose(slot_s * 10, round(slot_s * 10), abs_tol=1e-6):
            raise ValueError(f"{slot_s:g}: must be a multiple of 0.1 s, the track's sampling")
        return slot_s

    @model_validator(mode="after")
    def _backend_fits(self) -> Self:
        """MAVSDK has clocks of its own, and no signing; lockstep counts datagrams."""
        lockstep = isinstance(self.clock, LockstepClock)
        if lockstep and not self.autopilot.startswith("udpin://"):
            raise ValueError(
                f"autopilot: {self.autopilot!r} is not for clock 'lockstep', which needs udpin://HOST:PORT"
            )
        if self.backend == "mavsdk":
            if find_spec("mavsdk") is None:
                raise ValueError("backend: 'mavsdk' is not installed: pip install mavsdk")
            if isinstance(self.clock, LockstepClock) or self.clock.speed > 1.0:
                given = "lockstep" if isinstance(self.clock, LockstepClock) else f"paced, speed {self.clock.speed:g}"
                raise ValueError(f"backend: 'mavsdk' needs clock 'paced' at speed 1 at most, not {given}")
            if self.signing_key is not None:
                raise ValueError("signing_key: backend 'mavsdk' cannot sign, 'pymavlink' can")
        return self

    @model_validator(mode="after")
    def _said_once(self) -> Self:
        both = sorted(set(self.require) & set(self.allow_without))
        if both:
            raise ValueError(f"allow_without: {both[0]!r} is also in require; it can be in one of them")
        return self

    @model_validator(mode="after")
    def _volumes(self) -> Self:
        if not self.box.contains(self.start_position_enu):
            raise ValueError(f"start_position_enu: {self.start_position_enu} is outside the box {self.box.spans}")
        if self.fence is not None:
            self._fence_fits(self.fence)
        top_m = self.slot_fence.altitude[1]
        if self.takeoff_altitude_m > top_m:
            raise ValueError(
                f"takeoff_altitude_m: {self.takeoff_altitude_m:g} is above the fence, which ends at {top_m:g}"
            )
        furthest = float(np.hypot(*self.box.corners.T).max())
        if self.home_distance_m is not None and self.home_distance_m < furthest:
            raise ValueError(
                f"home_distance_m: {self.home_distance_m:g} is less than the {furthest:.1f} to the box's corners"
            )
        return self

    def _fence_fits(self, fence: Fence) -> None:
        """Raises ValueError."""
        wrong = holds_box(fence, self.box)
        if wrong:
            raise ValueError(f"fence{wrong}")
        start = self.start_position_enu[:2]
        if not isinstance(fence, Box) and not fence.holds([(0.0, 0.0), start]):
            raise ValueError(
                f"fence: must hold the straight way from home (0, 0) to the start ({start[0]:g}, {start[1]:g})"
            )

    @cached_property
    def slot_fence(self) -> Fence:
        """What the vehicle must not leave while slots run."""
        return self.fence if self.fence is not None else self.box.grown(sideways=10.0, vertically=5.0)

    @cached_property
    def flight_fence(self) -> Fence:
        """What it must not leave between takeoff and slot 0: the slots' fence, reaching down to home."""
        return self.slot_fence.down_to_home()

    @property
    def tick_ms(self) -> int:
        """The bridge's step of vehicle time [ms]."""
        return 1000 // self.setpoint_hz

    @property
    def deadman(self) -> Deadman:
        """The ladder's thresholds."""
        return Deadman(
            deadline_s=self.deadline_s,
            hold_mode_s=max(self.hold_mode_s, 2 * self.slot_s),
            grace_s=max(self.grace_s, 3 * self.slot_s),
            return_s=self.return_s,
        )

    @property
    def deadline_s(self) -> float:
        """Vehicle time from a slot's opening within which its action must come."""
        return self.action_deadline_fraction * self.slot_s


def endpoint(text: str) -> tuple[str, int]:
    """(host, port) of `HOST:PORT`. Raises ValueError for anything else."""
    host, colon, port = text.rpartition(":")
    if not (host and colon and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError(f"{text!r}: must be HOST:PORT with a port of 1 to 65535")
    return host, int(port)
