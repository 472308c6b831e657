"""The parameter protocol's client side (mavlink.io, Parameter Protocol)."""

import struct
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance.outcome import Failed
from sitl.conformance.vehicle import ANSWER_S, ATTEMPTS, AUTOPILOT_COMPONENT, Message, Vehicle

LIST_S = 60.0
"""A list must have come within this."""
PAUSE_S = 1.0
"""A list that pauses so long has ended, and what is missing is asked for one by one."""
INTEGERS = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i"}
"""MAV_PARAM_TYPE -> struct format of a value that travels as its bytes."""


@dataclass(frozen=True)
class Value:
    """One PARAM_VALUE."""

    name: str
    value: float
    mav_type: int
    index: int
    count: int


def wire_id(name: str) -> bytes:
    return name.encode().ljust(16, b"\0")


def read_value(v: Vehicle, message: Message) -> Value:
    raw = message.param_value
    if v.autopilot.integers_bytewise and message.param_type in INTEGERS:
        kind = INTEGERS[message.param_type]
        (raw,) = struct.unpack_from(f"<{kind}", struct.pack("<f", raw))
    return Value(message.param_id, float(raw), message.param_type, message.param_index, message.param_count)


def to_wire(v: Vehicle, value: float, mav_type: int) -> float:
    if v.autopilot.integers_bytewise and mav_type in INTEGERS:
        (on_wire,) = struct.unpack("<f", struct.pack(f"<{INTEGERS[mav_type]}", round(value)).ljust(4, b"\0"))
        return float(on_wire)
    return value


def read(v: Vehicle, name: str, index: int = -1) -> Value | None:
    """PARAM_REQUEST_READ by name, or by index when that is not negative; None when nothing comes."""
    with v.hear("PARAM_VALUE") as heard:

        def found() -> list[Message]:
            return [m for m in heard if (m.param_index == index if index >= 0 else m.param_id == name)]

        for _ in range(ATTEMPTS):
            v.send(
                mavlink.MAVLink_param_request_read_message(
                    v.system, AUTOPILOT_COMPONENT, wire_id(name if index < 0 else ""), index
                )
            )
            if v.answered(found):
                return read_value(v, found()[-1])
    return None


def write(v: Vehicle, name: str, value: float) -> Value | None:
    """PARAM_SET of a parameter that is there; the value that is told then. Raises Failed when there is none."""
    known = read(v, name)
    if known is None:
        raise Failed(f"parameter {name} is not there")
    with v.hear("PARAM_VALUE") as heard:

        def found() -> list[Message]:
            return [m for m in heard if m.param_id == name]

        for _ in range(ATTEMPTS):
            v.send(
                mavlink.MAVLink_param_set_message(
                    v.system, AUTOPILOT_COMPONENT, wire_id(name), to_wire(v, value, known.mav_type), known.mav_type
                )
            )
            if v.answered(found):
                v.changed.setdefault(name, known.value)
                return read_value(v, found()[-1])
    return None


def change(v: Vehicle, settings: tuple[tuple[str, float], ...]) -> None:
    """Set those of these parameters that are there; `restore` undoes it."""
    for name, value in settings:
        if read(v, name) is not None:
            write(v, name, value)


def restore(v: Vehicle) -> list[str]:
    """Give every changed parameter its first value again; the names of those that did not take it."""
    lost = []
    for name, value in v.changed.items():
        told = write(v, name, value)
        if told is None or abs(told.value - value) > 1e-6 * max(abs(value), 1.0):
            lost.append(name)
    v.changed.clear()
    return lost


def read_all(v: Vehicle) -> dict[int, Value]:
    """PARAM_REQUEST_LIST, and what is missing then by its index. By index; Failed when it does not end."""
    values: dict[int, Value] = {}
    with v.hear("PARAM_VALUE") as heard:
        v.send(mavlink.MAVLink_param_request_list_message(v.system, AUTOPILOT_COMPONENT))
        end = v.time_ms + LIST_S * 1000.0
        while True:
            before = len(heard)
            if not v.answered(lambda before=before: len(heard) > before, PAUSE_S if heard else ANSWER_S):  # type: ignore[misc]
                break
            if v.time_ms > end:
                raise Failed(f"the list did not end within {LIST_S:g} s; {len(heard)} values had come")
        for message in heard:
            if message.param_index < message.param_count:  # 65535: not of the list
                values[message.param_index] = read_value(v, message)
    if not values:
        raise Failed("PARAM_REQUEST_LIST: nothing came")
    for index in range(next(iter(values.values())).count):
        if index not in values:
            found = read(v, "", index)
            if found is not None:
                values[index] = found
    return values
