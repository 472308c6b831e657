"""What differs between autopilots, as data."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from autopilot_bridge.vehicle import Mode


@dataclass(frozen=True)
class Need:
    """What a parameter must be for a failsafe to be on: one of `among`, or more than `above`."""

    parameter: str
    among: tuple[float, ...] = ()
    above: float = math.inf

    def met(self, value: float) -> bool:
        return value in self.among or value > self.above

    @property
    def allowed(self) -> str:
        """In words."""
        if not self.among:
            return f"more than {self.above:g}"
        *first, last = [f"{value:g}" for value in self.among]
        return f"{', '.join(first)} or {last}" if first else last


@dataclass(frozen=True)
class OwnFence:
    """The autopilot's own fence as far as parameters say it, about home [m]; infinity where there is none."""

    radius_m: float = math.inf
    height_m: float = math.inf


@dataclass(frozen=True)
class Dialect:
    """One autopilot's ways. Parameter names are the autopilot's own."""

    name: str
    autopilot: int
    """MAV_AUTOPILOT of its HEARTBEAT."""
    modes: Mapping[int, tuple[Mode, str]]
    """HEARTBEAT.custom_mode -> what it means to us, and its name."""
    commands: Mapping[Mode, tuple[float, float]]
    """How to ask for a mode: MAV_CMD_DO_SET_MODE param2, param3."""
    rates_hz: Mapping[int, float]
    """MAVLink message id -> rate wanted on our link."""
    stream_before_offboard_s: float
    """Setpoints must have streamed for this long before OFFBOARD is asked for."""
    lead_s: tuple[float, float, float]
    """Feed-forward of the reference's acceleration, east, north, up (see `tracker`)."""
    reaction_s: float
    """How long a commanded stop takes to bite: the envelope's `reaction_s`."""
    ready: Mode
    """The mode in which it is armed, takes off and hovers afterwards."""
    takeoff_altitude: str | None
    """The parameter that holds the height of takeoffs; None: it goes with the command."""
    takeoff_done: float
    """The fraction of that height at which a takeoff counts as done, if the mode is `ready`."""
    limits: Mapping[str, tuple[str, float]]
    """What `Limits.within` takes -> the parameter that holds it, and its unit in SI. `horizontal_mps` must be there."""
    failsafes: Mapping[str, tuple[float, ...]]
    """What must hold for a vehicle whose bridge is gone to land or return: parameter -> the values that are safe, of
    which the first is set when another is found."""
    stream_loss: tuple[str, float]
    """The parameter after which a stream counts as lost, and its unit [s]."""
    owners_failsafes: Mapping[str, tuple[Need, ...]]
    """Failsafes that whoever runs the vehicle chooses: the mission's word -> all that must be so."""
    tilt_max: tuple[str, float]
    """The parameter of the steepest tilt, and its unit [deg]."""
    own_fence: Callable[[Callable[[str], float]], OwnFence]
    """Reads the autopilot's fence, given what reads a parameter."""
    battery_acts_at: Callable[[Callable[[str], float]], float]
    """Reads the share of the pack at which the autopilot brings the vehicle down by itself; 0: never."""
    fence_parameters: tuple[str, str]
    """Of its radius and its height."""
    int_bytewise: bool
    """Whether an integer parameter travels as its bytes in the float, or as its value."""
