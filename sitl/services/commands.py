"""The command protocol: COMMAND_LONG, COMMAND_INT and SET_MODE, each answered with COMMAND_ACK at once.

A handler returns the result, or None where the autopilot does not answer at all.
"""

import math
from collections.abc import Callable

from sitl.links.frames import Message, name_of, pack
from sitl.links.link import Link
from sitl.personality import Result
from sitl.services import failure_injection, goto, modes
from sitl.services.command import Command, from_int, from_long
from sitl.vehicle import Vehicle

FORCE = 21196.0
"""COMPONENT_ARM_DISARM.param2 that overrides the checks."""
HOME_ALTITUDE_MAX_M = 20_000.0


def arm_disarm(v: Vehicle, _: Link, command: Command) -> Result | None:
    force = command.p[1] == FORCE
    if command.p[0] == 1.0:
        return v.commander.arm(force)
    if command.p[0] == 0.0:
        return v.commander.disarm(force)
    return v.personality.answers.bad_arm_value


def do_set_mode(v: Vehicle, _: Link, command: Command) -> Result:
    _base, main, sub, _p4 = command.p
    return v.commander.set_mode(v.personality.mode_number(main, sub))


def takeoff(v: Vehicle, _: Link, command: Command) -> Result:
    return v.commander.takeoff(command.z)


def land(v: Vehicle, _: Link, command: Command) -> Result:
    return v.commander.land()


def return_to_launch(v: Vehicle, _: Link, command: Command) -> Result:
    return v.commander.return_home()


def mission_start(v: Vehicle, _: Link, command: Command) -> Result:
    return v.commander.start_mission(command.p[0], command.p[1])


def set_home(v: Vehicle, _: Link, command: Command) -> Result:
    if command.p[0] == 1.0:
        v.commander.set_home(v.position())
        return Result.ACCEPTED
    if not (abs(command.x) <= 90.0 and abs(command.y) <= 180.0 and abs(command.z) <= HOME_ALTITUDE_MAX_M):
        return Result.DENIED
    north, east = v.origin.local(command.x, command.y)
    v.commander.set_home((north, east, v.origin.altitude - command.z))
    return Result.ACCEPTED


def request_message(v: Vehicle, link: Link, command: Command) -> Result:
    number = command.p[0]
    name = name_of(int(number)) if math.isfinite(number) else None
    if name == "MESSAGE_INTERVAL":
        return get_message_interval(v, link, Command(0, (command.p[1], 0.0, 0.0, 0.0), 0.0, 0.0, 0.0))
    if name == "AVAILABLE_MODES":
        return modes.available_modes(v, link, command.p[1])
    if name is None or name not in v.personality.messages:
        return v.personality.answers.unknown_message
    payload = v.personality.messages[name](v)
    if payload is None:
        return Result.TEMPORARILY_REJECTED
    link.send(payload)
    return Result.ACCEPTED


def set_message_interval(v: Vehicle, link: Link, command: Command) -> Result:
    number, interval_us = command.p[:2]
    name = name_of(int(number)) if math.isfinite(number) else None
    if name is None or name not in v.personality.messages or not math.isfinite(interval_us):
        return v.personality.answers.unknown_interval
    link.set_interval(name, interval_us, v.now_ms)
    return Result.ACCEPTED


def get_message_interval(v: Vehicle, link: Link, command: Command) -> Result:
    name = name_of(int(command.p[0])) if math.isfinite(command.p[0]) else None
    if name is None or name not in v.personality.messages:
        return v.personality.answers.unknown_message
    link.send(pack("MESSAGE_INTERVAL", message_id=int(command.p[0]), interval_us=link.interval_us(name)))
    return Result.ACCEPTED


def _send(name: str) -> Callable[[Vehicle, Link, Command], Result]:
    def send(v: Vehicle, link: Link, command: Command) -> Result:
        payload = v.personality.messages[name](v)
        if payload is None:
            return Result.TEMPORARILY_REJECTED
        link.send(payload)
        return Result.ACCEPTED

    return send


HANDLERS: dict[int, Callable[[Vehicle, Link, Command], Result | None]] = {
    20: return_to_launch,
    21: land,
    22: takeoff,
    176: do_set_mode,
    178: goto.do_change_speed,
    179: set_home,
    192: goto.do_reposition,
    193: goto.do_pause_continue,
    207: goto.do_fence_enable,
    224: goto.do_set_mission_current,
    300: mission_start,
    400: arm_disarm,
    410: _send("HOME_POSITION"),
    420: failure_injection.inject_failure,
    510: get_message_interval,
    511: set_message_interval,
    512: request_message,
    519: _send("PROTOCOL_VERSION"),
    520: _send("AUTOPILOT_VERSION"),
}
"""By MAV_CMD number; every other command is UNSUPPORTED."""


def answer(v: Vehicle, link: Link, message: Message, command: Command) -> None:
    """Do a command and send its COMMAND_ACK."""
    handler = HANDLERS.get(command.number)
    result = Result.UNSUPPORTED if handler is None else handler(v, link, command)
    if result is not None:
        acknowledge(link, message, command.number, result)


def acknowledge(link: Link, message: Message, number: int, result: Result) -> None:
    link.send(
        pack(
            "COMMAND_ACK",
            command=number,
            result=int(result),
            progress=0,
            result_param2=0,
            target_system=message.get_srcSystem(),
            target_component=message.get_srcComponent(),
        )
    )


def command_long(v: Vehicle, link: Link, message: Message) -> None:
    answer(v, link, message, from_long(message))


def command_int(v: Vehicle, link: Link, message: Message) -> None:
    answer(v, link, message, from_int(message))


def set_mode(v: Vehicle, link: Link, message: Message) -> None:
    """SET_MODE is DO_SET_MODE in an older dress; PX4 acknowledges it as such."""
    result = v.commander.set_mode(message.custom_mode)
    if v.personality.answers.set_mode:
        acknowledge(link, message, 176, result)
