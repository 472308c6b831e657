"""How a check can end."""

from typing import Literal, NamedTuple

Verdict = Literal["pass", "fail", "skip"]


class Failed(Exception):  # noqa: N818  # a finding about the vehicle, not an error of ours
    """The clause was not kept; the text says what was seen."""


class Silent(Failed):
    """Nothing comes from the vehicle any more, or its clock stands still."""


class Skipped(Exception):  # noqa: N818
    """The clause does not apply here; the text says why."""


class Outcome(NamedTuple):
    """Of one check."""

    level: int
    name: str
    verdict: Verdict
    seen: str
    """What was measured, or why not."""
    clause: str
    seconds: float
    """Vehicle time that it took."""


def require(condition: bool, seen: str) -> None:
    """Raises Failed with what was seen unless the condition holds."""
    if not condition:
        raise Failed(seen)
