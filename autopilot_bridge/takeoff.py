"""Whether a takeoff was ended by somebody before its height.

PX4 takes off in a mode of its own and hovers in AUTO.LOITER after it, the mode that a pilot's hold is in, too: only the
height tells them apart. ArduCopter takes off in GUIDED, where every other mode is somebody else's.
"""

from dataclasses import dataclass, field

from autopilot_bridge.deadman import Moment
from autopilot_bridge.vehicle import Mode

SETTLE_S = 3.0
"""So long the vehicle may stay below its height once the takeoff's mode is over: it may still be on its way."""


@dataclass
class Takeoff:
    """One takeoff to `height_m`, that the autopilot ends in the mode `ready`."""

    ready: Mode
    height_m: float
    _begun: bool = field(default=False, init=False)
    _over: Moment | None = field(default=None, init=False)
    """Since when the mode has been `ready` again, below the height."""

    def broken_off(self, mode: Mode, height_m: float, now: Moment) -> bool:
        """Whether somebody has ended it, by all that was told up to now."""
        self._begun = self._begun or mode is Mode.TAKEOFF
        if not self._begun or mode is not self.ready or height_m >= self.height_m:
            self._over = None
            return False
        if self._over is None:
            self._over = now
        return now.since(self._over) > SETTLE_S
