"""What differs between autopilots, as data."""

from collections.abc import Mapping
from dataclasses import dataclass

from autopilot_bridge.vehicle import Mode


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
    takeoff_altitude: str
    limits: Mapping[str, tuple[str, float]]
    """What `Limits.within` takes -> the parameter that holds it, and its unit in SI. `horizontal_mps` must be there."""
    offboard_loss_action: str
    offboard_loss_safe: tuple[int, ...]
    """Values of `offboard_loss_action` that land or return; the first is set when another is found."""
    int_bytewise: bool
    """Whether an integer parameter travels as its bytes in the float, or as its value."""
