"""Arming, modes, setpoints and landed state of the ArduCopter personality, each line of AUTOPILOT.md 1 and 3.

The vehicle is in this process; commands and telemetry go over real UDP. Times and texts are those of the recorded
flight (tests/sitl/data/README.md).
"""

import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.arducopter.parameters import TABLE
from sitl.parameters import Parameters
from tests.sitl.copter import ARM, AUTO, DO_SET_MODE, GUIDED, LAND, LOITER, RTL, STABILIZE, TAKEOFF, Copter, copter

NAN = math.nan
ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
VELOCITY, VELOCITY_YAW, VELOCITY_YAW_RATE = 3527, 2503, 1479
FORCE = 21196
DATA = Path(__file__).parent / "data"


@pytest.fixture
def vehicle() -> Iterator[Copter]:
    """Just booting, default parameters."""
    with copter() as client:
        yield client


@pytest.fixture
def ready(vehicle: Copter) -> Copter:
    """Armable, in STABILIZE, watched by the messages of the recorded flight."""
    vehicle.boot()
    return vehicle


@pytest.fixture
def hovering(vehicle: Copter) -> Copter:
    """In GUIDED, 10 m above home."""
    vehicle.take_off(10.0)
    return vehicle


def first_ms(vehicle: Copter, name: str, condition=lambda message: True) -> int:
    return next(
        time
        for time, message in zip(vehicle.times, vehicle.messages, strict=True)
        if message.get_type() == name and condition(message)
    )


def kinds_since(vehicle: Copter, before: int) -> set[str]:
    return {message.get_type() for message in vehicle.messages[before:]}


# Boot and links


def test_only_heartbeat_and_timesync_until_asked(vehicle):
    """AUTOPILOT.md 3: "Only HEARTBEAT 1 Hz and TIMESYNC until the client asks"; texts and news apart."""
    vehicle.fly(60)
    streams = [m.get_type() for m in vehicle.messages if m.get_type() != "STATUSTEXT"]
    assert set(streams) == {"HEARTBEAT", "TIMESYNC", "GPS_GLOBAL_ORIGIN", "HOME_POSITION"}
    assert streams.count("HOME_POSITION") == 1  # when it becomes known, 20 s after boot
    assert streams.count("HEARTBEAT") == pytest.approx(60, abs=1)
    assert streams.count("TIMESYNC") == pytest.approx(6, abs=1)
    request = next(m for m in vehicle.messages if m.get_type() == "TIMESYNC")
    assert request.tc1 == 0


def test_request_data_stream_gives_27_kinds(ready):
    """AUTOPILOT.md 3: REQUEST_DATA_STREAM 4 Hz gives 27 types."""
    for number in list(ready.autopilot.vehicle.personality.messages):
        ready.link.set_interval(number, -1.0 if number not in ("HEARTBEAT", "TIMESYNC") else 0.0, ready.time_ms)
    ready.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 4, 1))
    ready.advance(100)
    before = len(ready.messages)
    ready.fly(10)
    kinds = [m.get_type() for m in ready.messages[before:]]
    streamed = set(kinds) - {"HEARTBEAT", "TIMESYNC"}
    assert len(streamed) == 27
    for name in streamed:
        assert kinds.count(name) == pytest.approx(40, abs=2), name
    ready.send(mavlink.MAVLink_request_data_stream_message(1, 1, 10, 4, 0))
    ready.advance(100)
    before = len(ready.messages)
    ready.fly(2)
    assert "ATTITUDE" not in kinds_since(ready, before)
    assert "VFR_HUD" in kinds_since(ready, before)


def test_set_message_interval(ready):
    """AUTOPILOT.md 3: or SET_MESSAGE_INTERVAL."""
    assert ready.command(511, 74, 50_000) == ACCEPTED
    before = len(ready.messages)
    ready.fly(2)
    assert [m.get_type() for m in ready.messages[before:]].count("VFR_HUD") == pytest.approx(40, abs=2)
    assert ready.command(511, 99_999, 50_000) == FAILED
    assert ready.command(511, 331, 50_000) == FAILED  # ODOMETRY: ArduCopter does not send it


