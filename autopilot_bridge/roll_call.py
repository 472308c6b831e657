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
)
TOLD_MAX = 8
"""More stations than that are not listed."""


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
            and self.kind != mavlink.MAV_TYPE_GCS
        )

    def __str__(self) -> str:
        kind = _name("MAV_TYPE", self.kind)
        what = f"{_name('MAV_AUTOPILOT', self.autopilot)} {kind}" if self.flies else kind
        component = "" if self.component == mavlink.MAV_COMP_ID_AUTOPILOT1 else f", component {self.component}"
        return f"system {self.system}{component} ({what})"


class RollCall:
    """Of the vehicle with the system id `system_id`, and of all others."""

    def __init__(self, system_id: int) -> None:
        self._system_id = system_id
        self._stations: dict[tuple[int, int], Station] = {}
        self._senders: set[Sender] = set()

    def hear(self, message: Any, sender: Sender) -> bool:  # noqa: ANN401  pymavlink has no types
        """Take a message down; whether it is one of our vehicle's autopilot."""
        system, component = message.get_srcSystem(), message.get_srcComponent()
        ours = (system, component) == (self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            station = Station(system, component, message.type, message.autopilot)
            known = self._stations.get((system, component))
            if station.flies or known is None or not known.flies:
                self._stations[system, component] = station
            ours = ours and station.flies
        if ours:
            self._senders.add(sender)
        return ours

    def others(self) -> str:
        """Who was heard, in words; empty when nobody was."""
        told = [str(self._stations[key]) for key in sorted(self._stations)]
        return ", ".join(told[:TOLD_MAX]) + (f" and {len(told) - TOLD_MAX} more" if len(told) > TOLD_MAX else "")

    def objection(self) -> str:
        """Why the vehicle must not be flown over this link; empty when it may."""
        vehicle = self._stations.get((self._system_id, mavlink.MAV_COMP_ID_AUTOPILOT1))
        if vehicle is not None and vehicle.flies and vehicle.kind not in MULTICOPTERS:
            return f"{vehicle} is not a multicopter"
        if len(self._senders) > 1:
            places = " and ".join(sorted(f"{sender[0]}:{sender[1]}" for sender in self._senders if sender))
            return f"two autopilots on one link: {places} both speak as system {self._system_id}"
        flying = [str(self._stations[key]) for key in sorted(self._stations) if self._stations[key].flies]
        if len(flying) > 1:
            return f"two autopilots on one link: {' and '.join(flying)}; each vehicle needs a link of its own"
        return ""


def _name(enum: str, value: int) -> str:
    """In plain words, or the number."""
    entry = mavlink.enums[enum].get(value)
    return entry.name.removeprefix(f"{enum}_").lower().replace("_", " ") if entry else f"{enum} {value}"
