"""The deadman ladder: what is flown when nobody says what to fly, or nobody knows where.

    rung        begins when                                         what flies the vehicle
    ---------   -------------------------------------------------   ----------------------------------------------------
    FLY         an action came in time                              its slot profile (before the slots: the way there)
    HOLD        a slot's opening is older than the deadline         planned hold: brake at the acceleration limit, stay
    HOLD_MODE   the last good action is older than `hold_mode_s`,   the autopilot's own hold mode (PX4 AUTO.LOITER,
                or the last position older than `BLIND_S`           ArduCopter BRAKE); no setpoints
    RETURN      either is older than `grace_s`                      the autopilot's own return mode; latched
    LAND        `return_s` after the vehicle was sent home, or      the autopilot's own land mode; latched
                when it cannot return

              deadline passed       hold_mode_s             grace_s                 return_s, or refused
         FLY ----------------> HOLD -----------> HOLD_MODE -----------> RETURN -----------------------> LAND
          ^                     |                    |
          +---------------------+--------------------+
             a good action in time (and a position)

    from any of them:
         a mode that is not ours in a HEARTBEAT  ->  yielded: no setpoints, no modes of ours, until `resume`
         nothing heard for 0.3 s                 ->  dark: no mode is asked for, since it would arrive after a failsafe
         nothing heard for 3 s of wall clock     ->  silent: no setpoints, the autopilot's own failsafe acts; heard
                                                     again, its mode is obeyed, or sent home if it is still ours
         we have not listened for `STALL_S`, or  ->  nothing is sent before a HEARTBEAT that is news for certain has
         nothing came that we could steer by         told that the mode is still ours

Without a good action rungs only climb. All times are judged on two clocks, whichever says more: vehicle time, and the
wall clock in seconds of vehicle time (times the speed of a simulation), since vehicle time may stand still. In lockstep
the vehicle stands still while we wait for something, so there both are vehicle time, and the wall clock counts only
through `action_wait_wall_s`. Silence is judged on the wall clock alone.

Below all of this stands the autopilot's own failsafe, which needs nothing from us but that we stop (docs/safety.md says
where PX4 has none: in takeoff and in its hold mode).

Time is an argument everywhere, so that tests need no sleep.
"""

from dataclasses import dataclass, field
from enum import IntEnum
from math import inf
from typing import NamedTuple

SILENCE_WALL_S = 3.0
HEARTBEAT_WALL_S = 10.0
"""An autopilot that speaks but tells no mode for so long is as good as silent; many in a row may be lost."""
DARK_S = 0.3
"""Having heard nothing for so long we ask for no mode: it may arrive after a failsafe has chosen another."""
STALE_S = 0.5
"""No setpoint is computed from a position older than this."""
MODE_OLD_S = 1.5
"""No setpoint is sent on the word of a HEARTBEAT older than this; some autopilots keep to one a second."""
BLIND_S = 1.0
"""Without a position for so long the vehicle is given to the autopilot; PX4's own failsafe begins at 1.5 s."""
STALL_S = 0.5
"""Whoever has not listened for so long cannot know the mode: PX4 takes a stream for lost after 1 s."""


class Moment(NamedTuple):
    """An instant on both clocks."""

    vehicle_s: float
    wall_s: float
    """The wall clock, in seconds of vehicle time; vehicle time again where the vehicle waits for us."""

    def since(self, then: "Moment") -> float:
        """Time passed [s], by the clock that says more."""
        return max(self.vehicle_s - then.vehicle_s, self.wall_s - then.wall_s)


NEVER = Moment(-inf, -inf)


class Rung(IntEnum):
    """See the module's table."""

    FLY = 0
    HOLD = 1
    HOLD_MODE = 2
    RETURN = 3
    LAND = 4