def test_boot_as_recorded(vehicle):
    """HEARTBEAT 1.0 s in BOOT, ready 2.45 s, home 20.0 s, position 41.6 s; the texts on the way."""
    vehicle.until(lambda: "HEARTBEAT" in vehicle.latest, 3)
    assert 900 <= first_ms(vehicle, "HEARTBEAT") <= 1150
    boot = vehicle.latest["HEARTBEAT"]
    assert (boot.type, boot.autopilot, boot.base_mode, boot.custom_mode, boot.system_status) == (2, 3, 89, 0, 1)
    vehicle.watch()
    vehicle.fly(43)
    assert vehicle.latest["HEARTBEAT"].base_mode == 81
    assert vehicle.latest["HEARTBEAT"].system_status == 3
    assert first_ms(vehicle, "ATTITUDE") == pytest.approx(2450, abs=100)
    assert first_ms(vehicle, "HOME_POSITION") == pytest.approx(20_020, abs=100)
    assert first_ms(vehicle, "LOCAL_POSITION_NED") == pytest.approx(41_620, abs=100)
    fix = [m.fix_type for m in vehicle.messages if m.get_type() == "GPS_RAW_INT"]
    assert sorted(set(fix)) == [0, 1, 6]
    assert fix == sorted(fix)
    flags = [m.flags for m in vehicle.messages if m.get_type() == "EKF_STATUS_REPORT"]
    assert list(dict.fromkeys(flags)) == [1024, 167, 831]
    texts = vehicle.texts()
    for text in ("ArduPilot Ready", "EKF3 IMU0 initialised", "EKF3 IMU0 origin set", "EKF3 IMU0 is using GPS"):
        assert text in texts
    assert "Field Elevation Set: 489m" in texts
    assert "PreArm: Need Position Estimate" in texts


def test_armable_after_42_s_with_the_denials_shown(vehicle):
    """AUTOPILOT.md 3: "Armable only after about 42 s ... denials shown ("Arm: ..."; result FAILED)"."""
    vehicle.until(lambda: "HEARTBEAT" in vehicle.latest, 3)
    seen: dict[int, set[str]] = {}
    while True:
        before = len(vehicle.texts())
        assert vehicle.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
        result = vehicle.command(ARM, 1)
        if result == ACCEPTED:
            break
        assert result == FAILED
        seen[vehicle.time_ms] = {text for text in vehicle.texts()[before:] if text.startswith("Arm: ")}
        assert seen[vehicle.time_ms]
        vehicle.fly(0.8)
    assert vehicle.time_ms / 1000 == pytest.approx(42, abs=1.5)
    assert vehicle.texts()[-1] == "Arming motors"

    def at(seconds: float) -> set[str]:
        return seen[min(seen, key=lambda ms: abs(ms - seconds * 1000))]

    assert at(1.3) == {"Arm: System not initialised"}
    assert at(5) == {
        "Arm: Need Alt Estimate", "Arm: Accels inconsistent", "Arm: EKF attitude is bad", "Arm: AHRS: waiting for home",
    }  # fmt: skip
    assert at(10) == {"Arm: Accels inconsistent", "Arm: AHRS: waiting for home"}
    assert at(16) == {"Arm: Gyros inconsistent", "Arm: AHRS: waiting for home"}
    assert at(35) == {"Arm: Need Position Estimate"}


def test_mode_chosen_before_ready_falls_back(vehicle):
    """As recorded: GUIDED is taken 1.1 s after boot, and "ArduPilot Ready" finds the vehicle in STABILIZE again."""
    vehicle.until(lambda: "HEARTBEAT" in vehicle.latest, 3)
    assert vehicle.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    assert vehicle.mode == GUIDED
    vehicle.fly(2.5)
    assert vehicle.mode == STABILIZE


def test_health_bits(ready):
    """AUTOPILOT.md 1: health bits for gyro, accel, mag, GPS; `is_armable` = the PREARM_CHECK bit. Masks as recorded."""
    assert ready.command(511, 1, 200_000) == ACCEPTED
    ready.fly(1)
    status = ready.latest["SYS_STATUS"]
    assert status.onboard_control_sensors_present == 1399979055
    assert status.onboard_control_sensors_enabled == 1398930479
    assert status.onboard_control_sensors_health == 1467087919
    for bit in (1, 2, 4, 0x20, mavlink.MAV_SYS_STATUS_PREARM_CHECK):
        assert status.onboard_control_sensors_health & bit


