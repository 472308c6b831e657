"""Wind: a mean and Dryden gusts (MIL-F-8785C, low altitude), seeded.

The gusts' axes are those of the mean wind: along it, across it, and down (MIL-F-8785C has the flight path there, which
a hovering vehicle has not). Without a mean wind, along is north. Longitudinal gusts are filtered once, transverse ones
twice, at the rate at which the frozen gust field passes the vehicle.
"""

import math
from typing import NamedTuple

import numpy as np

from sitl.flight.reference import Vec3

FOOT_M = 0.3048
HEIGHT_MIN_FT, HEIGHT_MAX_FT = 10.0, 1000.0
"""Where the low-altitude model holds; heights outside are taken as the nearer end."""
AIRSPEED_MIN = 1.0
"""Slower than this through the air [m/s], gusts pass as at this speed: a frozen gust field would stand still."""
ROOT3 = math.sqrt(3.0)
BLOCK = 1024


class Wind(NamedTuple):
    """What the air does."""

    mean: Vec3 = (0.0, 0.0, 0.0)
    """NED, towards where it blows [m/s]."""
    w20: float = 0.0
    """Wind speed 20 ft above the ground [m/s] that the gusts belong to: 7.7 light, 15 moderate, 23 severe; 0 = none."""


class Turbulence(NamedTuple):
    """Standard deviations [m/s] and lengths [m] of gusts."""

    sigma_horizontal: float
    sigma_vertical: float
    length_horizontal: float
    length_vertical: float


def turbulence(w20: float, height_m: float) -> Turbulence:
    """MIL-F-8785C, 3.7.3: low-altitude intensities and scales at a height above the ground."""
    h = min(max(height_m / FOOT_M, HEIGHT_MIN_FT), HEIGHT_MAX_FT)
    base = 0.177 + 0.000823 * h
    vertical = 0.1 * w20
    return Turbulence(vertical / base**0.4, vertical, h / base**1.2 * FOOT_M, h * FOOT_M)


class Gusts:
    """Filtered noise; the same seed gives the same gusts."""

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng((seed, 0x57494E44))
        self._normals: list[float] = []
        self._along = 0.0
        self._across = (0.0, 0.0)
        self._down = (0.0, 0.0)

    def _normal(self) -> float:
        if not self._normals:
            self._normals = self._random.standard_normal(BLOCK).tolist()
        return self._normals.pop()

    def step(self, wind: Wind, height_m: float, airspeed: float, dt: float) -> Vec3:
        """The air's velocity, NED [m/s], after dt [s] of flight at a speed through the air [m/s]."""
        t = turbulence(wind.w20, height_m)
        speed = max(airspeed, AIRSPEED_MIN)
        keep = math.exp(-dt * speed / t.length_horizontal)
        self._along = keep * self._along + math.sqrt(1.0 - keep * keep) * self._normal()
        self._across = second_order(self._across, keep, self._normal())
        self._down = second_order(self._down, math.exp(-dt * speed / t.length_vertical), self._normal())
        along = t.sigma_horizontal * self._along
        across = t.sigma_horizontal * transverse(self._across)
        down = t.sigma_vertical * transverse(self._down)
        north, east, sink = wind.mean
        mean = math.hypot(north, east)
        c, s = (north / mean, east / mean) if mean > 1e-6 else (1.0, 0.0)
        return north + c * along - s * across, east + s * along + c * across, sink + down


def second_order(state: tuple[float, float], keep: float, normal: float) -> tuple[float, float]:
    """One step of 1 / (1 + T s)^2: the first lag has variance 1."""
    first = keep * state[0] + math.sqrt(1.0 - keep * keep) * normal
    return first, keep * state[1] + (1.0 - keep) * first


def transverse(state: tuple[float, float]) -> float:
    """(1 + sqrt(3) T s) / (1 + T s)^2 of white noise, with variance 1."""
    return (ROOT3 * state[0] + (1.0 - ROOT3) * state[1]) * math.sqrt(0.5)
