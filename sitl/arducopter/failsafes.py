"""ArduCopter's failsafes: what is wrong -> what is flown, as pure functions of parameters and state.

Unlike PX4's they act at once, and only once: a mode chosen afterwards is kept. SmartRTL is flown as RTL.
"""

from enum import Enum
from typing import NamedTuple

from sitl.arducopter.modes import Mode
from sitl.parameters import Parameters

ESTIMATOR_MS = 1000
"""How long there must be no position (EKF_CHECK_ITERATIONS_MAX at 10 Hz)."""
CRASH_MS = 2000
"""How long a vehicle must have lain crashed."""


class Wish(Enum):
    """What a parameter asks for."""

    NOTHING = "nothing"
    LAND = "land"
    RETURN = "return"
    BRAKE = "brake"
    HEIGHT = "hold the height"
    STOP = "stop the motors"


BATTERY = {
    0: Wish.NOTHING,
    1: Wish.LAND,
    2: Wish.RETURN,
    3: Wish.RETURN,
    4: Wish.RETURN,
    5: Wish.STOP,
    6: Wish.RETURN,
    7: Wish.BRAKE,
}
"""BATT_FS_LOW_ACT, BATT_FS_CRT_ACT."""
GROUND = {**BATTERY, 1: Wish.RETURN, 2: Wish.RETURN, 5: Wish.LAND}
"""FS_GCS_ENABLE."""
ESTIMATOR = {0: Wish.NOTHING, 1: Wish.LAND, 2: Wish.HEIGHT, 3: Wish.LAND}
"""FS_EKF_ACTION."""
EVEN_STABILIZE = 3
"""FS_EKF_ACTION that lands also from modes that need no position."""

CONTINUE_AUTO, CONTINUE_LANDING, CONTINUE_PILOT = 2, 8, 16
"""FS_OPTIONS, of a lost ground station."""
BY_PILOT = (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER, Mode.POSHOLD)
WITHOUT_POSITION = (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LAND)
"""Modes that fly without a position."""


class Situation(NamedTuple):
    """What the answer depends on."""

    mode: Mode
    flying: bool
    located: bool
    """Whether there is a position."""
    landing: bool = False


class Response(NamedTuple):
    """What is done."""

    mode: Mode | None = None
    """To be flown now; None: as it is."""
    stop: bool = False
    """The motors are stopped."""
    note: str = ""
    """What is told behind the failsafe's name."""


def respond(wish: Wish, now: Situation) -> Response:
    """On the ground the motors stop; without a position there is no return, and no brake."""
    if wish is Wish.NOTHING:
        return Response()
    if wish is Wish.STOP or not now.flying:
        return Response(stop=True)
    if wish is Wish.HEIGHT:
        return Response(Mode.ALT_HOLD)
    if wish is Wish.LAND or not now.located:
        return Response(Mode.LAND)
    return Response(Mode.BRAKE if wish is Wish.BRAKE else Mode.RTL)


def battery(level: int, p: Parameters, now: Situation) -> Response:
    """Of a battery that has just become low (1) or critical (2, 3)."""
    wish = BATTERY[int(p["BATT_FS_LOW_ACT" if level == 1 else "BATT_FS_CRT_ACT"])]
    if now.landing and int(p["FS_OPTIONS"]) & CONTINUE_LANDING and wish is not Wish.STOP and now.flying:
        return Response(note="Continuing Landing")
    return respond(wish, now)


def ground_station(p: Parameters, now: Situation) -> Response:
    """Of a ground station that has just gone silent."""
    enabled, options = int(p["FS_GCS_ENABLE"]), int(p["FS_OPTIONS"])
    wish = GROUND[enabled]
    if wish is Wish.NOTHING or not now.flying:
        return respond(wish, now)
    if now.mode is Mode.AUTO and (options & CONTINUE_AUTO or enabled == 2):
        return Response(note="Continuing Auto Mode")
    if now.landing and options & CONTINUE_LANDING:
        return Response(note="Continuing Landing")
    if now.mode in BY_PILOT and options & CONTINUE_PILOT:
        return Response(note="Continuing Pilot Control")
    return respond(wish, now)


def estimator(p: Parameters, now: Situation) -> Response:
    """Of a position that has just been lost."""
    action = int(p["FS_EKF_ACTION"])
    if now.mode in (Mode.STABILIZE, Mode.ALT_HOLD) and action != EVEN_STABILIZE:
        return Response()
    return respond(ESTIMATOR[action], now)