def test_version_and_home_on_request(ready):
    """AUTOPILOT.md 1: CMD 512 for AUTOPILOT_VERSION and HOME_POSITION."""
    assert ready.command(512, 148) == ACCEPTED
    version = ready.latest["AUTOPILOT_VERSION"]
    assert version.capabilities == 0xFBEF
    assert version.flight_sw_version == 0x04070000
    assert bytes(version.flight_custom_version) == b"90700977"
    assert ready.command(512, 242) == ACCEPTED
    assert ready.latest["HOME_POSITION"].latitude == 473977430
    assert all(math.isnan(value) for value in ready.latest["HOME_POSITION"].q)
    assert ready.command(512, 99_999) == FAILED


def test_texts_of_one_chunk_have_no_id(ready):
    """As recorded: id 0 for all that fits into one STATUSTEXT."""
    assert {m.id for m in ready.messages if m.get_type() == "STATUSTEXT"} == {0}


# ACKs


def test_acks_on_the_ground(vehicle):
    """AUTOPILOT.md 3: FAILED: arm not ready, takeoff while disarmed, AUTO without mission, bad mode."""
    vehicle.until(lambda: "HEARTBEAT" in vehicle.latest, 3)
    assert vehicle.command(ARM, 1) == FAILED
    vehicle.boot()
    assert vehicle.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10) == FAILED
    assert vehicle.command(DO_SET_MODE, 1, AUTO) == FAILED
    assert vehicle.command(300) == FAILED
    assert vehicle.command(DO_SET_MODE, 1, 99) == FAILED
    assert vehicle.command(DO_SET_MODE, 1, NAN) == FAILED
    assert vehicle.command(31_000) == UNSUPPORTED
    assert vehicle.command(34) == UNSUPPORTED  # orbit
    assert vehicle.command(DO_SET_MODE, 1, RTL) == ACCEPTED
    assert vehicle.command(ARM, 1) == FAILED  # RTL is no mode to arm in
    assert vehicle.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    assert vehicle.command(ARM, 1) == ACCEPTED
    assert vehicle.command(ARM, 1) == ACCEPTED  # when armed
    assert vehicle.command(ARM, 0) == ACCEPTED  # standing


def test_wrong_component_is_accepted_and_wrong_system_is_not(ready):
    """AUTOPILOT.md 3: "Wrong component id is accepted"."""
    assert ready.command(DO_SET_MODE, 1, GUIDED, component=77) == ACCEPTED
    assert ready.mode == GUIDED
    assert ready.command(DO_SET_MODE, 1, LOITER, system=9) is None
    assert ready.mode == GUIDED


def test_set_mode_message_works_without_an_ack(ready):
    """AUTOPILOT.md 3: "No ACK to SET_MODE"; the HEARTBEAT of a new mode comes at once."""
    before = len(ready.messages)
    ready.send(mavlink.MAVLink_set_mode_message(1, 1, GUIDED))
    ready.advance(50)
    assert ready.mode == GUIDED
    assert ready.latest["HEARTBEAT"].base_mode == 89
    assert "COMMAND_ACK" not in kinds_since(ready, before)


def test_acks_in_the_air(hovering):
    """AUTOPILOT.md 3: FAILED: disarm in air, AUTO without mission. As recorded: ARM accepted, takeoff FAILED."""
    assert hovering.latest["HEARTBEAT"].base_mode == 217
    assert hovering.command(ARM, 1) == ACCEPTED
    assert hovering.command(ARM, 0) == FAILED
    assert hovering.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 15) == FAILED
    assert hovering.command(DO_SET_MODE, 1, AUTO) == FAILED
    assert hovering.command(21, 0, 0, 0, NAN) == ACCEPTED
    assert hovering.mode == LAND
    assert hovering.command(20) == ACCEPTED
    assert hovering.mode == RTL
    assert hovering.latest["HEARTBEAT"].base_mode == 217
    assert hovering.command(ARM, 0, FORCE) == ACCEPTED
    hovering.fly(5)
    assert not hovering.armed
    assert hovering.position[2] == 0.0
    assert hovering.latest["HEARTBEAT"].base_mode == 81
    assert hovering.mode == RTL  # the mode stays


# Takeoff, landing, disarming


