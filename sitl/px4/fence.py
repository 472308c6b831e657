"""PX4's geofence: GF_* parameters and the uploaded areas."""

import math

from sitl.fence_in_force import FenceInForce
from sitl.flight.reference import Vec3
from sitl.geofence import Fence, areas
from sitl.plan import PLACES, place

CHECK_MS = 200
"""How often PX4's navigator looks."""


class FenceOfParameters(FenceInForce):
    """PX4's."""

    def _build(self) -> Fence:
        return Fence(
            areas(self._plans.fence, self._origin),
            any_inclusion=True,
            radius=self._p["GF_MAX_HOR_DIST"] or math.inf,
            height_max=self._p["GF_MAX_VER_DIST"] or math.inf,
        )

    def waypoint_outside(self, home: Vec3) -> int | None:
        """Number (from 1) of the first waypoint of the mission that is outside; None when all are inside."""
        fence = self.now()
        if not fence.there:
            return None
        for number, item in enumerate(self._plans.mission, 1):
            flown_to = item.command in PLACES and not item.here
            if flown_to and fence.breach(place(item, self._origin, home, home), home):
                return number
        return None
