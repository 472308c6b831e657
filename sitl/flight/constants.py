"""The flight model's constants as one array of numbers, for the way into compiled code.

A call pays for every Python object it hands over: as tuples of tuples of floats they took 3 us more of a tick's 33.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from sitl.flight.compiled import compiled
from sitl.flight.control import Gains
from sitl.flight.physics import Rotorcraft


def packed(gains: Gains, craft: Rotorcraft) -> NDArray[np.float64]:
    """All numbers of both, in the order of their fields."""
    return np.array(list(_numbers((*gains, *craft))))


def _numbers(values: Iterable[float | tuple[float, ...]]) -> Iterable[float]:
    for value in values:
        yield from value if isinstance(value, tuple) else (value,)


@compiled
def three(n: NDArray[np.float64], at: int) -> tuple[float, float, float]:
    return n[at], n[at + 1], n[at + 2]


@compiled
def unpacked_gains(n: NDArray[np.float64]) -> Gains:
    return Gains(
        position_p=three(n, 0),
        velocity_p=three(n, 3),
        velocity_i=three(n, 6),
        velocity_d=three(n, 9),
        velocity_derivative_hz=n[12],
        speed_xy_max=n[13],
        speed_up_max=n[14],
        speed_down_max=n[15],
        tilt_max=n[16],
        thrust_min=n[17],
        thrust_max=n[18],
        thrust_xy_margin=n[19],
        hover_thrust=n[20],
        attitude_p=three(n, 21),
        yaw_weight=n[24],
        rate_max=three(n, 25),
        rate_p=three(n, 28),
        rate_i=three(n, 31),
        rate_d=three(n, 34),
        rate_integral_max=three(n, 37),
        yaw_torque_hz=n[40],
    )


GAINS = 41
"""How many numbers the gains are; the craft's follow."""


@compiled
def unpacked_craft(n: NDArray[np.float64]) -> Rotorcraft:
    return Rotorcraft(
        mass=n[GAINS],
        inertia=three(n, GAINS + 1),
        arm_roll=n[GAINS + 4],
        arm_pitch=n[GAINS + 5],
        thrust_max=n[GAINS + 6],
        torque_max=n[GAINS + 7],
        motor_lag=n[GAINS + 8],
        drag=n[GAINS + 9],
        angular_drag=n[GAINS + 10],
        drag_quadratic=n[GAINS + 11],
        panel=n[GAINS + 12],
        health=(n[GAINS + 13], n[GAINS + 14], n[GAINS + 15], n[GAINS + 16]),
    )
