"""Who is on the link: from everybody's HEARTBEAT, and from where the frames come."""

from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.wire import Sender

MULTICOPTERS = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_DODECAROTOR,
    mavlink.MAV_TYPE_DECAROTOR,
    mavlink.MAV_TYPE_GENERIC_MULTIROTOR,
)
EQUIPMENT = (
    mavlink.MAV_TYPE_GCS,
    mavlink.MAV_TYPE_ANTENNA_TRACKER,
    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
    mavlink.MAV_TYPE_GIMBAL,
    mavlink.MAV_TYPE_ADSB,
    mavlink.MAV_TYPE_CAMERA,
    mavlink.MAV_TYPE_CHARGING_STATION,
    mavlink.MAV_TYPE_FLARM,
    mavlink.MAV_TYPE_SERVO,
    mavlink.MAV_TYPE_ODID,
    mavlink.MAV_TYPE_BATTERY,
    mavlink.MAV_TYPE_PARACHUTE,
    mavlink.MAV_TYPE_LOG,
    mavlink.MAV_TYPE_OSD,
    mavlink.MAV_TYPE_IMU,
    mavlink.MAV_TYPE_GPS,
    mavlink.MAV_TYPE_WINCH,
)
"""Kinds that do not fly, whatever autopilot they say they run."""
TOLD_MAX = 8
"""More stations than that are not listed."""
HANDOVER_WALL_S = 0.5
"""The vehicle's place on the network is somebody else's once only he has spoken as it for so long (a rebound NAT)."""


@dataclass(frozen=True)
class Station:
    """What a HEARTBEAT says of its sender."""

    system: int
    component: int
    kind: int
    """MAV_TYPE."""
    autopilot: int
    """MAV_AUTOPILOT."""

    @property
    def flies(self) -> bool:
        """Whether it is an autopilot; ground stations, gimbals and companions beat as well."""
        return bool(
            self.component == mavlink.MAV_COMP_ID_AUTOPILOT1
            and self.autopilot != mavlink.MAV_AUTOPILOT_INVALID
            and self.kind not in EQUIPMENT
        )

    def __str__(self) -> str:
        kind = _name("MAV_TYPE", self.kind)
        what = f"{_name('MAV_AUTOPILOT', self.autopilot)} {kind}" if self.flies else kind
        component = "" if self.component == mavlink.MAV_COMP_ID_AUTOPILOT1 else f", component {self.component}"
        return f"system {self.system}{component} ({what})"


class RollCall:
    """Of the vehicle with the system id `system_id`, and of all others."""

    def __init__(self, system_id: int) -> None:
        self._vehicle = (system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self._stations: dict[tuple[int, int], Station] = {}
        self._voices: list[Sender] = []
        """Who speaks as our vehicle: first who is believed, then who is not."""
        self._rival_since_s: float | None = None
        """Wall clock; None once the one who is believed has spoken."""

    def is_vehicle(self, system: int, component: int) -> bool:
        """Whether that is what our vehicle's autopilot calls itself."""
        return (system, component) == self._vehicle

    def hear(self, heartbeat: Any) -> bool:  # noqa: ANN401  pymavlink has no types
        """Take a HEARTBEAT down; whether it is an autopilot's."""
        key = heartbeat.get_srcSystem(), heartbeat.get_srcComponent()
        station = Station(*key, heartbeat.type, heartbeat.autopilot)
        known = self._stations.get(key)
        if station.flies or known is None or not known.flies:
            self._stations[key] = station
        return station.flies

    def is_its_voice(self, sender: Sender, wall_s: float) -> bool:
        """Whether what calls itself our vehicle's autopilot is to be believed, by where it comes from.

        It is the one that was first, until only another one has been heard for `HANDOVER_WALL_S`.
        """
        if not self._voices:
            self._voices.append(sender)
        if sender == self._voices[0]:
            self._rival_since_s = None
            return True
        if self._rival_since_s is None:
            self._rival_since_s = wall_s
        if wall_s - self._rival_since_s >= HANDOVER_WALL_S:
            self._voices, self._rival_since_s = [sender], None
            return True
        if sender not in self._voices and len(self._voices) < TOLD_MAX:
            self._voices.append(sender)
        return False

    def others(self) -> str:
        """Who was heard, in words; empty when nobody was."""
        told = [str(self._stations[key]) for key in sorted(self._stations)]
        return ", ".join(told[:TOLD_MAX]) + (f" and {len(told) - TOLD_MAX} more" if len(told) > TOLD_MAX else "")

    def objection(self) -> str:
        """Why the vehicle must not be flown over this link; empty when it may."""
        vehicle = self._stations.get(self._vehicle)
        if vehicle is not None and vehicle.flies and vehicle.kind not in MULTICOPTERS:
            return f"{vehicle} is not a multicopter"
        if len(self._voices) > 1:
            places = " and ".join(sorted(f"{sender[0]}:{sender[1]}" for sender in self._voices if sender))
            return f"two autopilots on one link: {places} both speak as system {self._vehicle[0]}"
        flying = [str(self._stations[key]) for key in sorted(self._stations) if self._stations[key].flies]
        if len(flying) > 1:
            return f"two autopilots on one link: {' and '.join(flying)}; each vehicle needs a link of its own"
        return ""


def _name(enum: str, value: int) -> str:
    """In plain words, or the number."""
    entry = mavlink.enums[enum].get(value)
    return entry.name.removeprefix(f"{enum}_").lower().replace("_", " ") if entry else f"{enum} {value}"
