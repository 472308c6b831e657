"""The ArduCopter personality under messages, setpoints and parameters of any content, and twice the same."""

import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from sitl.arducopter.parameters import TABLE
from sitl.arducopter.streams import GROUPS
from tests.sitl.copter import Copter, copter
from tests.sitl.test_hostile import messages

any_float = st.floats(width=32)
parameters = {parameter.name: parameter for parameter in TABLE}


@contextmanager
def hovering() -> Iterator[Copter]:
    """10 m up, every message on."""
    with copter() as vehicle:
        vehicle.take_off(10.0)
        for name in {name for group in GROUPS.values() for name in group} | {"FENCE_STATUS", "HIGHRES_IMU"}:
            vehicle.link.set_interval(name, 100_000.0, vehicle.time_ms)
        yield vehicle


def still_answers(vehicle: Copter) -> None:
    """Numbers are numbers, nothing was swallowed, and a command is answered."""
    vehicle.advance(200)
    assert all(map(math.isfinite, (*vehicle.position, *vehicle.velocity)))
    assert not vehicle.autopilot.defects
    assert vehicle.command(511, 1, 100_000) == 0


sometimes = settings(max_examples=25, deadline=None)


@sometimes
@given(st.lists(messages(), min_size=1, max_size=20))
def test_any_messages_leave_a_vehicle_that_answers(sequence):
    with hovering() as vehicle:
        for message in sequence:
            vehicle.send(message)
            vehicle.advance(50)
        still_answers(vehicle)


@sometimes
@given(
    st.integers(0, 20),
    st.sampled_from([0, 3527, 2503, 1479, 0xDF8, 0x9C0, 4095, 512]),
    st.lists(any_float, min_size=8, max_size=8),
)
def test_any_setpoint_is_flown_or_ignored(frame, mask, values):
    with hovering() as vehicle:
        x, y, z, vx, vy, vz, yaw, rate = values
        for _ in range(20):
            vehicle.send(
                mavlink.MAVLink_set_position_target_local_ned_message(
                    0, 1, 1, frame, mask, x, y, z, vx, vy, vz, 0.0, 0.0, 0.0, yaw, rate
                )
            )
            vehicle.advance(100)
        still_answers(vehicle)
        assert vehicle.position[2] <= 0.0


@sometimes
@given(st.lists(st.tuples(st.sampled_from(sorted(parameters)), any_float), min_size=1, max_size=20))
def test_any_parameters_leave_a_vehicle_that_flies(changes):
    """Values from the whole range of every parameter that is not about telemetry ids."""
    with hovering() as vehicle:
        for name, value in changes:
            if not name.startswith("MAV_"):
                vehicle.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, parameters[name].mav_type))
                vehicle.setpoint(3.0, 1.0, -1.0)
                vehicle.advance(200)
        still_answers(vehicle)


@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize(
    "name",
    [p.name for p in TABLE if p.name.startswith(("WPNAV_", "PSC_", "ATC_", "GUID_", "ANGLE_")) and p.high < 1e6],
)
def test_every_control_parameter_at_its_limits_still_flies(name, end):
    """It may fly badly; it must not become something that is no number, nor fall through the ground."""
    parameter = parameters[name]
    value = getattr(parameter, end)
    with copter() as vehicle:
        vehicle.take_off(10.0)
        vehicle.autopilot.vehicle.parameters.set(name, value)
        vehicle.stream(3, 4.0, -2.0, -1.0)
        still_answers(vehicle)
        assert vehicle.position[2] < 0.0


def test_same_inputs_give_the_same_bytes():
    """Deterministic to the bit in lockstep."""

    def flown() -> bytes:
        with copter() as vehicle:
            vehicle.take_off(8.0)
            vehicle.stream(4, 3.0, 2.0, -1.0, yaw=0.5)
            vehicle.fly(5)
            vehicle.command(20)
            vehicle.fly(10)
            return b"".join(vehicle.raw)

    first = flown()
    assert len(first) > 20_000
    assert struct.unpack("<B", first[:1]) == (0xFD,)
    assert flown() == first
