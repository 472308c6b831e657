"""Parameters: real names and defaults, and the protocol over UDP with PX4's bytewise integers."""

import json
import struct
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import development as mavlink

from sitl.parameters import INT32, ParameterError, Parameters, from_wire, to_wire
from sitl.px4.parameters import TABLE

DATA = Path(__file__).parent / "data"
OURS = {"BAT1_CAPACITY", "COM_LOW_BAT_ACT"}
"""Where the default is not the recorded value, with the reason in sitl/px4/parameters.py."""
REAL = [parameter for parameter in TABLE if not parameter.name.startswith("SITL_")]


def test_names_types_and_defaults_are_px4s():
    recorded = json.loads((DATA / "px4_params.json").read_text())
    p = Parameters(TABLE)
    assert len(REAL) >= 115
    for parameter in REAL:
        value, mav_type = recorded[parameter.name]
        assert parameter.mav_type == mav_type, parameter.name
        if parameter.name not in OURS:
            assert p[parameter.name] == value, parameter.name


@pytest.mark.parametrize(
    ("assignment", "words"),
    [
        ("NO_SUCH=1", ["NO_SUCH", "unknown"]),
        ("MPC_XY_VELMAX=1", ["MPC_XY_VELMAX", "nearest", "MPC_XY_VEL_MAX"]),
        ("sih_mas=1", ["sih_mas", "nearest", "SIH_MASS"]),
        ("SIH_MASS=0", ["SIH_MASS", "0", "0.1 to 100"]),
        ("SIH_MASS=nan", ["SIH_MASS", "nan"]),
        ("SIH_MASS=heavy", ["SIH_MASS", "heavy"]),
        ("RTL_CONE_ANG=1", ["RTL_CONE_ANG", "0, 25, 45, 65, 80, 90"]),
        ("MAV_TYPE=2.5", ["MAV_TYPE", "2.5"]),
        ("SIH_MASS", ["SIH_MASS", "NAME=VALUE"]),
    ],
)
def test_bad_assignments_name_the_parameter_and_what_is_allowed(assignment, words):
    p = Parameters(TABLE)
    with pytest.raises(ParameterError) as error:
        p.assign(assignment)
    assert all(word in str(error.value) for word in words)
    assert len(str(error.value)) < 120
    assert p.changes == 0


def test_wire_form_is_bytewise():
    p = Parameters(TABLE)
    capacity, action = p.parameter("BAT1_CAPACITY"), p.parameter("COM_OBL_RC_ACT")
    assert to_wire(action, 4, bytewise=True) == b"\x04\0\0\0"
    assert to_wire(capacity, 5000.0, bytewise=True) == struct.pack("<f", 5000.0)
    assert from_wire(action, to_wire(action, 3, bytewise=True), bytewise=True) == 3


def bytewise(value: int) -> float:
    return struct.unpack("<f", struct.pack("<i", value))[0]


def values(vehicle):
    return [m for m in vehicle.messages if m.get_type() == "PARAM_VALUE"]


def read(vehicle, name: str, index: int = -1) -> None:
    vehicle.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), index))
    vehicle.advance()


def write(vehicle, name: str, value: float, mav_type: int) -> None:
    vehicle.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, mav_type))
    vehicle.advance()


def test_list_is_complete_and_counted(vehicle):
    """AUTOPILOT.md 1: `param_count` equals what is sent."""
    vehicle.send(mavlink.MAVLink_param_request_list_message(1, 1))
    vehicle.fly(0.5)
    got = values(vehicle)
    assert [m.param_index for m in got] == list(range(len(got)))
    assert {m.param_count for m in got} == {len(got)}
    p = Parameters(TABLE)
    for m in got:
        raw = struct.pack("<f", m.param_value)
        assert from_wire(p.parameter(m.param_id), raw, bytewise=True) == p[m.param_id]


def test_set_acts_and_reads_back(vehicle):
    write(vehicle, "COM_OBL_RC_ACT", bytewise(4), INT32)
    write(vehicle, "MPC_XY_VEL_MAX", 3.0, 9)
    read(vehicle, "COM_OBL_RC_ACT")
    last = values(vehicle)[-1]
    assert struct.pack("<f", last.param_value) == struct.pack("<i", 4)
    assert vehicle.commander._p["COM_OBL_RC_ACT"] == 4
    assert vehicle.autopilot.vehicle.model.gains.speed_xy_max == 3.0


def test_read_by_index(vehicle):
    read(vehicle, "", 3)
    assert values(vehicle)[-1].param_id == Parameters(TABLE).names[3]


def test_unknown_name_is_silence(vehicle):
    """AUTOPILOT.md 1: unknown name: silence (PX4)."""
    read(vehicle, "NO_SUCH")
    write(vehicle, "NO_SUCH", 1.0, 9)
    read(vehicle, "", 999)
    assert values(vehicle) == []


@pytest.mark.parametrize(("value", "mav_type"), [(0.0, 9), (float("nan"), 9), (float("inf"), 9), (2.0, INT32)])
def test_refused_value_changes_nothing_and_says_so(vehicle, value, mav_type):
    write(vehicle, "SIH_MASS", value, mav_type)
    assert values(vehicle)[-1].param_value == 1.0
    assert any("SIH_MASS" in text for text in vehicle.texts())