def test_landed_states_and_disarm_after_landing(vehicle):
    """AUTOPILOT.md 1: 1 -> 3 -> 2 -> 4 -> 1 (vtol_state 3 as recorded); disarmed by itself after LAND."""
    vehicle.take_off(5.0)
    assert vehicle.latest["HEARTBEAT"].system_status == 4
    assert vehicle.command(21) == ACCEPTED
    vehicle.until(lambda: not vehicle.armed, 40)
    states = [m.landed_state for m in vehicle.messages if m.get_type() == "EXTENDED_SYS_STATE"]
    assert list(dict.fromkeys(states[:-1])) == [1, 3, 2, 4]
    assert states[-1] == 1
    assert {m.vtol_state for m in vehicle.messages if m.get_type() == "EXTENDED_SYS_STATE"} == {3}
    assert vehicle.texts()[-1] == "Disarming motors"


def test_takeoff_only_in_guided_by_command(ready):
    """AUTOPILOT.md 3: "Must take off by CMD 22 before velocity works"."""
    assert ready.command(DO_SET_MODE, 1, LOITER) == ACCEPTED
    assert ready.command(ARM, 1) == ACCEPTED
    assert ready.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == FAILED
    assert ready.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    ready.stream(4, 1.0, 0.0, -2.0)
    assert ready.position == (0.0, 0.0, 0.0)
    for nonsense in (NAN, 0.0, -5.0, math.inf):
        assert ready.command(TAKEOFF, 0, 0, 0, 0, 0, 0, nonsense) == FAILED
    assert ready.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 5) == ACCEPTED
    ready.until(lambda: ready.landed == 2, 20)
    ready.fly(2)
    assert ready.position[2] == pytest.approx(-5, abs=0.2)


def test_velocity_during_takeoff_ends_it(ready):
    """AUTOPILOT.md 3: "a velocity message during takeoff ends it"."""
    assert ready.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    assert ready.command(ARM, 1) == ACCEPTED
    assert ready.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 20) == ACCEPTED
    ready.until(lambda: ready.position[2] < -4, 20)
    ready.stream(1, 1.0, 0.0, 0.0)
    assert ready.landed == 2
    ready.fly(10)
    assert ready.position[2] > -12
    assert math.hypot(*ready.velocity) < 0.1


def test_auto_disarm_without_takeoff(ready):
    """DISARM_DELAY 10 s."""
    assert ready.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    assert ready.command(ARM, 1) == ACCEPTED
    took = ready.until(lambda: "Disarming motors" in ready.texts(), 15)
    assert took == pytest.approx(10, abs=0.3)


def test_home_is_set_at_arming_and_told_at_once(hovering):
    """As recorded: HOME_POSITION and GPS_GLOBAL_ORIGIN to everybody when the vehicle is armed."""
    hovering.stream(5, 3.0, 0.0, 0.0)
    hovering.fly(6)
    assert hovering.command(21) == ACCEPTED
    hovering.until(lambda: not hovering.armed, 60)
    before = len(hovering.messages)
    assert hovering.command(DO_SET_MODE, 1, GUIDED) == ACCEPTED
    assert hovering.command(ARM, 1) == ACCEPTED
    assert {"HOME_POSITION", "GPS_GLOBAL_ORIGIN"} <= kinds_since(hovering, before)
    assert hovering.latest["HOME_POSITION"].x == pytest.approx(hovering.position[0], abs=0.01)
    assert hovering.position[0] > 10


def test_return_below_its_altitude_climbs_first(hovering):
    """RTL_ALT 15 m; WP_YAW_BEHAVIOR 2 keeps the heading; lands where it was armed."""
    hovering.stream(10, 5.0, 0.0, 0.0)
    hovering.fly(5)
    assert hovering.command(20) == ACCEPTED
    highest = 0.0

    def watch() -> None:
        nonlocal highest
        highest = max(highest, -hovering.position[2])
        assert abs(hovering.latest["ATTITUDE"].yaw) < 0.1

    hovering.until(lambda: not hovering.armed, 120, watch)
    assert highest == pytest.approx(15, abs=0.5)
    assert math.hypot(*hovering.position[:2]) < 0.3


# GUIDED


