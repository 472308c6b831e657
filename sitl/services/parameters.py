"""The parameter protocol: PARAM_REQUEST_READ, PARAM_SET, PARAM_REQUEST_LIST -> PARAM_VALUE.

An unknown name is answered with silence; a value that is not
allowed changes nothing and is answered with the value in force.
"""

import math
import struct

from sitl.links.frames import Message, pack
from sitl.links.link import Link
from sitl.parameters import ParameterError, from_wire, to_wire
from sitl.vehicle import Vehicle

CAST_MARGIN = 0.01
"""What ArduPilot adds before it casts to an integer (AP_Param::set_float)."""
PER_TICK = 10
"""Values sent per tick while a list is under way: about PX4's 1000 per second."""


def name_in(message: Message) -> str:
    """param_id, of a name of any bytes."""
    raw = message.param_id
    return raw if isinstance(raw, str) else bytes(raw).decode("ascii", "replace")


def send_value(v: Vehicle, link: Link, index: int) -> None:
    """PARAM_VALUE of the parameter at an index."""
    parameter = v.parameters.parameter(v.parameters.names[index])
    (as_float,) = struct.unpack("<f", to_wire(parameter, v.parameters[parameter.name], v.personality.integers_bytewise))
    link.send(
        pack(
            "PARAM_VALUE",
            param_id=parameter.name.encode(),
            param_value=as_float,
            param_type=parameter.mav_type,
            param_count=len(v.parameters),
            param_index=index,
        )
    )


def param_request_read(v: Vehicle, link: Link, message: Message) -> None:
    index = message.param_index
    if index == -1:
        name = name_in(message)
        if name not in v.parameters:
            return
        index = v.parameters.names.index(name)
    if 0 <= index < len(v.parameters):
        send_value(v, link, index)


def param_set(v: Vehicle, link: Link, message: Message) -> None:
    name = name_in(message)
    if name not in v.parameters:
        return
    parameter = v.parameters.parameter(name)
    try:
        bytewise = v.personality.integers_bytewise
        if bytewise and message.param_type != parameter.mav_type:
            raise ParameterError(f"parameter {name}: type {message.param_type} is not {parameter.mav_type}")
        value = from_wire(parameter, struct.pack("<f", message.param_value), bytewise)
        if parameter.integer and math.isfinite(value):
            value = int(value + math.copysign(CAST_MARGIN, value))  # ArduPilot casts whatever comes
        v.parameters.set(name, value)
    except ParameterError as error:
        v.commander.say(str(error), 4)
    send_value(v, link, v.parameters.names.index(name))


def param_request_list(v: Vehicle, link: Link, message: Message) -> None:
    link.parameters_pending = 0


def continue_list(v: Vehicle, link: Link) -> None:
    """Send the next values of a list under way; called every tick."""
    if link.parameters_pending is None:
        return
    end = min(link.parameters_pending + PER_TICK, len(v.parameters))
    for index in range(link.parameters_pending, end):
        send_value(v, link, index)
    link.parameters_pending = end if end < len(v.parameters) else None
