"""SET_GPS_GLOBAL_ORIGIN: told what the origin is. It is where the vehicle started, and stays."""

from sitl.links.frames import Message
from sitl.links.link import Link
from sitl.vehicle import Vehicle


def set_gps_global_origin(v: Vehicle, link: Link, _: Message) -> None:
    payload = v.personality.messages["GPS_GLOBAL_ORIGIN"](v)
    if payload is not None:
        link.send(payload)