@pytest.mark.parametrize("mask", [VELOCITY, VELOCITY_YAW, VELOCITY_YAW_RATE])
@pytest.mark.parametrize("frame", [1, 7, 8, 9])
def test_frames_and_masks_of_velocity(hovering, frame, mask):
    """AUTOPILOT.md 3: frames 1, 7, 8, 9; masks 3527 (velocity), 2503 (+yaw), 1479 (+yaw rate)."""
    hovering.stream(6, 2.0, -1.0, -0.5, frame=frame, mask=mask)
    assert hovering.velocity == pytest.approx((2.0, -1.0, -0.5), abs=0.1)


@pytest.mark.parametrize(
    ("velocity", "how"),
    [
        ((NAN, 0.0, 0.0), {}),
        ((NAN, NAN, NAN), {}),
        ((math.inf, 0.0, 0.0), {}),
        ((2.0, 0.0, 0.0), {"frame": 0}),
        ((2.0, 0.0, 0.0), {"frame": 12}),
        ((2.0, 0.0, 0.0), {"mask": 4095}),
    ],
)
def test_what_means_nothing_stops(hovering, velocity, how):
    """AUTOPILOT.md 3: "NaN, inf, frames 0 and 12: target 0"; as recorded also mask 4095. It stays in GUIDED."""
    hovering.stream(4, 2.0, 0.0, 0.0)
    assert hovering.velocity[0] == pytest.approx(2.0, abs=0.15)
    hovering.stream(5, *velocity, **({"mask": VELOCITY_YAW_RATE} | how))
    assert math.hypot(*hovering.velocity) < 0.1
    assert hovering.mode == GUIDED
    target = hovering.latest["POSITION_TARGET_LOCAL_NED"]
    assert (target.vx, target.vy, target.vz, target.type_mask) == (0.0, 0.0, 0.0, 3079)


def test_body_frames_turn_with_the_heading(hovering):
    hovering.stream(4, 0.0, 0.0, 0.0, mask=VELOCITY_YAW, yaw=math.pi / 2)
    hovering.stream(5, 2.0, 0.0, 0.0, mask=VELOCITY, frame=8)
    assert hovering.velocity == pytest.approx((0.0, 2.0, 0.0), abs=0.15)


def test_yaw_is_turned_and_held(hovering):
    """Mask 2503 with yaw 90 deg, then 1479 with yaw rate 0: the heading stays, as recorded."""
    hovering.stream(4, 1.0, 0.0, 0.0, mask=VELOCITY_YAW, yaw=1.57)
    assert hovering.latest["ATTITUDE"].yaw == pytest.approx(1.57, abs=0.05)
    hovering.stream(3, 0.0, 0.0, 0.0, mask=VELOCITY_YAW_RATE)
    assert hovering.latest["ATTITUDE"].yaw == pytest.approx(1.57, abs=0.05)


def test_stream_stop_flies_on_for_3_s_then_brakes_silently(hovering):
    """AUTOPILOT.md 3: "On stream stop: stays in GUIDED, last velocity for 3.0 s, then brakes to zero, silently"."""
    hovering.stream(6, 3.0, 0.0, 0.0)
    texts = len(hovering.texts())
    last_ms = hovering.time_ms
    hovering.fly(2.9)
    assert hovering.velocity[0] == pytest.approx(3.0, abs=0.1)
    hovering.until(lambda: hovering.velocity[0] < 2.9, 2)
    assert hovering.time_ms - last_ms == pytest.approx(3300, abs=250)
    hovering.fly(5)
    assert math.hypot(*hovering.velocity) < 0.1
    assert hovering.mode == GUIDED
    assert len(hovering.texts()) == texts


def test_guid_timeout_acts():
    with copter(GUID_TIMEOUT=1.0) as vehicle:
        vehicle.take_off(10.0)
        vehicle.stream(4, 3.0, 0.0, 0.0)
        vehicle.fly(3.0)
        assert abs(vehicle.velocity[0]) < 0.3


def test_foreign_target_is_ignored_and_broadcast_component_taken(hovering):
    """As recorded: target system 9 does nothing; component 0 is obeyed."""
    hovering.stream(3, 2.0, 0.0, 0.0, target=9)
    assert math.hypot(*hovering.velocity) < 0.1
    hovering.stream(4, 2.0, 0.0, 0.0, target=0)
    assert hovering.velocity[0] == pytest.approx(2.0, abs=0.15)


