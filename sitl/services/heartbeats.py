"""HEARTBEATs of others: a ground station's keeps its connection alive."""

from sitl.flight.sensors import Loss
from sitl.links.frames import Message
from sitl.links.link import Link
from sitl.vehicle import Vehicle


def heartbeat(v: Vehicle, _: Link, m: Message) -> None:
    if not v.model.faults.lost(Loss.GCS, v.now_ms):
        v.commander.hear_ground(m.get_srcSystem(), m.type)
