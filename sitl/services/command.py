"""A command, whichever way it came."""

import math
from dataclasses import dataclass

from sitl.links.frames import Message

UNSPECIFIED = (0x7FFFFFFF, 0x7FF80000)
"""COMMAND_INT.x and y that stand for NaN."""


@dataclass(frozen=True)
class Command:
    """COMMAND_LONG or COMMAND_INT; x, y are degrees and z metres."""

    number: int
    p: tuple[float, float, float, float]
    x: float
    y: float
    z: float
    frame: int = 0
    """MAV_FRAME of x, y, z."""


def from_long(m: Message) -> Command:
    p = (m.param1, m.param2, m.param3, m.param4)
    return Command(m.command, p, m.param5, m.param6, m.param7)


def from_int(m: Message) -> Command:
    p = (m.param1, m.param2, m.param3, m.param4)
    x, y = (math.nan if value in UNSPECIFIED else value * 1e-7 for value in (m.x, m.y))
    return Command(m.command, p, x, y, m.z, m.frame)
