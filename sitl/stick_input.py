"""Sticks as they are held: the last ones that came, whether they are still there, and what is read from an axis."""

import math

from sitl.targets import Sticks

CENTRED = Sticks(0.0, 0.0, 0.0, 0.0)


def deadzone(value: float, width: float) -> float:
    """A stick axis with a dead middle of +-width, full deflection kept."""
    if abs(value) <= width:
        return 0.0
    return math.copysign((abs(value) - width) / (1.0 - width), value)


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Body to NED from Euler angles [rad], w first."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


class StickInput:
    """The sticks that came last, on vehicle time."""

    def __init__(self) -> None:
        self.now = CENTRED
        self._heard_ms: int | None = None

    def receive(self, sticks: Sticks, now_ms: int) -> None:
        self.now = sticks
        self._heard_ms = now_ms

    def give_back(self) -> None:
        """There are no sticks any more, and none are missed."""
        self.now = CENTRED
        self._heard_ms = None

    def alive(self, now_ms: int, loss_s: float) -> bool:
        """Whether they came less than so long ago."""
        return self._heard_ms is not None and now_ms - self._heard_ms < loss_s * 1000.0

    def lost(self, now_ms: int, loss_s: float) -> bool:
        """Whether there were sticks and are none now."""
        return self._heard_ms is not None and not self.alive(now_ms, loss_s)

    def moved(self, threshold: float) -> bool:
        """Whether the pilot pushes roll, pitch or yaw beyond a share of full deflection."""
        return max(abs(self.now.forward), abs(self.now.right), abs(self.now.yaw)) > threshold
