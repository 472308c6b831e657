"""What the bridge makes of telemetry, frame by frame: late, lost, senseless, of others. Over a real socket."""

import math
import socket

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.link import Link
from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle
from autopilot_bridge.vehicle import Mode, VehicleError

LOITER, OFFBOARD = 4 << 16 | 3 << 24, 6 << 16


class Clock:
    """Stands where it is put."""

    now = 0.0


class Autopilot:
    """Says what it is told to, a datagram each; its vehicle has taken it in when `say` returns."""

    def __init__(self, vehicle, link):
        self.vehicle, self.link = vehicle, link
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.seq = 0

    def say(self, message, seq=None, component=1, **how):
        codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=component)
        codec.seq = self.seq if seq is None else seq
        self.seq = (codec.seq + 1) % 256
        self.socket.sendto(message.pack(codec, **how), ("127.0.0.1", self.link.port))
        self.vehicle.poll(5.0)
        return self.vehicle.telemetry


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def vehicle(clock):
    link = Link("udpin://127.0.0.1:0", 1)
    vehicle = PymavlinkVehicle(link, dialects("auto"), 1, clock, lambda: None)
    yield vehicle
    vehicle.close()


@pytest.fixture
def autopilot(vehicle):
    autopilot = Autopilot(vehicle, vehicle._link)
    autopilot.say(beat())
    yield autopilot
    autopilot.socket.close()


def beat(mode=LOITER, armed=False):
    kind, px4 = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4
    return mavlink.MAVLink_heartbeat_message(kind, px4, 0x80 if armed else 0, mode, 4, 3)


def local(boot_ms, x=1.0, y=2.0, z=-3.0, vx=0.0):
    return mavlink.MAVLink_local_position_ned_message(boot_ms, x, y, z, vx, 0.0, 0.0)


def attitude(boot_ms, roll=0.1, yaw=0.0):
    return mavlink.MAVLink_attitude_message(boot_ms, roll, 0.2, yaw, 0.0, 0.0, 0.0)


def home(x=0.0, y=0.0, z=0.0):
    return mavlink.MAVLink_home_position_message(474000000, 85000000, 488000, x, y, z, [1, 0, 0, 0], 0, 0, 0)


@pytest.mark.parametrize("lost", [{"x": math.nan}, {"z": math.inf}, {"vx": math.nan}])
def test_a_position_that_is_none_is_none_and_time_goes_on(autopilot, vehicle, lost):
    assert autopilot.say(local(1000)).at(1.0)[0] == pytest.approx([2, 1, 3])
    told = autopilot.say(local(1050, **lost))
    assert told.time_s == 1.05
    with pytest.raises(VehicleError, match="no local position"):
        told.at(1.05)
    assert vehicle.counters["not_finite"] == 1
    assert autopilot.say(local(1100)).at(1.1)[0] == pytest.approx([2, 1, 3])


def test_an_attitude_that_is_none_is_the_last_one(autopilot):
    before = autopilot.say(attitude(1000, yaw=0.5)).attitude_rad
    told = autopilot.say(attitude(1010, yaw=math.nan))
    assert (told.attitude_rad, told.time_s) == (before, 1.01)


def test_time_goes_on_when_positions_stop(autopilot):
    """As on PX4 without an estimate: LOCAL_POSITION_NED is not sent at all, ATTITUDE is."""
    autopilot.say(local(1000, vx=2.0))
    told = autopilot.say(attitude(3000))
    assert (told.time_s, told.position_s) == (3.0, 1.0)
    assert told.at(3.0)[0] == pytest.approx([2, 1.2, 3])  # carried on over 0.1 s, no more


def test_what_comes_late_does_not_undo_what_is_newer(autopilot, vehicle):
    autopilot.say(local(1100, x=1.0))
    told = autopilot.say(local(1050, x=9.0))
    assert (told.time_s, told.position_enu[1]) == (1.1, 1.0)
    assert autopilot.say(attitude(1000)).time_s == 1.1  # of another kind: news, but not of the time
    assert autopilot.say(local(1150, x=2.0)).position_enu[1] == 2.0
    assert vehicle.counters["late"] == 1


def test_a_late_heartbeat_does_not_undo_a_newer_mode(autopilot, clock):
    autopilot.say(beat(), seq=120)
    assert autopilot.say(beat(OFFBOARD, armed=True), seq=255).mode is Mode.OFFBOARD
    told = autopilot.say(beat(LOITER), seq=250)
    assert (told.mode, told.armed) == (Mode.OFFBOARD, True)
    assert autopilot.say(beat(LOITER, armed=True), seq=3).mode is Mode.HOLD
    assert autopilot.say(beat(OFFBOARD, armed=True), seq=3).mode is Mode.OFFBOARD  # who does not count is believed
    clock.now += 2.0  # a number so old is another round's
    assert autopilot.say(beat(LOITER), seq=250).mode is Mode.HOLD


def test_frames_of_an_autopilot_that_starts_anew_are_not_late(autopilot, clock):
    """Its numbers begin anew, and its clock, which must not make it unheard until that is where it was."""
    clock.now = 1000.0
    autopilot.say(beat(LOITER), seq=40)
    clock.now = 5.0
    assert autopilot.say(beat(OFFBOARD), seq=2).mode is Mode.OFFBOARD


def test_a_mode_told_before_the_clock_went_back_is_no_news(autopilot, vehicle, clock, monkeypatch):
    clock.now = 1000.0
    autopilot.say(beat(LOITER))
    clock.now = 5.0

    def wait():
        clock.now += 0.05
        if clock.now > 5.2:
            autopilot.say(beat(OFFBOARD))

    monkeypatch.setattr(vehicle, "_wait", wait)
    vehicle.hear_mode()
    assert vehicle.telemetry.mode is Mode.OFFBOARD


