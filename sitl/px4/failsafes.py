"""PX4's failsafes: what is wrong -> what is flown; pure functions of conditions, parameters and what was before.

Every cause asks for an action and the most severe one is taken, at first as a hold of COM_FAIL_ACT_T, which is the
pilot's time to take over by a change of mode (PX4's commander/failsafe). What cannot be flown falls through to what
can.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import NamedTuple

from sitl.parameters import Parameters
from sitl.px4.modes import Mode

FLIGHT_TERMINATION_OFF = 121212
"""CBRK_FLIGHTTERM that keeps the failure detector from stopping the motors."""
NO_DELAY_S = 0.1
"""COM_FAIL_ACT_T up to this is none."""
RECOVERY = 0.25
"""How much slower a used delay is filled up again, so that a cause that comes and goes is acted on in the end."""


class Action(IntEnum):
    """In order of severity."""

    NONE = 0
    WARN = 1
    POSITION = 2
    ALTITUDE = 3
    STABILIZED = 4
    HOLD = 5
    RETURN = 6
    LAND = 7
    DESCEND = 8
    DISARM = 9
    TERMINATE = 10


class Takeover(IntEnum):
    """How a pilot may overrule an action, from freely to not at all."""

    ALWAYS = 0
    MODE_SWITCH = 1
    NEVER = 2


FLOWN = {
    Action.POSITION: Mode.POSCTL,
    Action.ALTITUDE: Mode.ALTCTL,
    Action.STABILIZED: Mode.STABILIZED,
    Action.HOLD: Mode.LOITER,
    Action.RETURN: Mode.RTL,
    Action.LAND: Mode.LAND,
    Action.DESCEND: Mode.DESCEND,
}
"""The mode of an action; the others leave the mode as it is."""

OVERRULED = (Action.HOLD, Action.RETURN, Action.LAND, Action.DESCEND)
"""What a pilot can take over from."""

A = Action
LINK_LOSS = {1: A.HOLD, 2: A.RETURN, 3: A.LAND, 5: A.TERMINATE, 6: A.DISARM}
"""NAV_RCL_ACT, NAV_DLL_ACT."""
FENCE = {1: A.WARN, 2: A.HOLD, 3: A.RETURN, 4: A.TERMINATE, 5: A.LAND}
"""GF_ACTION, COM_WIND_MAX_ACT."""
ACTUATOR = {0: A.WARN, 1: A.HOLD, 2: A.LAND, 3: A.RETURN, 4: A.TERMINATE}
"""COM_ACT_FAIL_ACT."""
CRITICAL_BATTERY = {0: A.WARN, 1: A.RETURN, 2: A.LAND, 3: A.RETURN}
EMERGENCY_BATTERY = {0: A.WARN, 1: A.RETURN, 2: A.LAND, 3: A.LAND}
"""COM_LOW_BAT_ACT."""
STREAM_LOSS = {
    0: (A.POSITION, Mode.POSCTL),
    1: (A.ALTITUDE, Mode.ALTCTL),
    2: (A.STABILIZED, Mode.STABILIZED),
    3: (A.RETURN, Mode.RTL),
    4: (A.LAND, Mode.LAND),
    5: (A.HOLD, Mode.LOITER),
    6: (A.TERMINATE, Mode.OFFBOARD),
    7: (A.DISARM, Mode.OFFBOARD),
}
"""COM_OBL_RC_ACT -> action, and the mode that is then checked."""

MISSION_BIT, AUTO_BIT, OFFBOARD_BIT = 1, 2, 4
"""COM_RCL_EXCEPT."""
EXCEPTED = {Mode.MISSION: MISSION_BIT, Mode.LOITER: AUTO_BIT, Mode.TAKEOFF: AUTO_BIT, Mode.OFFBOARD: OFFBOARD_BIT}
WITHOUT_POSITION = (Mode.ALTCTL, Mode.STABILIZED, Mode.DESCEND)
"""Modes that fly without a position."""


class Conditions(NamedTuple):
    """What is wrong."""

    stream_lost: bool = False
    """No OFFBOARD setpoints."""
    sticks_lost: bool = False
    """Sticks that were there at arming, or later, are gone."""
    ground_lost: bool = False
    """The ground station's heartbeats stay away."""
    battery: int = 0
    """1 low, 2 critical, 3 emergency."""
    battery_at_arming: int = 0
    breached: bool = False
    position_lost: bool = False
    overturned: bool = False
    """The failure detector's FD_FAIL_R, FD_FAIL_P."""
    motor_failed: bool = False
    windy: bool = False
    """More wind than COM_WIND_MAX."""
    overdue: bool = False
    """In the air longer than COM_FLT_TIME_MAX."""
    just_armed: bool = False
    """Within COM_SPOOLUP_TIME and COM_LKDOWN_TKO of arming."""
    attitude_only: bool = False
    """What OFFBOARD flies needs no position."""


