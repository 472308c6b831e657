"""What the vehicle believes of itself: the truth, and on top what its sensors and its estimator get wrong.

There is no Kalman filter here. The estimate is the truth plus a smooth error: a second-order Gauss-Markov process per
axis, whose derivative is the error of the velocity, so that the two fit together as an estimator's do. The vehicle is
controlled by the estimate, so it really wanders by the error. Without GPS the error is no longer pulled back to zero.
"""

import math
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

ERROR_RATE = 0.1
"""Bandwidth of the estimator's error [rad/s]: it wanders within some tens of seconds."""


class Loss(IntEnum):
    """What a vehicle can be without."""

    GPS = 0
    GCS = 1
    """A ground station's heartbeats are not heard."""
    STICKS = 2
    ESTIMATOR = 3
    """There is no solution: no position, no arming."""


class Faults:
    """What was injected."""

    def __init__(self) -> None:
        self._until_ms = [0.0] * len(Loss)
        self.motors = [1.0, 1.0, 1.0, 1.0]
        """What is left of each motor's thrust."""

    def lose(self, what: Loss, until_ms: float) -> None:
        """Be without it until a vehicle time; inf = until it is given back, 0 = give it back."""
        self._until_ms[what] = until_ms

    def lost(self, what: Loss, now_ms: int) -> bool:
        return now_ms < self._until_ms[what]


class Estimator:
    """Whether there is a position, and how wrong it is."""

    def __init__(self, error_m: float, seed: int) -> None:
        """`error_m` is the standard deviation of the position on each axis [m]; 0 = none."""
        self._error_m = error_m
        self._random = np.random.default_rng((seed, 0x45535449))
        self.position_error: NDArray[np.float64] = np.zeros(3)
        self.velocity_error: NDArray[np.float64] = np.zeros(3)
        self._aided_ms = 0
        self.gps = True
        """Whether the receiver has a fix."""
        self.valid = True
        """Whether the position is believed."""

    @property
    def perfect(self) -> bool:
        return self._error_m == 0.0

    def step(self, now_ms: int, gps: bool, solution: bool, dead_reckoning_s: float) -> None:
        """A position lasts `dead_reckoning_s` beyond the last fix; without a `solution` there is none."""
        self.gps = gps
        if gps and solution:
            self._aided_ms = now_ms
        self.valid = solution and now_ms - self._aided_ms <= dead_reckoning_s * 1000.0

    def wander(self, dt: float) -> None:
        """Let the errors move on by dt [s]."""
        rate = ERROR_RATE
        drive = 2.0 * rate**1.5 * self._error_m * math.sqrt(dt) * self._random.standard_normal(3)
        if self.gps:
            pull = 2.0 * rate * self.velocity_error + rate * rate * self.position_error
            self.velocity_error += drive - pull * dt
        else:
            self.velocity_error += drive
        self.position_error += self.velocity_error * dt


ACCELEROMETER, GYRO, GPS, BAROMETER = 0.03, 0.002, 0.1, 0.02
"""Standard deviations [m/s2, rad/s, m, hPa] of what the raw sensor messages show."""


def measured(true: NDArray[np.float64], deviation: float, random: np.random.Generator) -> tuple[float, float, float]:
    """A vector [3] with white noise on each axis."""
    x, y, z = (true + deviation * random.standard_normal(3)).tolist()
    return x, y, z