def test_an_autopilot_that_starts_anew_is_seen_by_its_clock(autopilot):
    autopilot.say(local(100_000))
    assert autopilot.say(local(500)).time_s == 0.5


def test_the_clock_runs_on_after_49_days(autopilot):
    full_ms = 1 << 32

    def after_the_turn_s(message):
        return round(autopilot.say(message).time_s - full_ms / 1000, 3)

    assert after_the_turn_s(local(full_ms - 50)) == -0.05
    assert after_the_turn_s(attitude(0)) == 0.0
    assert after_the_turn_s(local(50, x=7.0)) == 0.05
    assert autopilot.say(local(full_ms - 10)).position_enu[1] == 7.0  # late, of the round before
    assert after_the_turn_s(local(120_000)) == 120.0  # after a long silence
    assert after_the_turn_s(local(5000)) < 119.0  # it has started anew


def test_a_home_moved_in_flight_is_told_and_positions_stay(autopilot, vehicle, monkeypatch):
    autopilot.say(home(x=10.0))
    vehicle._home_held = True  # as `arm` leaves it
    autopilot.say(home(x=10.5))  # a drift
    assert vehicle.remarks() == []
    autopilot.say(home(x=10.0, y=30.0, z=-2.0))
    autopilot.say(home(x=10.0, y=30.0, z=-2.0))
    assert autopilot.say(local(1000, x=10.0, y=0.0, z=-5.0)).position_enu == pytest.approx([0, 0, 5])
    (remark,) = vehicle.remarks()
    assert remark.startswith("home was moved to (30.0, 0.0, 2.0) m: positions and fence stay")
    assert vehicle.remarks() == []


def test_a_home_that_is_none_is_not_taken(autopilot):
    autopilot.say(home(x=10.0))
    autopilot.say(home(x=math.nan))
    assert np.isfinite(autopilot.say(local(1000)).position_enu).all()


def test_a_second_voice_in_flight_is_told_once(autopilot, vehicle):
    stranger = Autopilot(vehicle, vehicle._link)
    vehicle._home_held = True
    for boot_ms in (1000, 1050, 1100):
        autopilot.say(local(boot_ms))
        stranger.say(local(boot_ms + 1, x=99.0))
    assert vehicle.telemetry.position_enu[1] == 1.0
    (remark,) = vehicle.remarks()
    assert "both speak as system 1" in remark
    assert vehicle.remarks() == []
    stranger.socket.close()


@pytest.mark.parametrize("component", [100, 154, 156, 191, 25])
def test_other_components_of_the_vehicle_do_not_say_where_it_is(autopilot, component):
    """Camera, gimbal, ADS-B receiver, companion, user's own."""
    autopilot.say(local(1000))
    autopilot.say(local(1010, x=99.0), component=component)
    told = autopilot.say(beat(OFFBOARD, armed=True), component=component)
    assert (told.position_enu[1], told.mode, told.armed) == (1.0, Mode.HOLD, False)


def test_frames_of_mavlink_1(autopilot):
    assert autopilot.say(local(1000), force_mavlink1=True).time_s == 1.0


def test_zeros_cut_off_at_the_end_are_zeros(autopilot):
    """MAVLink 2 sends no trailing zeros: at rest at the origin a position is its time, and a byte."""
    told = autopilot.say(local(1000, x=0.0, y=0.0, z=0.0))
    assert told.position_enu == pytest.approx([0, 0, 0])
    assert told.velocity_enu == pytest.approx([0, 0, 0])


def test_somebody_elses_parameters_before_we_are_connected_do_no_harm(vehicle):
    """A ground station that is reading them when we come."""
    value = mavlink.MAVLink_param_value_message(b"COM_OBL_RC_ACT", 0.0, mavlink.MAV_PARAM_TYPE_INT32, 1, 0)
    Autopilot(vehicle, vehicle._link).say(value)
    assert vehicle.counters["bad_data"] == 0


def framed(number, payload):
    """A frame of any payload, zeros cut off, with the checksum that makes it one."""
    cut = payload.rstrip(b"\0") or payload[:1]
    body = bytes([len(cut), 0, 0, 0, 1, 1]) + number.to_bytes(3, "little") + cut
    checksum = mavlink.x25crc(body + bytes([mavlink.mavlink_map[number].crc_extra])).crc
    return b"\xfd" + body + checksum.to_bytes(2, "little")


@pytest.mark.parametrize("met", [False, True])
@given(data=st.data())
def test_no_frame_ends_a_flight(data, met):
    """Whatever stands in it, before the first HEARTBEAT and after it."""
    link, clock = Link("udpin://127.0.0.1:0", 1), Clock()
    vehicle = PymavlinkVehicle(link, dialects("auto"), 1, clock, lambda: None)
    autopilot = Autopilot(vehicle, link)
    if met:
        autopilot.say(beat())
    try:
        for _ in range(5):
            number = data.draw(st.sampled_from(sorted(vehicle.read)))
            size = mavlink.mavlink_map[number].unpacker.size
            payload = data.draw(st.binary(min_size=1, max_size=size))
            autopilot.socket.sendto(framed(number, payload), ("127.0.0.1", link.port))
            vehicle.poll(5.0)
        told = vehicle.telemetry
        assert link.heard + link.counters["foreign"] == 5 + met
        assert link.counters["bad_data"] == 0
        assert np.isfinite(told.attitude_rad).all()
        assert told.position_enu is None or np.isfinite(told.position_enu).all()
        vehicle.status_texts()
        vehicle.remarks()
    finally:
        autopilot.socket.close()
        vehicle.close()
