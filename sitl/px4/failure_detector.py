"""PX4's failure detector: a vehicle that tips over, a motor that gives nothing."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sitl.flight.physics import euler
from sitl.parameters import Parameters


class FailureDetector:
    """Remembers since when something has been wrong."""

    def __init__(self) -> None:
        self._tipped_ms: list[int | None] = [None, None]
        self._silent_ms: list[int | None] = [None] * 4

    def overturned(self, attitude: NDArray[np.float64], p: Parameters, now_ms: int) -> bool:
        """Whether roll or pitch have been beyond FD_FAIL_R, FD_FAIL_P [deg, 0 = off] for as long as *_TTRI [s]."""
        failed = False
        for axis, (angle, name) in enumerate(zip(euler(attitude)[:2], ("FD_FAIL_R", "FD_FAIL_P"), strict=True)):
            beyond = 0.0 < math.radians(p[name]) < abs(angle)
            since = self._tipped_ms[axis] = since_when(self._tipped_ms[axis], beyond, now_ms)
            failed |= since is not None and now_ms - since >= p[f"{name}_TTRI"] * 1000.0
        return failed

    def motor_failed(
        self, health: Sequence[float], commands: NDArray[np.float64], p: Parameters, now_ms: int, flying: bool
    ) -> bool:
        """Whether a motor that is asked for more than FD_ACT_MOT_THR has given nothing for FD_ACT_MOT_TOUT [ms]."""
        failed = False
        for motor, share in enumerate(health):
            asked = share == 0.0 and flying and bool(commands[motor] > p["FD_ACT_MOT_THR"])
            if asked or share > 0.0 or not flying:  # a failure once seen stays, whatever is asked then
                self._silent_ms[motor] = since_when(self._silent_ms[motor], asked, now_ms)
            since = self._silent_ms[motor]
            failed |= since is not None and now_ms - since >= p["FD_ACT_MOT_TOUT"]
        return failed and bool(p["FD_ACT_EN"])


def since_when(before: int | None, true: bool, now_ms: int) -> int | None:
    """When something that is true now became so."""
    return (now_ms if before is None else before) if true else None
