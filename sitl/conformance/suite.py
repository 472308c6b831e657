"""All checks, in order."""

from sitl.conformance import connect, failures, flight, stores
from sitl.conformance.checks import CHECKS, Check, State

LEVELS = {0: connect, 1: flight, 2: stores, 3: failures}
"""Level -> the module of its checks."""


def selected(highest: int = 3, names: frozenset[str] = frozenset()) -> list[Check]:
    """The checks of the levels up to `highest`, or of them only those with these names; what wants a fresh vehicle
    comes first."""
    chosen = [check for check in CHECKS if check.level <= highest and (not names or check.name in names)]
    return sorted(chosen, key=lambda check: (check.state is not State.FRESH, check.level))


def names() -> list[str]:
    return [check.name for check in CHECKS]
