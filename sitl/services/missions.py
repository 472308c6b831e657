"""The mission protocol, without missions: downloads are empty, an empty upload is taken, others are refused."""

from sitl.frames import Message, pack
from sitl.link import Link
from sitl.vehicle import Vehicle

ACCEPTED = 0
UNSUPPORTED = 3


def acknowledge(link: Link, message: Message, result: int) -> None:
    """MISSION_ACK to the asker."""
    link.send(
        pack(
            "MISSION_ACK",
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
            type=result,
            mission_type=message.mission_type,
        )
    )


def mission_request_list(_: Vehicle, link: Link, message: Message) -> None:
    link.send(
        pack(
            "MISSION_COUNT",
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
            count=0,
            mission_type=message.mission_type,
        )
    )


def mission_count(_: Vehicle, link: Link, message: Message) -> None:
    acknowledge(link, message, ACCEPTED if message.count == 0 else UNSUPPORTED)


def mission_clear_all(_: Vehicle, link: Link, message: Message) -> None:
    acknowledge(link, message, ACCEPTED)


def mission_request(_: Vehicle, link: Link, message: Message) -> None:
    """There is no item to give."""
    acknowledge(link, message, 13)
