"""What the bridge wants from a vehicle, whatever library and autopilot are behind it.

All calls come from one thread. Calls that take time (`connect` to `set_parameter`) call the `wait` they were built
with again and again: it lets one step of vehicle time pass, with everything that must not stop meanwhile (setpoints,
heartbeats, telemetry), and may raise to abandon the call.
"""

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from airframe.slot_profile import Vector

if TYPE_CHECKING:
    from autopilot_bridge.dialects import Dialect
    from autopilot_bridge.uploaded_fence import FenceItem


CARRIED_S = 0.1
"""Vehicle time over which a position is carried on by its velocity."""


class Mode(StrEnum):
    """Flight modes the bridge acts on; every other one is somebody else's. OFFBOARD is the one that flies setpoints."""

    HOLD = "HOLD"
    TAKEOFF = "TAKEOFF"
    OFFBOARD = "OFFBOARD"
    RETURN = "RETURN"
    LAND = "LAND"
    OTHER = "OTHER"


class VehicleError(RuntimeError):
    """The vehicle cannot do what was asked; the text says what was asked and what it answered."""


class SilentError(VehicleError):
    """Nothing has come from the autopilot for too long."""


class RefusedError(VehicleError):
    """The autopilot said no; the text carries its STATUSTEXT."""


@dataclass(frozen=True)
class Telemetry:
    """The newest of everything that the autopilot has told."""

    time_s: float = 0.0
    """Vehicle time, of the newest telemetry of any kind."""
    position_s: float = 0.0
    """Vehicle time of position and velocity."""
    position_enu: Vector | None = None
    """About home [m]; None while there is no estimate."""
    velocity_enu: Vector | None = None
    attitude_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch as MAVLink's ATTITUDE; yaw in ENU."""
    mode: Mode = Mode.OTHER
    mode_name: str = "unknown"
    """As the autopilot calls it."""
    heartbeats: int = 0
    """How many have told it so far."""
    armed: bool = False
    landed: bool = False
    """Only once the autopilot says so."""
    armable: bool = False
    battery_remaining: float | None = None
    """0 to 1."""
    unhealthy: tuple[str, ...] = ()
    """What the autopilot says is not well (MAV_SYS_STATUS_SENSOR, without that)."""
    home_lat_lon_alt: tuple[float, float, float] | None = None
    """Degrees, degrees, metres above mean sea level."""

    def at(self, time_s: float) -> tuple[Vector, Vector]:
        """Position and velocity carried on to vehicle time `time_s`, over 0.1 s at most. Raises VehicleError.

        However old they are: PX4 sends no position at all while its estimate is lost, see `position_s`.
        """
        if self.position_enu is None or self.velocity_enu is None:
            raise VehicleError("the autopilot gives no local position")
        ahead = float(np.clip(time_s - self.position_s, 0.0, CARRIED_S))
        return self.position_enu + self.velocity_enu * ahead, self.velocity_enu


class Vehicle(ABC):
    """One vehicle over one link."""

    counters: Counter[str]

    @property
    @abstractmethod
    def dialect(self) -> "Dialect":
        """The autopilot's ways; known once connected. Raises VehicleError before."""

    @property
    @abstractmethod
    def hardware_uid(self) -> str:
        """The autopilot's own number in hexadecimal digits; empty until connected, or if it has none."""

    @property
    @abstractmethod
    def telemetry(self) -> Telemetry:
        """The newest state."""

    @property
    @abstractmethod
    def heard(self) -> int:
        """Messages of the autopilot so far; one that stops counting is silent."""

    @property
    @abstractmethod
    def frames_received(self) -> int:
        """Datagrams that have arrived, so that a lockstep clock knows when a step's telemetry is complete."""

    @abstractmethod
    def poll(self, timeout_s: float) -> None:
        """Take in what has arrived; wait for something at most `timeout_s` of wall clock."""

    @abstractmethod
    def beat(self) -> None:
        """Send what must be sent once a second of vehicle time (our HEARTBEAT)."""

    @abstractmethod
    def status_texts(self) -> list[str]:
        """STATUSTEXT since the last call."""

    @abstractmethod
    def remarks(self) -> list[str]:
        """What we have noticed of the vehicle and its link in flight since the last call, and a person should know."""

    @abstractmethod
    def send_velocity(self, velocity_enu: Vector, yaw_enu: float) -> None:
        """Put one velocity setpoint on the wire [m/s, rad]. Only the envelope calls this."""

    @abstractmethod
    def connect(self) -> None:
        """Wait for the autopilot and ask for the telemetry we need. Raises SilentError."""

    @abstractmethod
    def await_armable(self) -> None:
        """Wait a minute at most for the autopilot's own checks to pass; if they do not, `arm` is refused with reasons.

        Raises VehicleError when there is no home to count positions from.
        """

    @abstractmethod
    def arm(self) -> None:
        """Arm, and from now on count positions from this home. Raises RefusedError with the STATUSTEXT."""

    @abstractmethod
    def disarm(self) -> None:
        """Disarm on the ground. Raises RefusedError."""

    @abstractmethod
    def takeoff(self, altitude_m: float) -> None:
        """Climb to `altitude_m` above home and hover there; returns once there. Raises VehicleError."""

    @abstractmethod
    def hear_mode(self) -> None:
        """Wait until the mode in `telemetry` is news, so that nobody's newer choice is overruled unseen."""

    @abstractmethod
    def ask_for_telemetry(self) -> None:
        """Ask anew for what we need, without waiting for an answer: what has stopped may have been forgotten."""

    @abstractmethod
    def doubt_mode(self) -> None:
        """We have not listened for a while: what is heard next may be old, from a buffer that had no room for more."""

    @abstractmethod
    def mode_known(self) -> bool:
        """Whether the mode in `telemetry` was told after the last `doubt_mode` for certain; asks, as long as not."""

    @abstractmethod
    def set_mode(self, mode: Mode) -> None:
        """Change mode, confirmed by telemetry. For OFFBOARD setpoints must already stream. Raises RefusedError."""

    @abstractmethod
    def parameter(self, name: str) -> float:
        """An autopilot parameter. Raises VehicleError when it is unknown."""

    @abstractmethod
    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter, confirmed by its echo. Raises VehicleError."""

    @abstractmethod
    def uploaded_fence(self) -> list["FenceItem"]:
        """The fence that was uploaded to it (MAV_MISSION_TYPE_FENCE), item by item. Raises VehicleError."""

    @abstractmethod
    def close(self) -> None:
        """Release the link."""
