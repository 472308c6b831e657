"""The geofence in force: what a personality makes of its parameters and the uploaded fence."""

from abc import ABC, abstractmethod

from sitl.geofence import Fence
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.plan import Plans


class FenceInForce(ABC):
    """Built anew only when a parameter or the uploaded fence has changed."""

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
            self._fence = self._build()
        return self._fence

    @abstractmethod
    def _build(self) -> Fence:
        """By the personality's parameters."""