class Reaction(NamedTuple):
    """What a cause asks for."""

    action: Action
    takeover: Takeover | None = None
    """None: freely, after a delay (or by a mode change, where COM_FAIL_ACT_T is 0)."""
    sticky: bool = False
    """It lasts until the mode is changed, also when the cause is gone."""


@dataclass(frozen=True)
class Failsafe:
    """What is done, and what that depends on."""

    action: Action = Action.NONE
    cause: str = ""
    reactions: Mapping[str, Reaction] = field(default_factory=dict)
    delay_s: float = 0.0
    """Left of the hold."""
    waits: bool = False
    """Whether what is done is that hold."""
    next_delay_s: float | None = None
    """How long the next hold will be; None: COM_FAIL_ACT_T."""
    taken_over: bool = False
    by_sticks: bool = False
    """Whether this step is the one in which sticks took over."""

    def mode(self, intended: Mode) -> Mode:
        """What is flown when the user wants `intended`."""
        return FLOWN.get(self.action, intended)

    @property
    def idle(self) -> bool:
        """Whether nothing is wrong or remembered."""
        return self == IDLE


IDLE = Failsafe()


def can_fly(mode: Mode, c: Conditions) -> bool:
    """Whether a mode can be flown under these conditions."""
    if mode is Mode.OFFBOARD:
        return not c.stream_lost and (c.attitude_only or not c.position_lost)
    return mode in WITHOUT_POSITION or not c.position_lost


def link_loss(action: Action) -> Reaction:
    """The reaction to a lost link: an end of the flight is not to be overruled."""
    if action >= Action.DISARM:
        return Reaction(action, Takeover.NEVER, sticky=action is Action.TERMINATE)
    return Reaction(action, sticky=True)


def limit(action: Action) -> Reaction:
    """The reaction to a fence or the wind: a hold can be left by a mode change, so that there is a way out."""
    if action is Action.HOLD:
        return Reaction(action, Takeover.MODE_SWITCH, sticky=True)
    if action is Action.TERMINATE:
        return Reaction(action, Takeover.NEVER, sticky=True)
    return Reaction(action, sticky=action > Action.HOLD)


def battery_reaction(c: Conditions, p: Parameters) -> Reaction:
    """COM_LOW_BAT_ACT; a level that was there at arming is only told."""
    worse = int(p["COM_LOW_BAT_ACT"]) if c.battery > c.battery_at_arming else 0
    return Reaction((Action.WARN, CRITICAL_BATTERY[worse], EMERGENCY_BATTERY[worse])[c.battery - 1])


def detector_reaction(c: Conditions, p: Parameters) -> Reaction:
    """An overturned vehicle: disarmed just after arming, then terminated where CBRK_FLIGHTTERM allows."""
    if c.just_armed:
        return Reaction(Action.DISARM)
    return Reaction(Action.WARN if int(p["CBRK_FLIGHTTERM"]) == FLIGHT_TERMINATION_OFF else Action.TERMINATE)


def fallback(c: Conditions, intended: Mode, p: Parameters) -> Action:
    """What is flown in place of a mode that cannot be."""
    action = Action.NONE
    if intended is Mode.OFFBOARD and c.stream_lost:
        action, intended = STREAM_LOSS[int(p["COM_OBL_RC_ACT"])]
        if action >= Action.DISARM:
            return action
    if intended is Mode.POSCTL and not can_fly(intended, c):
        if p["COM_POSCTL_NAVL"]:
            return Action.LAND
        action, intended = Action.ALTITUDE, Mode.ALTCTL
    return action if can_fly(intended, c) else Action.RETURN


