"""Fixtures of the simulated autopilot's tests; other rooms use `tests.sitl.process.sitl_process` directly."""

from collections.abc import Iterator

import pytest

from tests.sitl.client import Direct, direct


@pytest.fixture
def vehicle() -> Iterator[Direct]:
    """An autopilot in this process with default parameters, just booting."""
    with direct() as client:
        yield client


@pytest.fixture
def hovering(vehicle: Direct) -> Direct:
    """The same, hovering in AUTO.LOITER 10 m above home."""
    vehicle.take_off(499.4)
    vehicle.fly(3)  # PX4 says that it holds while it still climbs the last 0.8 m
    return vehicle
