"""What differs between autopilots, as one record; everything else in `sitl/` is shared.

A `Personality` holds facts (numbers on the wire, link rates, the boot timeline, the parameter table) and says which
`Commander` decides. Services and telemetry know nothing but these two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Literal, Protocol

from sitl.flight.battery import Battery, Pack
from sitl.flight.control import Gains, Setpoint
from sitl.flight.flight_model import FlightModel
from sitl.flight.physics import Rotorcraft
from sitl.flight.reference import Vec3
from sitl.flight.world import World
from sitl.links.frames import Payload
from sitl.origin import Origin
from sitl.parameters import Parameter, Parameters
from sitl.plan import Plans
from sitl.targets import AttitudeTarget, Destination, PositionTarget, Sticks
from sitl.transfer import Rules

if TYPE_CHECKING:
    from sitl.vehicle import Vehicle

Name = Literal["px4", "arducopter"]

CRITICAL, ERROR, WARNING, INFO = 2, 3, 4, 6
"""MAV_SEVERITY."""


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


class Landed(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class State(IntEnum):
    """MAV_STATE."""

    UNINIT = 0
    BOOT = 1
    STANDBY = 3
    ACTIVE = 4
    CRITICAL = 5


class Commander(Protocol):
    """The vehicle's decisions, on vehicle time. Requests are answered with the personality's own MAV_RESULT."""

    now_ms: int
    """Vehicle time since boot."""
    armed: bool
    home: Vec3 | None
    """NED from the local origin [m]."""
    battery: Battery
    news: list[str]
    """Messages, by name, to be sent to everybody at once; emptied when they are."""
    plans: Plans
    """The mission and the fence, kept by the mission service, flown by the commander."""

    @property
    def flying(self) -> bool:
        """Whether the control law drives the motors; False on the ground and disarmed."""
        ...

    @property
    def has_flown(self) -> bool:
        """Whether it ever left the ground."""
        ...

    @property
    def landed(self) -> Landed: ...

    @property
    def ready(self) -> bool:
        """What SYS_STATUS's PREARM_CHECK bit says."""
        ...

    @property
    def system_status(self) -> State: ...

    @property
    def base_mode(self) -> int: ...

    @property
    def custom_mode(self) -> int: ...

    @property
    def in_mission(self) -> bool:
        """Whether the mode is the one that flies the mission."""
        ...

    @property
    def intended_custom_mode(self) -> int:
        """What the user asked for; a failsafe may fly something else."""
        ...

    def arm(self, force: bool) -> Result: ...

    def disarm(self, force: bool) -> Result: ...

    def takeoff(self, altitude: float) -> Result:
        """NAV_TAKEOFF with its altitude field as sent [m]."""
        ...

    def land(self) -> Result: ...

    def return_home(self) -> Result: ...

    def start_mission(self, first: float, last: float) -> Result:
        """MISSION_START with the items it names."""
        ...

    def set_mode(self, custom_mode: int) -> Result:
        """Any number; one that is no mode is refused."""
        ...

    def receive(self, target: PositionTarget) -> None:
        """A setpoint for this vehicle, of any content."""
        ...

    def receive_attitude(self, target: AttitudeTarget) -> None:
        """An attitude or rates with a thrust, of any content."""
        ...

    def pilot(self, sticks: Sticks | None, radio: bool) -> None:
        """Sticks of a pilot, from a joystick or a radio; None: given back."""
        ...

    def reposition(self, goal: Destination) -> Result:
        """DO_REPOSITION: fly to a place and hold."""
        ...

    def change_speed(self, kind: float, speed: float) -> Result:
        """DO_CHANGE_SPEED, of a kind of SPEED_TYPE, to [m/s]."""
        ...

    def pause(self, hold: bool) -> Result:
        """DO_PAUSE_CONTINUE: hold, or go on with the mission."""
        ...

    def enable_fence(self, on: bool) -> Result:
        """DO_FENCE_ENABLE."""
        ...

    def set_home(self, position_ned: Vec3) -> None: ...

    def hear_ground(self, system: int, kind: int) -> None:
        """A heartbeat of the system with this id, of a kind of MAV_TYPE: perhaps a ground station's."""
        ...

    def say(self, text: str, severity: int = INFO) -> None:
        """Tell the ground by STATUSTEXT."""
        ...

    def step(self, dt: float) -> Setpoint:
        """What is flown for the coming tick of dt [s]; called once per tick, before the physics."""
        ...


