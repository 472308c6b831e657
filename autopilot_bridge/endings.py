"""How a flight, or a phase of it, ends before its time: raised from a step of vehicle time."""

import contextlib
import traceback

from autopilot_bridge.vehicle import Mode

AS_PLANNED, ERROR, FAILSAFE = 0, 1, 3
"""Exit codes, the bridge's and those of `aerialstar fly`; 2 is bad input."""


class End(Exception):  # noqa: N818  not an error: the flight's last decision
    """Come down by `mode` (None: as the vehicle does by itself) and exit with `code`."""

    def __init__(self, mode: Mode | None, code: int, why: str) -> None:
        super().__init__(why)
        self.mode, self.code = mode, code


class Yielded(Exception):  # noqa: N818  not an error: the pilot's right
    """Somebody else flies the vehicle now."""


def in_our_code(error: Exception) -> str:
    """A mistake of ours in one line; where it is goes to our error output."""
    with contextlib.suppress(OSError, ValueError):  # that may be on a full disk
        traceback.print_exception(error)
    return f"{type(error).__name__} in the bridge: {error}"
