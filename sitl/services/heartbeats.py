"""HEARTBEATs of others: a ground station's keeps its connection alive."""

from sitl.frames import Message
from sitl.link import Link
from sitl.sensors import Loss
from sitl.vehicle import Vehicle

GROUND_STATION = 6
"""MAV_TYPE_GCS."""


def heartbeat(v: Vehicle, _: Link, m: Message) -> None:
    if m.type == GROUND_STATION and not v.model.faults.lost(Loss.GCS, v.now_ms):
        v.commander.hear_ground(m.get_srcSystem())
