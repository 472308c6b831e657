"""The mission protocol's client side (mavlink.io, Mission Protocol): missions, fences and rally points."""

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance.outcome import Failed
from sitl.conformance.vehicle import ATTEMPTS, AUTOPILOT_COMPONENT, Message, Vehicle

MISSION, FENCE, RALLY = 0, 1, 2
"""MAV_MISSION_TYPE."""
WAYPOINT, LAND, TAKEOFF, POLYGON_INCLUSION = 16, 21, 22, 5001
RELATIVE = 6
"""MAV_FRAME_GLOBAL_RELATIVE_ALT_INT."""
SAME_FRAME = {0: 5, 5: 5, 3: 6, 6: 6}
"""The _INT frames and their twins."""
EARTH_M = 6_378_137.0
TRANSFER_S = 30.0


@dataclass(frozen=True)
class Item:
    """One MISSION_ITEM_INT."""

    command: int
    p: tuple[float, float, float, float]
    x: int
    """[1e-7 deg]"""
    y: int
    z: float
    frame: int = RELATIVE

    def like(self, other: "Item") -> bool:
        """Whether a plan may show one as the other: coordinates to 1e-6 deg, altitude to 1 cm."""
        return (
            self.command == other.command
            and SAME_FRAME.get(self.frame, self.frame) == SAME_FRAME.get(other.frame, other.frame)
            and abs(self.x - other.x) <= 10
            and abs(self.y - other.y) <= 10
            and abs(self.z - other.z) <= 0.01
        )


def globe(v: Vehicle, north: float, east: float) -> tuple[int, int]:
    """Latitude and longitude [1e-7 deg] of a place so far from where the vehicle took off."""
    there = v.latest.get("GLOBAL_POSITION_INT")
    if there is None:
        raise Failed("no GLOBAL_POSITION_INT")
    here = v.now.position
    to_north, to_east = v.start[0] + north - here[0], v.start[1] + east - here[1]
    degrees = math.degrees(1.0 / EARTH_M) * 1e7
    return (
        round(there.lat + to_north * degrees),
        round(there.lon + to_east * degrees / math.cos(math.radians(there.lat * 1e-7))),
    )


def waypoint(v: Vehicle, north: float, east: float, up: float, command: int = WAYPOINT, hold: float = 0.0) -> Item:
    """A place so far from where the vehicle took off."""
    return Item(command, (hold, 0.0, 0.0, math.nan), *globe(v, north, east), up)


def message_of(v: Vehicle, item: Item, seq: int, kind: int) -> Message:
    return mavlink.MAVLink_mission_item_int_message(
        v.system, AUTOPILOT_COMPONENT, seq, item.frame, item.command, 0, 1, *item.p, item.x, item.y, item.z, kind
    )


def item_of(m: Message) -> Item:
    return Item(m.command, (m.param1, m.param2, m.param3, m.param4), m.x, m.y, m.z, m.frame)


def download(v: Vehicle, kind: int = MISSION) -> list[Item]:
    """MISSION_REQUEST_LIST, MISSION_REQUEST_INT xn, MISSION_ACK. Raises Failed when something does not come."""
    with v.hear("MISSION_COUNT", "MISSION_ITEM_INT") as heard:

        def counts() -> list[Message]:
            return [m for m in heard if m.get_type() == "MISSION_COUNT" and m.mission_type == kind]

        for _ in range(ATTEMPTS):
            v.send(mavlink.MAVLink_mission_request_list_message(v.system, AUTOPILOT_COMPONENT, kind))
            if v.answered(counts):
                break
        else:
            raise Failed("MISSION_REQUEST_LIST: no MISSION_COUNT")
        items: list[Item] = []
        for seq in range(counts()[0].count):

            def found(seq: int = seq) -> list[Message]:
                return [
                    m for m in heard if m.get_type() == "MISSION_ITEM_INT" and (m.seq, m.mission_type) == (seq, kind)
                ]

            for _ in range(ATTEMPTS):
                v.send(mavlink.MAVLink_mission_request_int_message(v.system, AUTOPILOT_COMPONENT, seq, kind))
                if v.answered(found):
                    break
            else:
                raise Failed(f"MISSION_REQUEST_INT of item {seq}: no MISSION_ITEM_INT")
            items.append(item_of(found()[0]))
    v.send(mavlink.MAVLink_mission_ack_message(v.system, AUTOPILOT_COMPONENT, 0, kind))
    return items


def upload(v: Vehicle, items: list[Item], kind: int = MISSION) -> int:
    """MISSION_COUNT, items as they are asked for; the result of the MISSION_ACK (MAV_MISSION_RESULT).

    What was there before is kept, for `restore`. Raises Failed when no MISSION_ACK comes.
    """
    if kind not in v.plans:
        v.plans[kind] = download(v, kind)
    return _send(v, items, kind)


def _send(v: Vehicle, items: list[Item], kind: int) -> int:
    answered = 0
    with v.hear("MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK") as heard:

        def moved() -> bool:
            return len(heard) > answered

        end = v.time_ms + TRANSFER_S * 1000.0
        attempts = 0
        while v.time_ms < end:
            if answered == 0:
                if attempts == ATTEMPTS:
                    break
                attempts += 1
                v.send(mavlink.MAVLink_mission_count_message(v.system, AUTOPILOT_COMPONENT, len(items), kind))
            if not v.answered(moved):
                if answered:
                    break  # it is the vehicle's part to ask again
                continue
            for asked in heard[answered:]:
                if asked.mission_type != kind:
                    continue
                if asked.get_type() == "MISSION_ACK":
                    return int(asked.type)
                if asked.seq < len(items):
                    v.send(message_of(v, items[asked.seq], asked.seq, kind))
            answered = len(heard)
    raise Failed(f"upload of {len(items)} items: no MISSION_ACK; {answered} requests came")


def clear(v: Vehicle, kind: int = MISSION) -> int | None:
    """MISSION_CLEAR_ALL; the result of its MISSION_ACK. What was there before is kept, for `restore`."""
    if kind not in v.plans:
        v.plans[kind] = download(v, kind)
    with v.hear("MISSION_ACK") as heard:

        def found() -> list[Message]:
            return [m for m in heard if m.mission_type == kind]

        for _ in range(ATTEMPTS):
            v.send(mavlink.MAVLink_mission_clear_all_message(v.system, AUTOPILOT_COMPONENT, kind))
            if v.answered(found):
                return int(found()[0].type)
    return None


def with_home(v: Vehicle, items: list[Item]) -> list[Item]:
    """A mission as this autopilot stores it: ArduPilot's item 0 is home."""
    if not v.autopilot.home_first:
        return items
    latitude, longitude = globe(v, 0.0, 0.0)
    return [Item(WAYPOINT, (0.0, 0.0, 0.0, 0.0), latitude, longitude, 0.0), *items]


def without_home(v: Vehicle, items: list[Item]) -> list[Item]:
    """A mission without what stands for home in it."""
    return items[1:] if v.autopilot.home_first else items


def restore(v: Vehicle) -> list[str]:
    """Give back the plans that were overwritten; what went wrong."""
    lost = []
    for kind, items in v.plans.items():
        name = ("mission", "fence", "rally points")[kind]
        try:
            if (_send(v, items, kind) if items else clear(v, kind)) != mavlink.MAV_MISSION_ACCEPTED:
                lost.append(name)
        except Failed:
            lost.append(name)
    v.plans.clear()
    return lost