def test_mask_0_flies_to_the_place_given(hovering):
    """AUTOPILOT.md 2 and as recorded: mask 0 flies to (0, 0, 0) with all that is given."""
    hovering.stream(8, 5.0, 0.0, 0.0)
    hovering.fly(6)
    start = hovering.position
    hovering.stream(2, 0.0, 0.0, 0.0, mask=0)
    assert hovering.position[0] < start[0] - 1.0
    assert hovering.position[2] > start[2] + 0.3


def test_position_setpoint_is_reached_and_held(hovering):
    """Position only (mask 3576 with yaw ignored): WPNAV_* limits; MAVSDK's set_position_ned."""
    hovering.fly(15, lambda: hovering.setpoint(mask=0xDF8, position=(12.0, -5.0, -14.0)))
    assert hovering.position == pytest.approx((12.0, -5.0, -14.0), abs=0.3)
    assert hovering.mode == GUIDED
    assert hovering.latest["POSITION_TARGET_LOCAL_NED"].type_mask == 3576


def test_position_with_velocity_is_flown(hovering):
    """AUTOPILOT.md 3: `set_position_velocity_ned` on both (acceleration and yaw rate ignored)."""
    hovering.fly(12, lambda: hovering.setpoint(0.0, 0.0, 0.0, mask=0x9C0, position=(10.0, 4.0, -12.0)))
    assert hovering.position == pytest.approx((10.0, 4.0, -12.0), abs=0.3)


def test_huge_velocity_is_limited_by_tilt_alone(hovering):
    """As recorded: 1000 m/s north tilts to ANGLE_MAX (30 deg), is at 9.3 m/s after 4.7 s, and can be stopped again."""
    hovering.stream(4.7, 1000.0, 0.0, 0.0, mask=VELOCITY_YAW_RATE)
    assert hovering.velocity[0] == pytest.approx(9.3, abs=0.5)
    tilt = max(abs(m.pitch) for m in hovering.messages if m.get_type() == "ATTITUDE")
    assert math.degrees(tilt) == pytest.approx(30, abs=2)
    hovering.stream(7, 0.0, 0.0, 0.0, mask=VELOCITY_YAW_RATE)
    assert math.hypot(*hovering.velocity) < 0.5
    assert hovering.position[2] == pytest.approx(-10, abs=1)


def test_modes_without_sticks_hold(hovering):
    """LOITER and BRAKE brake and hold the place when nobody has sticks."""
    hovering.stream(4, 3.0, 0.0, 0.0)
    assert hovering.command(DO_SET_MODE, 1, LOITER) == ACCEPTED
    hovering.fly(6)
    assert hovering.mode == LOITER
    assert math.hypot(*hovering.velocity) < 0.1
    assert hovering.position[2] == pytest.approx(-10, abs=0.3)


# Fence


def test_destination_outside_the_fence_is_refused_and_velocity_bent():
    """AUTOPILOT.md 3: "Fence violations of destinations are NAKed, velocity only bent"."""
    with copter(FENCE_ENABLE=1, FENCE_RADIUS=40, FENCE_ALT_MAX=30) as vehicle:
        vehicle.take_off(10.0)
        north, east = vehicle.autopilot.vehicle.origin.globe(60.0, 0.0)
        vehicle.send(
            mavlink.MAVLink_command_int_message(
                1, 1, 3, 192, 0, 0, -1, 1, 0, NAN, round(north * 1e7), round(east * 1e7), 10.0
            )
        )
        vehicle.advance(100)
        assert vehicle.latest["COMMAND_ACK"].command == 192
        assert vehicle.latest["COMMAND_ACK"].result == DENIED
        vehicle.fly(2, lambda: vehicle.setpoint(mask=0xDF8, position=(60.0, 0.0, -10.0)))
        assert math.hypot(*vehicle.position[:2]) < 1
        vehicle.stream(20, 5.0, 0.0, 0.0, mask=VELOCITY)
        assert 30 < vehicle.position[0] < 40
        assert vehicle.mode == GUIDED


# Parameters


def values(vehicle: Copter) -> list:
    return [m for m in vehicle.messages if m.get_type() == "PARAM_VALUE"]