def reactions(c: Conditions, intended: Mode, p: Parameters) -> dict[str, Reaction]:
    """What every cause that is there asks for."""
    asked = {}
    if c.sticks_lost and not int(p["COM_RCL_EXCEPT"]) & EXCEPTED.get(intended, 0):
        asked["sticks"] = link_loss(LINK_LOSS[int(p["NAV_RCL_ACT"])])
    if c.ground_lost and int(p["NAV_DLL_ACT"]) and intended is not Mode.LAND:
        asked["ground"] = link_loss(LINK_LOSS[int(p["NAV_DLL_ACT"])])
    if c.windy and int(p["COM_WIND_MAX_ACT"]):
        asked["wind"] = limit(FENCE[int(p["COM_WIND_MAX_ACT"])])
    if c.overdue:
        asked["flight time"] = Reaction(Action.RETURN)
    if c.breached and int(p["GF_ACTION"]):
        asked["fence"] = limit(FENCE[int(p["GF_ACTION"])])
    if c.battery:
        asked[f"battery {c.battery}"] = battery_reaction(c, p)
    if c.overturned:
        asked["attitude"] = detector_reaction(c, p)
    if c.motor_failed:
        action = ACTUATOR[int(p["COM_ACT_FAIL_ACT"])]
        asked["motor"] = Reaction(action, sticky=action > Action.HOLD)
    instead = fallback(c, intended, p)
    if instead:
        lost = "offboard" if c.stream_lost and intended is Mode.OFFBOARD else "position"
        asked[lost] = Reaction(instead, Takeover.ALWAYS)
    return asked


def possible(action: Action, c: Conditions) -> Action:
    """The action, or else the first more severe one that can be flown."""
    while action in FLOWN and not can_fly(FLOWN[action], c):
        action = Action(action + 1)
    return action


def follow(
    before: Failsafe, c: Conditions, intended: Mode, p: Parameters, dt: float, new_mode: bool, sticks_moved: bool
) -> Failsafe:
    """The failsafe dt [s] later. `new_mode`: the user has just chosen a mode; `sticks_moved`: a pilot wants control."""
    if before.action is Action.TERMINATE:
        return before
    full = p["COM_FAIL_ACT_T"]
    next_delay = full if before.next_delay_s is None else before.next_delay_s
    delay, taken_over = max(before.delay_s - dt, 0.0), before.taken_over
    asked = reactions(c, intended, p)
    known: dict[str, Reaction] = {}
    for cause, reaction in before.reactions.items():
        if cause in asked:
            known[cause] = reaction._replace(action=asked[cause].action)
        elif reaction.sticky and not (new_mode or taken_over):
            known[cause] = reaction
    for cause, reaction in asked.items():
        if cause in known:
            continue
        takeover = reaction.takeover
        if takeover is None:
            takeover = Takeover.ALWAYS if full > NO_DELAY_S else Takeover.MODE_SWITCH
            if full > NO_DELAY_S and reaction.action > Action.WARN and delay == 0.0:
                delay = next_delay
        known[cause] = reaction._replace(takeover=takeover)
        taken_over = taken_over and reaction.action < Action.HOLD
    if before.action > Action.HOLD or taken_over or not can_fly(Mode.LOITER, c):
        delay = 0.0
    step = replace(before, reactions=known, delay_s=delay, taken_over=taken_over, by_sticks=False)
    step = chosen(step, c, intended, p, new_mode and not before.by_sticks, sticks_moved)
    next_delay = max(next_delay - dt, 0.0) if step.waits else min(next_delay + RECOVERY * dt, full)
    return replace(step, next_delay_s=None if next_delay == full else next_delay)


def chosen(
    step: Failsafe, c: Conditions, intended: Mode, p: Parameters, new_mode: bool, sticks_moved: bool
) -> Failsafe:
    """The action taken of those asked for, with the delay and the pilot's takeover; `step.action` is the one before."""
    action, cause, takeover = Action.NONE, "", Takeover.ALWAYS
    for name, reaction in step.reactions.items():
        takeover = max(takeover, reaction.takeover or Takeover.ALWAYS)
        if reaction.action > action:
            action, cause = reaction.action, name
    delayed = Action.NONE
    if (
        step.delay_s > 0.0
        and not step.taken_over
        and takeover <= Takeover.MODE_SWITCH
        and Action.WARN < action < Action.DISARM
    ):
        delayed, action, takeover = action, Action.HOLD, Takeover.MODE_SWITCH
    switched = new_mode and step.action is action
    wanted = step.taken_over or switched or (sticks_moved and takeover is Takeover.ALWAYS)
    if action in OVERRULED and wanted and takeover < Takeover.NEVER:
        by_sticks = sticks_moved and not step.taken_over and not switched
        instead = fallback(c, Mode.POSCTL if by_sticks else intended, p)
        action = possible(max(Action.WARN, instead), c)
        return replace(step, action=action, cause=cause, taken_over=True, by_sticks=by_sticks, waits=False)
    action = possible(action, c)
    if intended is Mode.LAND and Action.RETURN in (action, delayed) and can_fly(Mode.LAND, c):
        action, delayed = Action.WARN, Action.NONE  # it lands already
    return replace(step, action=action, cause=cause if action else "", taken_over=False, waits=delayed > Action.NONE)
