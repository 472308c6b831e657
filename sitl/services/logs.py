"""On-board logs: there are none. Erasing them and ending a download need no answer."""

from sitl.links.frames import Message, pack
from sitl.links.link import Link
from sitl.vehicle import Vehicle


def log_request_list(_: Vehicle, link: Link, message: Message) -> None:
    """One LOG_ENTRY that says so, whatever range was asked for."""
    link.send(pack("LOG_ENTRY", id=0, num_logs=0, last_log_num=0, time_utc=0, size=0))


def log_request_data(_: Vehicle, link: Link, message: Message) -> None:
    """LOG_DATA of no bytes: the end of the log."""
    link.send(pack("LOG_DATA", id=message.id, ofs=message.ofs, count=0, data=[0] * 90))
