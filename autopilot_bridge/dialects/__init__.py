"""What differs between autopilots, as data."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from autopilot_bridge.vehicle import Mode

Read = Callable[[str], float]
"""Reads a parameter of the autopilot."""


@dataclass(frozen=True)
class Need:
    """What a parameter must be for a failsafe to be on: one of `among`, or more than `above`."""

    parameter: str
    among: tuple[float, ...] = ()
    above: float = math.inf
    instead: str | None = None
    """Another parameter of which the same is enough."""

    def unmet(self, read: Read) -> str:
        """What is wrong; empty when nothing is."""
        names = [self.parameter] if self.instead is None else [self.parameter, self.instead]
        found = {name: read(name) for name in names}
        if any(self._met(value) for value in found.values()):
            return ""
        told = " and ".join(f"{name} is {value:g}" for name, value in found.items())
        return f"{told}, must be {self.allowed}" if self.instead is None else f"{told}, one must be {self.allowed}"

    def _met(self, value: float) -> bool:
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
    floor_m: float = -math.inf
    margin_m: float = 0.0
    """So near to it the autopilot already holds back."""
    areas: bool = False
    """Whether areas uploaded to it are in force."""
    any_inclusion: bool = True
    """Whether one of several inclusion areas is enough, or each must hold the vehicle."""


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
    drag_share: float
    """Feed-forward of drag: so much more than the reference's level velocity is asked for."""
    reaction_s: float
    """How long a commanded stop takes to bite: the envelope's `reaction_s`."""
    ready: Mode
    """The mode in which it is armed, takes off and hovers afterwards."""
    takeoff_altitude: str | None
    """The parameter that holds the height of takeoffs; None: it goes with the command."""
    takeoff_done: float
    """The fraction of that height at which a takeoff counts as done, if the mode is `ready`."""
    limits: Mapping[str, tuple[str, float]]
    """What `Limits.within` takes -> the parameter that holds it, and its unit in SI. The three speeds must be there."""
    failsafes: Mapping[str, tuple[float, ...]]
    """What must hold for a vehicle whose bridge is gone to land or return: parameter -> the values that are safe, of
    which the first is set when another is found."""
    stream_loss: tuple[str, float]
    """The parameter [s] after which a stream counts as lost, and what it is made when it is more than that and the
    mission does not name it."""
    owners_failsafes: Mapping[str, tuple[Need, ...]]
    """Failsafes that whoever runs the vehicle chooses: the mission's word -> all that must be so."""
    tilt_max_deg: Callable[[Read], float]
    """Reads the steepest tilt."""
    own_fence: Callable[[Read], OwnFence]
    """Reads the autopilot's fence."""
    battery_acts_at: Callable[[Read], float]
    """Reads the share of the pack at which the autopilot brings the vehicle down by itself; 0: never."""
    fence_parameters: tuple[str, str, str]
    """Of its radius, its height and its floor; empty for one that it has not."""
    int_bytewise: bool
    """Whether an integer parameter travels as its bytes in the float, or as its value."""
