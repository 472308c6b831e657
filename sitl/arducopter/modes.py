"""ArduCopter's flight modes and their numbers on the wire."""

from enum import IntEnum


class Mode(IntEnum):
    """Flight modes that this vehicle can fly; the value is HEARTBEAT.custom_mode."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    POSHOLD = 16
    BRAKE = 17


AUTONOMOUS = frozenset({Mode.AUTO, Mode.GUIDED, Mode.RTL, Mode.LAND, Mode.BRAKE})
"""Modes that fly without sticks."""
ARMABLE = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.GUIDED, Mode.LOITER, Mode.POSHOLD})
"""Modes in which a ground station may arm (AUTO only with a mission)."""


STANDARD = {Mode.ALT_HOLD: 4, Mode.AUTO: 6, Mode.LOITER: 1, Mode.RTL: 5, Mode.LAND: 7}
"""MAV_STANDARD_MODE of the modes that are one."""


def mode_of(number: int) -> Mode | None:
    """The mode of a custom_mode; None when this vehicle has no such mode."""
    return Mode(number) if number in Mode.__members__.values() else None


def mode_number(custom: float, _: float) -> int:
    """custom_mode of DO_SET_MODE's param2; -1 when it is none."""
    return int(custom) if custom in range(256) else -1


def base_mode(mode: Mode, armed: bool) -> int:
    """HEARTBEAT.base_mode as recorded: custom mode, stabilised, sticks; guided where it flies by itself; armed."""
    guided = mode is Mode.GUIDED or (armed and mode in AUTONOMOUS | {Mode.LOITER, Mode.POSHOLD})
    return 0x51 | (0x08 if guided else 0) | (0x80 if armed else 0)
