"""Frames: ours read by pymavlink, and anything at all read by ours."""

import math
import struct
import tracemalloc
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from sitl.links.frames import WITHOUT_LAYOUT, frame, pack, unpack
from sitl.px4.personality import PX4


def test_every_telemetry_message_reads_back(hovering):
    """All that can be streamed or requested decodes with pymavlink, with the state's values in it."""
    hovering.fly(3)
    for name, build in PX4.messages.items():
        payload = build(hovering.autopilot.vehicle)
        message = mavlink.MAVLink(None).decode(bytearray(frame(payload, 7, 1, 1)))
        if payload.message_id in WITHOUT_LAYOUT:
            assert message.get_type() == f"UNKNOWN_{payload.message_id}"
            continue
        assert message.get_type() == name
        assert message.get_seq() == 7
    assert hovering.latest["LOCAL_POSITION_NED"].z == pytest.approx(-10, abs=0.5)
    assert hovering.latest["GLOBAL_POSITION_INT"].relative_alt == pytest.approx(10_000, abs=500)
    assert hovering.latest["GLOBAL_POSITION_INT"].lat == 473977430
    assert hovering.latest["ALTITUDE"].altitude_amsl == pytest.approx(499.4, abs=0.5)
    assert hovering.latest["ATTITUDE_QUATERNION"].q1 == pytest.approx(1.0, abs=1e-3)
    hovering.command(512, 105)
    assert hovering.latest["HIGHRES_IMU"].zacc == pytest.approx(-9.8, abs=0.5)
    assert hovering.latest["SERVO_OUTPUT_RAW"].servo1_raw == pytest.approx(1490, abs=30)


@given(st.integers(0, 255), st.integers(0, 2**32 - 1))
def test_frames_equal_pymavlinks(sequence, mode):
    """Byte for byte, trailing zeros cut."""
    mav = mavlink.MAVLink(None, srcSystem=9, srcComponent=1)
    mav.seq = sequence
    expected = mavlink.MAVLink_heartbeat_message(2, 12, 0, mode, 3, 0).pack(mav)
    fields = {"type": 2, "autopilot": 12, "base_mode": 0, "custom_mode": mode, "system_status": 3}
    assert frame(pack("HEARTBEAT", **fields, mavlink_version=0), sequence, 9, 1) == expected


def test_several_frames_in_a_datagram_and_mavlink_1():
    mav = mavlink.MAVLink(None)
    message = mavlink.MAVLink_ping_message(5, 6, 0, 0)
    datagram = message.pack(mav) + message.pack(mav, force_mavlink1=True)
    bad: Counter[str] = Counter()
    assert [m.time_usec for m, _ in unpack(datagram, bad)] == [5, 5]
    assert not bad


@settings(max_examples=300)
@given(st.one_of(st.binary(max_size=300), st.binary(max_size=300).map(lambda tail: b"\xfd" + tail)))
def test_garbage_is_counted_never_raised(datagram):
    bad: Counter[str] = Counter()
    messages = unpack(datagram, bad)
    assert messages or not datagram or bad.total() >= 1


def test_message_ids_nobody_knows_fill_no_memory():
    """There are 16 million of them: what they leave behind must not grow with what a stranger sends."""

    def kept(ids: range) -> int:
        tracemalloc.start()
        for number in ids:
            head = struct.pack("<BBBBBBBHB", 0xFD, 0, 0, 0, 0, 1, 1, number & 0xFFFF, number >> 16)
            unpack(head + b"\0\0", Counter())
        size, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return size

    assert kept(range(1 << 20, (1 << 20) + 10_000)) < 100_000


def test_garbage_on_the_link_is_counted_and_the_vehicle_flies_on(hovering):
    good = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(hovering.mav)
    corrupt = bytearray(good)
    corrupt[12] ^= 0xFF
    for datagram in (b"hello", bytes(corrupt), good[:-1], b"", bytes(4096)):
        hovering.udp.sendto(datagram, hovering.to)
    hovering.fly(1)
    counters = hovering.link.counters
    assert counters["garbage"] == 3
    assert counters["frame"] == 1
    assert hovering.position[2] == pytest.approx(-10, abs=0.5)


def test_extreme_setpoints_keep_the_state_finite(hovering):
    for value in (1e38, -1e38, math.inf, -math.inf, math.nan):
        for _ in range(10):
            hovering.setpoint(value, value, -abs(value), yaw=value)
            hovering.setpoint(value, 0.0, 0.0, mask=0, position=(value, value, value))
            hovering.command(176, 1, 6)
    assert all(map(math.isfinite, hovering.position))
    assert all(map(math.isfinite, hovering.velocity))
