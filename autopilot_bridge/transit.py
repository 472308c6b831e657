"""The way to the start position: straight, from rest to rest, as fast as the limits allow."""

from dataclasses import dataclass

import numpy as np

from airframe.slot_profile import Reference, Vector
from autopilot_bridge.config import Limits


@dataclass(frozen=True)
class Transit:
    """Trapezoid of speed along the line from `start` to `goal` [m, ENU] at the `limits`."""

    start: Vector
    goal: Vector
    limits: Limits

    @property
    def duration_s(self) -> float:
        if self._length == 0:
            return 0.0
        speed, ramp_s = self._cruise()
        return ramp_s + self._length / speed

    def at(self, time_s: float) -> Reference:
        """The reference `time_s` after the departure; at rest in `goal` after `duration_s`."""
        duration_s = self.duration_s
        if duration_s == 0 or time_s >= duration_s:
            return Reference(self.goal, np.zeros(3), np.zeros(3))
        speed, ramp_s = self._cruise()
        direction = (self.goal - self.start) / self._length
        acceleration = speed / ramp_s
        left_s = duration_s - time_s
        if time_s < ramp_s:
            along, pace, change = acceleration * time_s**2 / 2, acceleration * time_s, acceleration
        elif left_s < ramp_s:
            along, pace, change = self._length - acceleration * left_s**2 / 2, acceleration * left_s, -acceleration
        else:
            along, pace, change = speed * (time_s - ramp_s / 2), speed, 0.0
        return Reference(self.start + direction * along, direction * pace, direction * change)

    @property
    def _length(self) -> float:
        return float(np.linalg.norm(self.goal - self.start))

    def _cruise(self) -> tuple[float, float]:
        """Cruising speed [m/s] and the time to reach it [s]; a short way never gets beyond half of it."""
        east, north, up = np.abs(self.goal - self.start) / self._length
        climbing = self.goal[2] > self.start[2]
        acceleration = 1 / float(self.limits.time_to_change((self.goal - self.start) / self._length))
        speed = (self._length * acceleration) ** 0.5
        if (horizontal := float(np.hypot(east, north))) > 1e-9:
            speed = min(speed, self.limits.horizontal_mps / horizontal)
        if up > 1e-9:
            speed = min(speed, (self.limits.up_mps if climbing else self.limits.down_mps) / up)
        return speed, speed / acceleration