@dataclass
class Deadman:
    """Judges actions and positions."""

    deadline_s: float
    hold_mode_s: float
    grace_s: float
    return_s: float
    why: str = field(default="", init=False)
    """The rung's reason, in words."""

    def __post_init__(self) -> None:
        self._heard = self._placed = self._told_mode = NEVER
        self._acted: Moment | None = None
        """None: no actions are awaited."""
        self._opened = NEVER
        self._answered = True
        self._missed = False
        self._expired = ""
        self._sent_home: Moment | None = None
        self._home_because = ""
        self._landing = ""

    def heard(self, now: Moment) -> None:
        """Something came from the autopilot."""
        self._heard = now

    def placed(self, now: Moment) -> None:
        """A new position was told."""
        self._placed = now

    def told_mode(self, now: Moment) -> None:
        """A HEARTBEAT came."""
        self._told_mode = now

    def opened(self, now: Moment) -> None:
        """A slot opened. The first one counts as a good action."""
        self._missed = self._missed or not self._answered
        self._opened, self._answered = now, False
        if self._acted is None:
            self._acted = now

    def acted(self, now: Moment) -> None:
        """A good action for the open slot came in time."""
        self._acted, self._answered, self._missed = now, True, False

    def sent_home(self, now: Moment, why: str) -> None:
        """The vehicle was told to return."""
        if self._sent_home is None:
            self._sent_home, self._home_because = now, why

    def land(self, why: str) -> None:
        """It was told to land, or cannot return."""
        self._landing = self._landing or why

    @property
    def coming_down(self) -> bool:
        """Whether it was told to come down."""
        return self._sent_home is not None or bool(self._landing)

    def late(self, now: Moment) -> bool:
        """Whether the open slot's action can no longer come in time."""
        return not self._answered and now.since(self._opened) > self.deadline_s

    def dark(self, now: Moment) -> bool:
        """Whether the vehicle's mode may be another by now."""
        return now.since(self._heard) > DARK_S or now.since(self._told_mode) > MODE_OLD_S

    def stale(self, now: Moment) -> bool:
        """Whether what is known of the vehicle is too old to steer it."""
        return now.since(self._placed) > STALE_S or now.since(self._told_mode) > MODE_OLD_S

    def rung(self, now: Moment) -> Rung:
        """What to do now. RETURN and LAND are final."""
        rung, self.why = self._judge(now)
        return rung

    def _judge(self, now: Moment) -> tuple[Rung, str]:
        if self._sent_home is not None and now.since(self._sent_home) > self.return_s:
            self.land(f"not on the ground {self.return_s:g} s after it was sent home")
        if self._landing:
            return Rung.LAND, self._landing
        lost_s, idle_s = now.since(self._placed), now.since(self._acted) if self._acted is not None else 0.0
        if not self._expired and max(lost_s, idle_s) > self.grace_s:
            self._expired = f"no {'good action' if idle_s > self.grace_s else 'position'} for {self.grace_s:g} s"
        if self._sent_home is not None or self._expired:
            return Rung.RETURN, self._expired or self._home_because
        if lost_s > BLIND_S:
            return Rung.HOLD_MODE, f"no position for {BLIND_S:g} s"
        if idle_s > self.hold_mode_s:
            return Rung.HOLD_MODE, f"no good action for {self.hold_mode_s:g} s"
        self._missed = self._missed or self.late(now)
        if self._missed:
            return Rung.HOLD, "no good action by the deadline"
        return Rung.FLY, "a good action in time"


@dataclass
class Attention:
    """Judges whether we have been listening. A process that was frozen has not, whatever its socket's buffer holds.

    By the wall clock alone: vehicle time also leaps when it was not told for a while.
    """

    listened: Moment

    def stalled(self, now: Moment) -> bool:
        """Whether something may have happened that we could not hear."""
        return now.wall_s - self.listened.wall_s > STALL_S


@dataclass
class Silence:
    """Judges the autopilot's telemetry on the wall clock [s]."""

    wall_s: float
    limit_s: float = SILENCE_WALL_S
    heard: int = 0

    def over(self, heard: int, wall_s: float) -> bool:
        """Whether the count of messages `heard` has stood still for too long."""
        if heard != self.heard:
            self.heard, self.wall_s = heard, wall_s
        return wall_s - self.wall_s > self.limit_s

    def excuse(self, wall_s: float) -> None:
        """We kept the vehicle waiting: start counting anew."""
        self.wall_s = wall_s
