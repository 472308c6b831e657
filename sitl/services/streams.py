"""REQUEST_DATA_STREAM, the way ArduPilot's clients ask for telemetry."""

from sitl.links.frames import Message
from sitl.links.link import Link
from sitl.vehicle import Vehicle

ALL = 0
"""MAV_DATA_STREAM_ALL."""


def request_data_stream(v: Vehicle, link: Link, message: Message) -> None:
    """Start or stop a group of messages on this link; an autopilot without groups does not obey. Never answered."""
    groups = v.personality.stream_groups
    asked = list(groups.values()) if message.req_stream_id == ALL else [groups.get(message.req_stream_id, ())]
    on = message.start_stop == 1 and message.req_message_rate > 0
    for name in (name for group in asked for name in group):
        link.set_interval(name, 1e6 / message.req_message_rate if on else -1.0, v.now_ms)
