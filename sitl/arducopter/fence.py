"""ArduCopter's fence: FENCE_* parameters and the uploaded areas."""

import math

from sitl.arducopter.modes import Mode
from sitl.fence_in_force import FenceInForce
from sitl.geofence import Breach, Fence, areas

MAX_ALT, CIRCLE, AREAS, MIN_ALT = 1, 2, 4, 8
"""FENCE_TYPE."""
UNION = 2
"""FENCE_OPTIONS: one inclusion area is enough."""
FLOWN = {1: Mode.RTL, 2: Mode.LAND, 3: Mode.RTL, 4: Mode.BRAKE, 5: Mode.RTL}
"""FENCE_ACTION -> mode; 0 only tells. What SmartRTL would fly is flown as RTL."""
NAMES = {Breach.MAXALT: "Max Alt", Breach.MINALT: "Min Alt", Breach.BOUNDARY: "Boundary"}


class FenceOfParameters(FenceInForce):
    """ArduCopter's."""

    def _build(self) -> Fence:
        p = self._p
        if not p["FENCE_ENABLE"]:
            return Fence()
        kinds = int(p["FENCE_TYPE"])
        return Fence(
            areas(self._plans.fence, self._origin) if kinds & AREAS else (),
            any_inclusion=bool(int(p["FENCE_OPTIONS"]) & UNION),
            radius=p["FENCE_RADIUS"] if kinds & CIRCLE else math.inf,
            height_max=p["FENCE_ALT_MAX"] if kinds & MAX_ALT else math.inf,
            height_min=p["FENCE_ALT_MIN"] if kinds & MIN_ALT else -math.inf,
        )
