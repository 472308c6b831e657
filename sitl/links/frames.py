"""MAVLink frames: packing by message name, and telling the good frames in bytes that may hold anything.

pymavlink's generated classes give the layouts; packing and checking are done here because the objects in between cost
more than the whole flight model. A frame is decoded only when somebody wants to know what it says.
"""

import struct
from collections import Counter
from collections.abc import Callable
from functools import cache
from operator import itemgetter
from typing import Any, NamedTuple, TypeAlias

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import all as mavlink

Message: TypeAlias = Any
"""A decoded message: an instance of one of pymavlink's generated classes, which carry no types."""

Kind: TypeAlias = Any
"""One of those classes."""

MAVLINK_1, MAVLINK_2 = 0xFE, 0xFD
SIGNED = 1
"""Bit of incompat_flags; a frame with any other bit set must be dropped (MAVLink serialization guide)."""
SIGNATURE_BYTES = 13
_HEADER = struct.Struct("<BBBBBBBHB")
_CRC = struct.Struct("<H")
_DECODER = mavlink.MAVLink(None)


class Layout(NamedTuple):
    """How a message lies on the wire."""

    message_id: int
    crc_extra: bytes
    take: Callable[[dict[str, object]], tuple[object, ...]]
    """The values of a dict by field name, in wire order."""
    arrays: tuple[int, ...]
    """Which of them are arrays of numbers, last first."""
    struct: struct.Struct
    target_system: int
    target_component: int
    """Byte of the payload where the addressee stands; -1 when the message has none."""


def _offset(kind: Kind, field: str) -> int:
    """Where a field starts in the payload; -1 when there is none."""
    if field not in kind.ordered_fieldnames:
        return -1
    before = kind.ordered_fieldnames.index(field)
    size = 0
    for name, length in zip(kind.ordered_fieldnames[:before], kind.array_lengths[:before], strict=True):
        kind_of = kind.fieldtypes[kind.fieldnames.index(name)]
        one = 8 if "64" in kind_of or kind_of == "double" else 4 if "32" in kind_of or kind_of == "float" else 0
        size += (one or (2 if "16" in kind_of else 1)) * max(length, 1)
    return size


def _layout(kind: Kind) -> Layout:
    names = kind.ordered_fieldnames
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    arrays = [
        index
        for index, (name, length) in enumerate(zip(names, kind.array_lengths, strict=True))
        if length > 0 and types[name] != "char"
    ]
    single = itemgetter(names[0])
    take = (lambda fields: (single(fields),)) if len(names) == 1 else itemgetter(*names)
    return Layout(
        kind.id,
        bytes((kind.crc_extra,)),
        take,
        tuple(reversed(arrays)),
        kind.unpacker,
        _offset(kind, "target_system"),
        _offset(kind, "target_component"),
    )


@cache
def _kinds() -> dict[str, Kind]:
    return {kind.msgname: kind for kind in mavlink.mavlink_map.values()}


@cache
def layout(name: str) -> Layout:
    """Layout of a message by its name, e.g. `HEARTBEAT`. Raises KeyError when there is none."""
    return _layout(_kinds()[name])


WITHOUT_LAYOUT = {300: "PROTOCOL_VERSION"}
"""Messages of common.xml that pymavlink's dialects have dropped, and clients still ask for."""


def layout_of(message_id: int) -> Layout | None:
    """Layout of a message by its id; None when the dialect does not know it (such ids, 16 million, are not kept)."""
    kind = mavlink.mavlink_map.get(message_id)
    return None if kind is None else layout(kind.msgname)


def name_of(message_id: int) -> str | None:
    """Message name of an id, None when the dialect does not know it."""
    kind = mavlink.mavlink_map.get(message_id)
    return WITHOUT_LAYOUT.get(message_id) if kind is None else str(kind.msgname)


class Payload(NamedTuple):
    """A packed message without its header."""

    message_id: int
    crc_extra: bytes
    data: bytes


def pack(name: str, **fields: object) -> Payload:
    """Pack a message; text fields are bytes, array fields sequences. Trailing zeros are cut as MAVLink 2 does."""
    form = layout(name)
    values = form.take(fields)
    if form.arrays:
        flat = list(values)
        for index in form.arrays:
            array = flat[index]
            assert isinstance(array, (list, tuple)), f"{name}: field {index} is an array"
            flat[index : index + 1] = array
        values = tuple(flat)
    data = form.struct.pack(*values).rstrip(b"\0")
    return Payload(form.message_id, form.crc_extra, data or b"\0")


