"""Messages that clients ask for besides the streams: both personalities, over real UDP."""

import itertools
import math
import struct

import pytest
from pymavlink.dialects.v20 import development as mavlink
from pymavlink.mavutil import x25crc

from sitl.links.frames import mavlink as dialect
from tests.sitl.copter import GUIDED, copter
from tests.sitl.plans import ORIGIN, TAKEOFF, WAYPOINT, item, upload

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
REQUEST = 512


def test_protocol_version(vehicle):
    """AUTOPILOT.md 1: also asked for: PROTOCOL_VERSION. pymavlink dropped it: the frame is read by hand."""
    crc = x25crc(b"PROTOCOL_VERSION ")
    for kind, name, length in (
        ("uint16_t", "version", 0), ("uint16_t", "min_version", 0), ("uint16_t", "max_version", 0),
        ("uint8_t", "spec_version_hash", 8), ("uint8_t", "library_version_hash", 8),
    ):  # fmt: skip
        crc.accumulate(f"{kind} {name} ".encode() + (bytes((length,)) if length else b""))
    extra = (crc.crc & 0xFF) ^ (crc.crc >> 8)  # how MAVLink makes CRC_EXTRA of a definition
    assert 300 not in dialect.mavlink_map
    vehicle.boot()
    for command in ((REQUEST, 300), (519, 1)):
        before = len(vehicle.raw)
        assert vehicle.command(*command) == ACCEPTED
        (raw,) = [r for r in vehicle.raw[before:] if int.from_bytes(r[7:10], "little") == 300]
        assert struct.unpack("<HHH", raw[10 : 10 + raw[1]].ljust(6, b"\0")) == (200, 100, 200)
        assert x25crc(raw[1 : 10 + raw[1]] + bytes((extra,))).crc == int.from_bytes(raw[-2:], "little")


def test_available_modes(vehicle):
    """AUTOPILOT.md 1: PX4: custom_mode = main << 16 | sub << 24: each mode as it can be asked for."""
    vehicle.boot()
    since = len(vehicle.messages)
    assert vehicle.command(REQUEST, 435, 0) == ACCEPTED
    modes = [m for m in vehicle.messages[since:] if m.get_type() == "AVAILABLE_MODES"]
    assert [m.mode_index for m in modes] == list(range(1, modes[0].number_modes + 1))
    numbers = {m.mode_name: (m.custom_mode >> 16 & 0xFF, m.custom_mode >> 24) for m in modes}
    assert numbers["Hold"] == (4, 3)
    assert numbers["Offboard"] == (6, 0)
    assert numbers["Mission"] == (4, 4)
    assert vehicle.command(REQUEST, 435, 2) == ACCEPTED
    assert vehicle.latest["AVAILABLE_MODES"].mode_index == 2
    assert vehicle.command(REQUEST, 435, 99) == DENIED
    assert vehicle.command(REQUEST, 435, math.nan) == DENIED


def test_available_modes_of_arducopter():
    """AUTOPILOT.md 1: ArduCopter: mode number."""
    with copter() as vehicle:
        vehicle.until(lambda: "HEARTBEAT" in vehicle.latest, 3)
        since = len(vehicle.messages)
        assert vehicle.command(REQUEST, 435, 0) == ACCEPTED
        modes = {m.mode_name: m.custom_mode for m in vehicle.messages[since:] if m.get_type() == "AVAILABLE_MODES"}
        for name, number in {"GUIDED": 4, "RTL": 6, "LAND": 9, "AUTO": 3, "LOITER": 5, "STABILIZE": 0}.items():
            assert modes[name] == number


def test_current_mode(hovering):
    """AUTOPILOT.md 1: also asked for: CURRENT_MODE."""
    assert hovering.command(REQUEST, 436) == ACCEPTED
    current = hovering.latest["CURRENT_MODE"]
    assert (current.custom_mode, current.intended_custom_mode) == (4 << 16 | 3 << 24,) * 2


