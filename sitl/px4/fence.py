"""PX4's geofence: GF_* parameters and the uploaded areas."""

import math

from sitl.flight.reference import Vec3
from sitl.geofence import Fence, areas
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.plan import PLACES, Plans, place

CHECK_MS = 200
"""How often PX4's navigator looks."""


class FenceOfParameters:
    """The fence in force, built anew only when a parameter or the uploaded fence has changed."""

    def __init__(self, p: Parameters, plans: Plans, origin: Origin) -> None:
        self._p = p
        self._plans = plans
        self._origin = origin
        self._built_for: tuple[int, int] | None = None
        self._fence = Fence()

    def now(self) -> Fence:
        state = (self._p.changes, self._plans.fence_changes)
        if state != self._built_for:
            self._built_for = state
            self._fence = Fence(
                areas(self._plans.fence, self._origin),
                any_inclusion=True,
                radius=self._p["GF_MAX_HOR_DIST"] or math.inf,
                height_max=self._p["GF_MAX_VER_DIST"] or math.inf,
            )
        return self._fence

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