def frame(payload: Payload, sequence: int, system: int, component: int, flags: int = 0) -> bytes:
    """The MAVLink 2 frame of a payload; with the flag SIGNED its signature is still to be added."""
    number, crc_extra, data = payload
    head = _HEADER.pack(MAVLINK_2, len(data), flags, 0, sequence, system, component, number & 0xFFFF, number >> 16)
    body = head + data
    return body + _CRC.pack(mcrf4xx(crc_extra, mcrf4xx(body[1:])))


class Frame(NamedTuple):
    """A frame of a known message with a good checksum."""

    raw: bytes
    message_id: int
    sequence: int
    system: int
    component: int
    target_system: int
    target_component: int
    """Who it is for; 0 = everybody, also when the message has no such field."""
    signed: bool

    @property
    def name(self) -> str:
        return str(mavlink.mavlink_map[self.message_id].msgname)


def split(data: bytes, bad: Counter[str]) -> tuple[list[Frame], bytes]:
    """The good frames in `data`, and what is left: the beginning of a frame whose end has not come yet.

    What is no good frame is counted in `bad` and skipped: `garbage` (a run of bytes that begin no frame), `frame` (bad
    checksum, impossible length, or incompat_flags we do not know), `unknown` (a message the dialect does not have,
    whose checksum nobody can check).
    """
    good: list[Frame] = []
    at, end = 0, len(data)
    while at < end:
        magic = data[at]
        if magic == MAVLINK_2:
            if end - at < 12:
                break
            flags = data[at + 2]
            stop = at + 12 + data[at + 1]
            length = stop - at + (SIGNATURE_BYTES if flags & SIGNED else 0)
            number, start = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16, at + 10
        elif magic == MAVLINK_1:
            if end - at < 8:
                break
            flags, stop = 0, at + 8 + data[at + 1]
            length, number, start = stop - at, data[at + 5], at + 6
        else:
            bad["garbage"] += 1
            at = _next_magic(data, at)
            continue
        if at + length > end:
            break
        form = layout_of(number)
        if form is None:
            bad["unknown"] += 1
        elif (
            flags & ~SIGNED
            or (data[stop - 2] | data[stop - 1] << 8) != mcrf4xx(form.crc_extra, mcrf4xx(data[at + 1 : stop - 2]))
            or (magic == MAVLINK_1 and stop - 2 - start > form.struct.size)
        ):
            bad["frame"] += 1
        else:
            whom, which = start + form.target_system, start + form.target_component
            ids = at + 5 if magic == MAVLINK_2 else at + 3
            good.append(
                Frame(
                    data[at : at + length],
                    number,
                    data[ids - 1],
                    data[ids],
                    data[ids + 1],
                    data[whom] if form.target_system >= 0 and whom < stop - 2 else 0,
                    data[which] if form.target_component >= 0 and which < stop - 2 else 0,
                    bool(flags & SIGNED),
                )
            )
        at += length
    return good, data[at:]


def _next_magic(data: bytes, at: int) -> int:
    """Where the next frame may begin."""
    places = [place for place in (data.find(b"\xfd", at), data.find(b"\xfe", at)) if place >= 0]
    return min(places) if places else len(data)


def split_datagram(datagram: bytes, bad: Counter[str]) -> list[Frame]:
    """The good frames of a datagram, which holds whole ones only; an unfinished one is counted as garbage."""
    good, rest = split(datagram, bad)
    if rest:
        bad["garbage"] += 1
    return good


def decode(received: Frame) -> Message:
    """What a good frame says. Raises ValueError should pymavlink see something wrong that `split` did not."""
    try:
        return _DECODER.decode(bytearray(received.raw))
    except mavlink.MAVError as error:
        raise ValueError(str(error)) from error


def unpack(datagram: bytes, bad: Counter[str]) -> list[tuple[Message, bytes]]:
    """The messages in a datagram, each with its frame; what is no good frame is counted in `bad` and skipped."""
    return [(decode(received), received.raw) for received in split_datagram(datagram, bad)]
