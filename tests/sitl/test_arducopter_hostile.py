"""The ArduCopter personality under messages, setpoints and parameters of any content, and twice the same."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from sitl.arducopter.parameters import TABLE
from sitl.arducopter.streams import GROUPS
from tests.sitl.copter import copter
from tests.sitl.fuzzing import Prey, prepared
from tests.sitl.test_hostile import messages

any_float = st.floats(width=32)
parameters = {parameter.name: parameter for parameter in TABLE}


def hovering() -> Prey:
    """10 m up in GUIDED, every message on; copied from one that took off once."""
    prey = prepared("arducopter", flying=True)
    for name in {name for group in GROUPS.values() for name in group} | {"FENCE_STATUS", "HIGHRES_IMU"}:
        prey.wire.links[0].set_interval(name, 100_000.0, prey.autopilot.now_ms)
    return prey


def velocity(north: float, east: float, down: float) -> object:
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 2503, 0.0, 0.0, 0.0, north, east, down, 0.0, 0.0, 0.0, 0.0, 0.0
    )


def still_answers(prey: Prey) -> None:
    """Numbers are numbers, nothing was swallowed, and a ping and a command are answered."""
    prey.wait(200)
    prey.check()
    prey.wire.sent.clear()
    prey.say(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 1, 100_000, 0, 0, 0, 0, 0))
    prey.wait(50)
    told = [mavlink.MAVLink(None).decode(bytearray(raw)) for raw in prey.wire.sent]
    assert [m.result for m in told if m.get_type() == "COMMAND_ACK" and m.command == 511] == [0]


def down(prey: Prey) -> float:
    """Below home [m]."""
    return float(prey.autopilot.vehicle.model.truth.position[2])


sometimes = settings(max_examples=75, deadline=None)


@sometimes
@given(st.lists(messages(), min_size=1, max_size=20))
def test_any_messages_leave_a_vehicle_that_answers(sequence):
    prey = hovering()
    for message in sequence:
        prey.say(message)
        prey.wait(50)
    still_answers(prey)


@sometimes
@given(
    st.integers(0, 20),
    st.sampled_from([0, 3527, 2503, 1479, 0xDF8, 0x9C0, 4095, 512]),
    st.lists(any_float, min_size=8, max_size=8),
)
def test_any_setpoint_is_flown_or_ignored(frame, mask, values):
    prey = hovering()
    x, y, z, vx, vy, vz, yaw, rate = values
    for _ in range(20):
        prey.say(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0, 1, 1, frame, mask, x, y, z, vx, vy, vz, 0.0, 0.0, 0.0, yaw, rate
            )
        )
        prey.wait(100)
    still_answers(prey)
    assert down(prey) <= 0.0


@sometimes
@given(st.lists(st.tuples(st.sampled_from(sorted(parameters)), any_float), min_size=1, max_size=20))
def test_any_parameters_leave_a_vehicle_that_flies(changes):
    """Values from the whole range of every parameter that is not about telemetry ids."""
    prey = hovering()
    for name, value in changes:
        if not name.startswith("MAV_"):
            prey.say(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, parameters[name].mav_type))
            prey.say(velocity(3.0, 1.0, -1.0))
            prey.wait(200)
    still_answers(prey)


@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize(
    "name",
    [p.name for p in TABLE if p.name.startswith(("WPNAV_", "PSC_", "ATC_", "GUID_", "ANGLE_")) and p.high < 1e6],
)
def test_every_control_parameter_at_its_limits_still_flies(name, end):
    """It may fly badly; it must not become something that is no number, nor fall through the ground."""
    prey = hovering()
    prey.autopilot.vehicle.parameters.set(name, getattr(parameters[name], end))
    for _ in range(60):
        prey.say(velocity(4.0, -2.0, -1.0))
        prey.wait(50)
    still_answers(prey)
    assert down(prey) < 0.0


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
