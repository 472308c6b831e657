"""The deadman ladder: what is flown when nobody says what to fly.

    time since ...                   rung      what happens
    -------------------------------  --------  ------------------------------------------------------------------
    (an action in time)              FLY       its slot profile
    slot's opening > deadline        HOLD      planned hold: brake at the acceleration limit, stay there
    last good action > grace         RETURN    the autopilot's own return mode; final
    last telemetry > 3 s wall clock  SILENT    no setpoints: the autopilot's offboard-loss failsafe acts

           action in time               no action for `grace`
        +-----------------+        +---------------------------> RETURN (latched)
        v                 |        |
       FLY ----------> HOLD -------+
        |   deadline       |
        |   passed         |
        +--------+---------+
                 | no telemetry for 3 s of wall clock
                 v
              SILENT  (heard again: the autopilot has taken over; obeyed until an explicit `resume`)

The deadline and the grace run on vehicle time. Silence runs on the wall clock, since a dead link also stops vehicle
time. Below all of this stands the autopilot's own failsafe, which needs nothing from us but that we stop.

Time is an argument everywhere, so that tests need no sleep.
"""

from dataclasses import dataclass
from enum import Enum

SILENCE_WALL_S = 3.0


class Rung(Enum):
    """See the module's table."""

    FLY = "fly"
    HOLD = "hold"
    RETURN = "return"


@dataclass
class Deadman:
    """Judges the stream of actions on vehicle time [s]. `started_s` counts as the first good action."""

    deadline_s: float
    grace_s: float
    started_s: float

    def __post_init__(self) -> None:
        self._opened_s = self._acted_s = self.started_s
        self._answered = False
        self._expired = False

    def opened(self, time_s: float) -> None:
        """A slot opened."""
        self._opened_s, self._answered = time_s, False

    def acted(self, time_s: float) -> None:
        """A good action for the open slot came in time."""
        self._acted_s, self._answered = time_s, True

    def rung(self, time_s: float) -> Rung:
        """What to do now. RETURN is final."""
        self._expired = self._expired or time_s - self._acted_s > self.grace_s
        if self._expired:
            return Rung.RETURN
        late = time_s - self._opened_s > self.deadline_s
        return Rung.HOLD if late and not self._answered else Rung.FLY


@dataclass
class Silence:
    """Judges the autopilot's telemetry on the wall clock [s]."""

    wall_s: float
    heard: int = 0

    def over(self, heard: int, wall_s: float) -> bool:
        """Whether the count of messages `heard` has stood still for too long."""
        if heard != self.heard:
            self.heard, self.wall_s = heard, wall_s
        return wall_s - self.wall_s > SILENCE_WALL_S

    def excuse(self, wall_s: float) -> None:
        """We kept the vehicle waiting: start counting anew."""
        self.wall_s = wall_s