def test_ground_truth(hovering):
    """Issue 4, item 2: HIL_STATE_QUATERNION ground truth, as a stream on request."""
    assert hovering.command(511, 115, 20_000) == ACCEPTED
    hovering.offboard(3.0, 0.0, 0.0)
    hovering.fly(4, lambda: hovering.setpoint(3.0, 0.0, 0.0))
    truth, body = hovering.latest["HIL_STATE_QUATERNION"], hovering.autopilot.vehicle.body
    assert list(truth.attitude_quaternion) == pytest.approx(body.attitude.tolist(), abs=1e-3)
    assert truth.vx == pytest.approx(body.velocity[0] * 100, abs=1)
    assert (truth.lat, truth.lon) == pytest.approx(
        [round(d * 1e7) for d in ORIGIN.globe(*body.position[:2].tolist())], abs=2
    )
    assert math.sqrt(truth.xacc**2 + truth.yacc**2 + truth.zacc**2) == pytest.approx(1000, abs=40)
    stamps = [m.time_usec for m in hovering.messages if m.get_type() == "HIL_STATE_QUATERNION"]
    assert {b - a for a, b in itertools.pairwise(stamps)} == {20_000}


def test_position_target_global_int(hovering):
    """Where an automatic mode flies to, as PX4 was recorded to tell it; nothing in OFFBOARD."""
    assert upload(hovering, [item(TAKEOFF, up=5.0), item(WAYPOINT, 30.0, 0.0, 12.0)]) == ACCEPTED
    hovering.fly(1)
    place = hovering.latest["POSITION_TARGET_GLOBAL_INT"]
    assert place.alt == pytest.approx(499.4, abs=0.3)
    assert hovering.command(176, 1, 4, 4) == ACCEPTED
    hovering.until(lambda: hovering.position[0] > 8, 30)
    place = hovering.latest["POSITION_TARGET_GLOBAL_INT"]
    assert (place.lat_int, place.lon_int) == pytest.approx([round(d * 1e7) for d in ORIGIN.globe(30.0, 0.0)], abs=2)
    assert place.alt == pytest.approx(ORIGIN.altitude + 12.0, abs=0.1)
    hovering.offboard(0.0, 0.0, 0.0)
    since = len(hovering.messages)
    hovering.fly(1, lambda: hovering.setpoint(0.0, 0.0, 0.0))
    assert "POSITION_TARGET_GLOBAL_INT" not in {m.get_type() for m in hovering.messages[since:]}


def test_set_gps_global_origin_is_answered_with_the_one_there_is(vehicle):
    """AUTOPILOT.md 1: also asked for: GPS_GLOBAL_ORIGIN."""
    vehicle.boot()
    vehicle.send(mavlink.MAVLink_set_gps_global_origin_message(1, 100_000_000, 100_000_000, 5000))
    vehicle.advance()
    origin = vehicle.latest["GPS_GLOBAL_ORIGIN"]
    assert (origin.latitude, origin.longitude) == (473977430, 85455940)


def test_fence_status_of_arducopter():
    with copter(FENCE_ENABLE=1, FENCE_RADIUS=30.0, FENCE_ACTION=0, AVOID_ENABLE=0) as vehicle:
        vehicle.take_off(10.0)
        assert vehicle.command(REQUEST, 162) == ACCEPTED
        status = vehicle.latest["FENCE_STATUS"]
        assert (status.breach_status, status.breach_count, status.breach_type) == (0, 0, 0)
        vehicle.until(lambda: vehicle.position[0] > 31, 30, lambda: vehicle.setpoint(6.0, 0.0, 0.0))
        vehicle.fly(1)
        assert vehicle.command(REQUEST, 162) == ACCEPTED
        status = vehicle.latest["FENCE_STATUS"]
        assert (status.breach_status, status.breach_count, status.breach_type) == (1, 1, 3)
        assert vehicle.mode == GUIDED