def test_parameters_have_real_names_types_and_defaults():
    """Issue 4: about 120 real names with real defaults."""
    recorded = json.loads((DATA / "arducopter_params.json").read_text())
    p = Parameters(TABLE)
    assert len(p) >= 120
    for parameter in p:
        if parameter.name.startswith("SITL_"):  # our own, of sitl/flight/world.py
            continue
        value, mav_type = recorded[parameter.name]
        assert parameter.mav_type == mav_type, parameter.name
        assert p[parameter.name] == value, parameter.name


def test_integers_travel_as_c_casts(ready):
    """AUTOPILOT.md 1: "PX4 ints bytewise in the float, ArduPilot as a C cast"."""
    ready.send(mavlink.MAVLink_param_request_list_message(1, 1))
    ready.fly(1.5)
    got = {m.param_id: m for m in values(ready)}
    assert len(got) == len(Parameters(TABLE))
    assert {m.param_count for m in got.values()} == {len(got)}
    assert got["RTL_ALT"].param_value == 1500.0
    assert got["RTL_ALT"].param_type == 6
    assert got["COMPASS_DEV_ID"].param_value == 97539.0
    ready.send(mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2000.0, 9))
    ready.advance(100)
    assert values(ready)[-1].param_value == 2000.0
    assert ready.autopilot.vehicle.parameters["RTL_ALT"] == 2000.0
    bytewise = struct.unpack("<f", struct.pack("<i", 2500))[0]
    ready.send(mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", bytewise, 6))
    ready.advance(100)
    assert values(ready)[-1].param_value == 2000.0  # 3.5e-42 is cast to 0, which is out of range
    ready.send(mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2500.7, 9))
    ready.advance(100)
    assert values(ready)[-1].param_value == 2500.0


@pytest.mark.parametrize(
    ("name", "value", "speed"), [("WPNAV_ACCEL", 100.0, 1.9), ("WPNAV_ACCEL", 500.0, 4.1), ("ANGLE_MAX", 1000.0, 2.4)]
)
def test_parameters_act_on_a_velocity_step(name, value, speed):
    """North speed 2 s after a step to 5 m/s, by hand.

    Acceleration a reached at the jerk j = 5 m/s3 after a/j: 2a - a^2/2j for 1 m/s2; for 5 m/s2 half of the step in 1 s,
    then exp(-j/a t) of the rest; at 10 deg g tan(10) = 1.73 m/s2 against the drag of 0.37/s. The attitude lags a bit.
    """
    with copter(**{name: value}) as vehicle:
        vehicle.take_off(10.0)
        vehicle.stream(2, 5.0, 0.0, 0.0, mask=VELOCITY)
        assert vehicle.velocity[0] == pytest.approx(speed, abs=0.3)


def test_unknown_parameter_is_silence(ready):
    """AUTOPILOT.md 1: unknown name: silence."""
    ready.send(mavlink.MAVLink_param_request_read_message(1, 1, b"MPC_XY_VEL_MAX", -1))
    ready.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9))
    ready.advance(200)
    assert values(ready) == []
    ready.send(mavlink.MAVLink_param_request_read_message(1, 1, b"GUID_TIMEOUT", -1))
    ready.advance(200)
    assert values(ready)[-1].param_value == 3.0


def test_clock_services(ready):
    """AUTOPILOT.md 1: answer PING, TIMESYNC (tc1 = 0 is a request; the reply mirrors ts1)."""
    ready.send(mavlink.MAVLink_timesync_message(0, 123456789))
    ready.send(mavlink.MAVLink_ping_message(42, 7, 0, 0))
    ready.advance()
    answers = [m for m in ready.messages if m.get_type() == "TIMESYNC" and m.tc1 > 0]
    assert answers[-1].ts1 == 123456789
    assert ready.latest["PING"].seq == 7


@pytest.mark.parametrize(("action", "mode"), [(0, GUIDED), (1, LAND), (2, RTL)])
def test_low_battery(action, mode):
    """BATT_FS_LOW_ACT 0 warns, 1 lands, 2 returns, at BATT_LOW_MAH left of a small battery."""
    with copter(BATT_CAPACITY=300, BATT_LOW_MAH=200, BATT_FS_LOW_ACT=action) as vehicle:
        vehicle.take_off(20.0)
        vehicle.until(lambda: any(text.startswith("Battery 1 is low") for text in vehicle.texts()), 60)
        vehicle.fly(1.5)
        assert vehicle.mode == mode
        assert (vehicle.latest["HEARTBEAT"].system_status == 5) == bool(action)
