"""Vehicle time on the wall clock, whatever the wall clock does."""

from collections.abc import Callable

BEHIND_MAX_S = 0.1
"""A vehicle that is further behind the wall clock lets the wall clock go, rather than rush."""


class Pacer:
    """Says when the next tick is due. Vehicle time itself is counted in ticks, so that no clock can make it jump."""

    def __init__(self, tick_s: float, speed: float, clock: Callable[[], float]) -> None:
        self._period = tick_s / speed
        self._clock = clock
        self._due = clock() + self._period

    def wait_s(self) -> float:
        """Wall time until the next tick: at most one tick, 0 when it is due. A clock that went back starts anew."""
        now = self._clock()
        if self._due - now > self._period:
            self._due = now + self._period
        return min(max(self._due - now, 0.0), self._period)

    def ticked(self) -> None:
        """A tick was done; what a slow machine or a clock that leapt ahead left undone is forgotten."""
        now = self._clock()
        self._due = now + self._period if now - self._due > BEHIND_MAX_S else self._due + self._period

    def restart(self) -> None:
        """The vehicle stood still meanwhile."""
        self._due = self._clock() + self._period
