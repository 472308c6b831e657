"""What a check is: a function with a level, a name and the clause that it holds the autopilot to."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from sitl.conformance.vehicle import Vehicle


class State(Enum):
    """What the vehicle is to be like when a check begins."""

    FRESH = "fresh"
    """As it was found: these come first."""
    ANY = "any"
    """Whatever it is like."""
    GROUND = "ground"
    """Disarmed and ready to arm."""
    AIR = "air"
    """Hovering near where it took off."""


@dataclass(frozen=True)
class Check:
    """`run` returns what was measured, or raises Failed or Skipped."""

    level: int
    name: str
    clause: str
    """Where it is written what is right: a page of mavlink.io, a message, a parameter, a page of the autopilot's."""
    state: State
    run: Callable[[Vehicle], str]


CHECKS: list[Check] = []
"""All there are, in the order in which they are run within their level; filled by `check`."""

Run = Callable[[Vehicle], str]


def check(level: int, state: State, clause: str) -> Callable[[Run], Run]:
    """Declares a function to be a check; its name, with spaces, is the check's."""

    def declare(run: Run) -> Run:
        CHECKS.append(Check(level, run.__name__.replace("_", " "), clause, state, run))
        return run

    return declare
