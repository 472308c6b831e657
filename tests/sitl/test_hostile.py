"""Well-formed messages with any content at all: the vehicle flies on and no exception comes out."""

import math
import struct

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from sitl.autopilot import SERVICES
from sitl.services.commands import HANDLERS
from tests.sitl.client import Direct

KINDS = {kind.msgname: kind for kind in mavlink.mavlink_map.values()}
RANGES = {"int8_t": 8, "int16_t": 16, "int32_t": 32, "int64_t": 64}
any_float = st.floats(width=32)
likely_float = st.one_of(any_float, st.sampled_from([0.0, 1.0, 2.0, 4.0, 6.0, 21196.0, 32.0, 242.0, -1.0, math.nan]))


def field(kind: str, length: int):
    """Any value of a field; half of the target ids are ours."""
    if kind == "char":
        return st.sampled_from([b"SIH_MASS", b"COM_OBL_RC_ACT", b"", b"\xff" * 16, b"NO"])
    one = likely_float
    if kind.startswith("uint"):
        one = st.integers(0, 2 ** int(kind[4:-2]) - 1)
    elif kind in RANGES:
        one = st.integers(-(2 ** (RANGES[kind] - 1)), 2 ** (RANGES[kind] - 1) - 1)
    return st.lists(one, min_size=length, max_size=length) if length else one


@st.composite
def messages(draw):
    """A message of a kind that some service handles."""
    kind = KINDS[draw(st.sampled_from(sorted(SERVICES)))]
    values = {}
    for name, type_ in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        index = kind.ordered_fieldnames.index(name)
        if name in ("target_system", "target_component"):
            values[name] = draw(st.sampled_from([1, 1, 0, 77]))
        elif name == "command":
            values[name] = draw(st.one_of(st.sampled_from(sorted(HANDLERS)), st.integers(0, 65535)))
        elif name == "coordinate_frame":
            values[name] = draw(st.sampled_from([1, 8, 0, 12]))
        else:
            values[name] = draw(field(type_, 0 if type_ == "char" else kind.array_lengths[index]))
    return kind(**values)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(messages(), min_size=1, max_size=12))
def test_any_messages_leave_a_vehicle_that_answers(hovering: Direct, sequence):
    for message in sequence:
        hovering.send(message)
        hovering.advance(50)
    assert all(map(math.isfinite, (*hovering.position, *hovering.velocity)))
    hovering.link.signing.set_up(bytes(32), 0)  # one of them may have set a key
    before = len(hovering.messages)
    hovering.send(mavlink.MAVLink_command_long_message(1, 1, 511, 0, 1, 100_000, 0, 0, 0, 0, 0))
    hovering.advance(200)
    assert any(m.get_type() == "COMMAND_ACK" and m.command == 511 for m in hovering.messages[before:])


@pytest.mark.parametrize(("cells", "charged"), [(24, 6.0), (1, 2.0)])
def test_extreme_batteries_still_fit_their_fields(hovering, cells, charged):
    for name, value in (("BAT1_N_CELLS", cells), ("BAT1_V_CHARGED", charged)):
        mav_type = 6 if name == "BAT1_N_CELLS" else 9
        raw = struct.unpack("<f", struct.pack("<i", value))[0] if mav_type == 6 else value
        hovering.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), raw, mav_type))
    hovering.fly(3)
    assert 0 < hovering.latest["SYS_STATUS"].voltage_battery < 65535
    assert hovering.latest["BATTERY_STATUS"].voltages[0] < 65535