@dataclass(frozen=True)
class Timeline:
    """Milliseconds from boot until ..."""

    telemetry_ms: int
    heartbeat_ms: int
    position_ms: int
    """the estimator has a position."""
    home_ms: int
    armable_ms: int


@dataclass(frozen=True)
class Version:
    """AUTOPILOT_VERSION: four bytes each (major, minor, patch, FIRMWARE_VERSION_TYPE), and the first of the commit."""

    flight: int
    middleware: int
    operating_system: int
    board: int = 0
    commit: bytes = b""


@dataclass(frozen=True)
class Answers:
    """How commands are answered where autopilots differ; None = not at all."""

    unknown_message: Result
    """REQUEST_MESSAGE, GET_MESSAGE_INTERVAL of an id that is not sent."""
    unknown_interval: Result
    """SET_MESSAGE_INTERVAL of one."""
    bad_arm_value: Result | None
    """COMPONENT_ARM_DISARM with param1 neither 0 nor 1."""
    set_mode: bool
    """Whether the SET_MODE message is acknowledged."""
    any_component: bool
    """Whether commands to other components of this system are taken."""
    numbers_short_texts: bool
    """Whether a STATUSTEXT that fits into one chunk has an id."""


@dataclass(frozen=True)
class Missions:
    """How plans are transferred and shown."""

    rules: Rules
    home_first: bool
    """Whether item 0 of a mission stands for home (ArduPilot)."""
    integer_frames: bool
    """Whether MISSION_ITEM_INT shows the _INT frames (PX4)."""


@dataclass(frozen=True)
class FlightMode:
    """A mode as AVAILABLE_MODES tells of it."""

    custom_mode: int
    name: str
    standard: int = 0
    """MAV_STANDARD_MODE."""


@dataclass(frozen=True)
class Personality:
    """An autopilot's outside."""

    name: Name
    autopilot: int
    """MAV_AUTOPILOT."""
    capabilities: int
    version: Version
    timeline: Timeline
    answers: Answers
    missions: Missions
    modes: tuple[FlightMode, ...]
    companion_rates_hz: Mapping[str, float]
    gcs_rates_hz: Mapping[str, float]
    tcp_port: int | None
    """Where it serves TCP unless told otherwise."""
    stream_groups: Mapping[int, tuple[str, ...]]
    """MAV_DATA_STREAM -> messages of REQUEST_DATA_STREAM; empty where it is not obeyed."""
    table: tuple[Parameter, ...]
    system_id: str
    """Name of the parameter that holds the MAVLink system id."""
    integers_bytewise: bool
    """Whether integer parameters travel as their bytes in the float (PX4), or as floats."""
    vehicle_type: Callable[[Parameters], int]
    """MAV_TYPE."""
    gains: Callable[[Parameters], Gains]
    craft: Callable[[Parameters], Rotorcraft]
    pack: Callable[[Parameters], Pack]
    world: Callable[[Parameters], World]
    mode_number: Callable[[float, float], int]
    """custom_mode that DO_SET_MODE's param2 and param3 mean; -1 when they mean none."""
    sensors: Callable[[Vehicle], tuple[int, int, int]]
    """SYS_STATUS: sensors present, enabled, healthy."""
    messages: Mapping[str, Callable[[Vehicle], Payload | None]]
    """What can be streamed or requested, by message name; None = not known yet."""
    commander: Callable[[Parameters, FlightModel, Origin, Callable[[str, int], None]], Commander]


def personality(name: Name) -> Personality:
    """A personality by name."""
    if name == "arducopter":
        from sitl.arducopter.personality import ARDUCOPTER

        return ARDUCOPTER
    from sitl.px4.personality import PX4

    return PX4
