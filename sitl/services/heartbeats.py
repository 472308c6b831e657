"""HEARTBEATs of others: a ground station's keeps its connection alive."""

from sitl.frames import Message
from sitl.link import Link
from sitl.sensors import Loss
from sitl.vehicle import Vehicle


def heartbeat(v: Vehicle, _: Link, m: Message) -> None:
    if not v.model.faults.lost(Loss.GROUND_STATION, v.now_ms):
        v.commander.hear_ground(m.get_srcSystem(), m.type)
