"""TIMESYNC and PING: answered at once, on vehicle time."""

from sitl.links.frames import Message, pack
from sitl.links.link import Link
from sitl.vehicle import Vehicle


def timesync(v: Vehicle, link: Link, message: Message) -> None:
    """tc1 = 0 is a request: the answer mirrors ts1."""
    if message.tc1 == 0:
        link.send(pack("TIMESYNC", tc1=v.now_ms * 1_000_000, ts1=message.ts1))


def ping(_: Vehicle, link: Link, message: Message) -> None:
    """A ping to nobody in particular is a request."""
    if message.target_system == 0 and message.target_component == 0:
        link.send(
            pack(
                "PING",
                time_usec=message.time_usec,
                seq=message.seq,
                target_system=message.get_srcSystem(),
                target_component=message.get_srcComponent(),
            )
        )
