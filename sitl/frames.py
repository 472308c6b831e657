"""MAVLink frames: packing by message name, and unpacking datagrams that may hold anything.

pymavlink's generated classes give the layouts; packing is done here because the objects in between cost more than
the whole flight model.
"""

import struct
from collections import Counter
from functools import cache
from typing import Any, NamedTuple, TypeAlias

from pymavlink.dialects.v20 import development as mavlink

Message: TypeAlias = Any
"""A decoded message: an instance of one of pymavlink's generated classes, which carry no types."""

MAVLINK_1, MAVLINK_2 = 0xFE, 0xFD
SIGNED = 1
_HEADER = struct.Struct("<BBBBBBBHB")
_DECODER = mavlink.MAVLink(None)


class Layout(NamedTuple):
    """How a message lies on the wire."""

    message_id: int
    crc_extra: int
    fields: tuple[str, ...]
    """In wire order."""
    arrays: bool
    struct: struct.Struct


@cache
def layout(name: str) -> Layout:
    """Layout of a message by its name, e.g. `HEARTBEAT`. Raises KeyError when there is none."""
    kind = _kinds()[name]
    arrays = any(
        length > 0 and "char" not in type_ for length, type_ in zip(kind.array_lengths, kind.fieldtypes, strict=True)
    )
    return Layout(kind.id, kind.crc_extra, tuple(kind.ordered_fieldnames), arrays, kind.unpacker)


@cache
def _kinds() -> dict[str, Any]:
    return {kind.msgname: kind for kind in mavlink.mavlink_map.values()}


def name_of(message_id: int) -> str | None:
    """Message name of an id, None when the dialect does not know it."""
    kind = mavlink.mavlink_map.get(message_id)
    return None if kind is None else str(kind.msgname)


class Payload(NamedTuple):
    """A packed message without its header."""

    message_id: int
    crc_extra: int
    data: bytes


def pack(name: str, **fields: object) -> Payload:
    """Pack a message; text fields are bytes, array fields sequences. Trailing zeros are cut as MAVLink 2 does."""
    form = layout(name)
    values: list[object] = [fields[field] for field in form.fields]
    if form.arrays:
        flat: list[object] = []
        for value in values:
            flat.extend(value) if isinstance(value, (list, tuple)) else flat.append(value)
        values = flat
    data = form.struct.pack(*values).rstrip(b"\0")
    return Payload(form.message_id, form.crc_extra, data or b"\0")


def frame(payload: Payload, sequence: int, system: int, component: int) -> bytes:
    """The MAVLink 2 frame of a payload."""
    number = payload.message_id
    head = _HEADER.pack(MAVLINK_2, len(payload.data), 0, 0, sequence, system, component, number & 0xFFFF, number >> 16)
    body = head[1:] + payload.data
    crc = mavlink.x25crc(body + bytes((payload.crc_extra,))).crc
    return b"\xfd" + body + struct.pack("<H", crc)


def frame_length(data: bytes) -> int:
    """Length of the frame that `data` starts with; 0 when it starts with none or is cut short."""
    if len(data) < 3:
        return 0
    if data[0] == MAVLINK_2:
        length = data[1] + 12 + (13 if data[2] & SIGNED else 0)
    elif data[0] == MAVLINK_1:
        length = data[1] + 8
    else:
        return 0
    return length if length <= len(data) else 0


def unpack(datagram: bytes, bad: Counter[str]) -> list[tuple[Message, bytes]]:
    """The messages in a datagram, each with its frame; what is no good frame is counted in `bad` and skipped."""
    messages: list[tuple[Message, bytes]] = []
    while datagram:
        length = frame_length(datagram)
        if length == 0:
            bad["garbage"] += 1
            break
        raw, datagram = datagram[:length], datagram[length:]
        try:
            message = _DECODER.decode(bytearray(raw))
        except mavlink.MAVError:
            bad["frame"] += 1
            continue
        if message.get_type().startswith("UNKNOWN"):
            bad["unknown"] += 1
            continue
        messages.append((message, raw))
    return messages
