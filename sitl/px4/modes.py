"""PX4's flight modes and their numbers on the wire."""

from enum import Enum


class Mode(Enum):
    """Flight modes by PX4's name; values begin with (main mode, sub mode) of `custom_mode`."""

    ALTCTL = (2, 0)
    POSCTL = (3, 0)
    STABILIZED = (7, 0)
    TAKEOFF = (4, 2)
    LOITER = (4, 3)
    MISSION = (4, 4)
    RTL = (4, 5)
    LAND = (4, 6)
    OFFBOARD = (6, 0)
    DESCEND = (4, 6, "without position")
    """A failsafe only; on the wire it looks like LAND."""


STICKS = (Mode.ALTCTL, Mode.POSCTL, Mode.STABILIZED)
"""Modes that need a pilot's sticks."""
STICK_MAIN_MODES = (1, 5, 8)
"""Main modes that need them too, and are not flown here: MANUAL, ACRO, RATTITUDE."""

BASE_MODE = {
    Mode.ALTCTL: 0x51,
    Mode.POSCTL: 0x51,
    Mode.STABILIZED: 0x51,
    Mode.TAKEOFF: 0x1D,
    Mode.LOITER: 0x1D,
    Mode.MISSION: 0x1D,
    Mode.RTL: 0x1D,
    Mode.LAND: 0x1D,
    Mode.OFFBOARD: 0x11,
    Mode.DESCEND: 0x1D,
}
"""HEARTBEAT.base_mode while disarmed; armed adds 0x80."""


def custom_mode(mode: Mode) -> int:
    """HEARTBEAT.custom_mode."""
    main, sub = mode.value[:2]
    return int(main << 16 | sub << 24)


NAMES = {
    Mode.ALTCTL: ("Altitude", 4),
    Mode.POSCTL: ("Position", 1),
    Mode.STABILIZED: ("Stabilized", 0),
    Mode.TAKEOFF: ("Takeoff", 8),
    Mode.LOITER: ("Hold", 0),
    Mode.MISSION: ("Mission", 6),
    Mode.RTL: ("Return", 5),
    Mode.LAND: ("Land", 7),
    Mode.OFFBOARD: ("Offboard", 0),
}
"""PX4's names of its modes, and the MAV_STANDARD_MODE that each is."""


def mode_of(number: int) -> Mode | None:
    """The mode of a HEARTBEAT.custom_mode; sub modes count only under AUTO."""
    main, sub = number >> 16 & 0xFF, number >> 24
    for mode in Mode:
        if mode.value[0] == main and (mode.value[1] == sub or main != Mode.LOITER.value[0]):
            return mode
    return None


def mode_number(main: float, sub: float) -> int:
    """custom_mode of DO_SET_MODE's main and sub mode; -1 for what is none."""
    if main not in range(256):
        return -1
    return int(main) << 16 | (int(sub) << 24 if sub in range(256) else 0)
