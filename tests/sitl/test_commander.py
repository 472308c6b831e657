"""Arming, modes, failsafes and landed state, each line of AUTOPILOT.md 2 that this vehicle can show.

The vehicle is in this process; commands and telemetry go over real UDP.
"""

import contextlib
import math
import socket

import pytest
from pymavlink.dialects.v20 import development as mavlink

from sitl.px4.streams import COMPANION_RATES_HZ
from tests.sitl.client import direct

NAN = math.nan
ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
ARM, TAKEOFF, LAND, RTL, DO_SET_MODE = 400, 22, 21, 20, 176
POSCTL, LOITER, MISSION, RETURN, LANDING, OFFBOARD = (3, 0), (4, 3), (4, 4), (4, 5), (4, 6), (6, 0)
FORCE = 21196


def first_time_ms(vehicle, name: str, condition=lambda message: True) -> int:
    return next(
        time
        for time, message in zip(vehicle.times, vehicle.messages, strict=True)
        if message.get_type() == name and condition(message)
    )


# Boot


def test_boot_timeline(vehicle):
    """Telemetry 0.5 s, HEARTBEAT 1.0 to 1.6 s (status 0, present 0 at first), HOME 2.4 s, armable 3.9 to 4.6 s."""
    vehicle.until(lambda: vehicle.time_ms >= 6000, 7)
    assert vehicle.times[0] == pytest.approx(500, abs=60)
    assert 1000 <= first_time_ms(vehicle, "HEARTBEAT") <= 1600
    assert next(m for m in vehicle.messages if m.get_type() == "HEARTBEAT").system_status == 0
    assert next(m for m in vehicle.messages if m.get_type() == "SYS_STATUS").onboard_control_sensors_present == 0
    assert first_time_ms(vehicle, "HOME_POSITION") == pytest.approx(2400, abs=100)
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    armable = first_time_ms(vehicle, "SYS_STATUS", lambda m: m.onboard_control_sensors_health & prearm)
    assert 3900 <= armable <= 4600
    assert vehicle.latest["HEARTBEAT"].system_status == 3
    assert vehicle.latest["HEARTBEAT"].base_mode == 0x1D


def test_arming_too_early_is_rejected_with_the_reason(vehicle):
    """TEMPORARILY_REJECTED and "Arming denied: ..." (severity 2, split at 50 characters), before the ACK."""
    vehicle.fly(2)
    assert vehicle.command(ARM, 1) == TEMPORARILY_REJECTED
    assert vehicle.texts() == ["Arming denied: Resolve system health failures first"]
    chunks = [m for m in vehicle.messages if m.get_type() == "STATUSTEXT"]
    assert [(len(m.text), m.severity, m.chunk_seq) for m in chunks] == [(50, 2, 0), (2, 2, 1)]
    kinds = [m.get_type() for m in vehicle.messages]
    assert kinds.index("STATUSTEXT") < kinds.index("COMMAND_ACK")


def test_companion_rates():
    """The companion link's rates, in a steady 10 s; time_boot_ms never goes back."""
    with direct(COMPANION_RATES_HZ) as vehicle:
        vehicle.boot()
        before = len(vehicle.messages)
        vehicle.fly(10)
    got = [m.get_type() for m in vehicle.messages[before:]]
    for name, rate in {
        "ATTITUDE": 100, "HIGHRES_IMU": 50, "ATTITUDE_QUATERNION": 50, "GLOBAL_POSITION_INT": 50,
        "LOCAL_POSITION_NED": 30, "ODOMETRY": 30, "ALTITUDE": 10, "ATTITUDE_TARGET": 10,
        "POSITION_TARGET_LOCAL_NED": 10, "SERVO_OUTPUT_RAW": 10, "VFR_HUD": 10, "GPS_RAW_INT": 8, "SYS_STATUS": 5,
        "EXTENDED_SYS_STATE": 5, "HEARTBEAT": 1, "ESTIMATOR_STATUS": 1, "SYSTEM_TIME": 1, "HOME_POSITION": 0.5,
        "BATTERY_STATUS": 0.5, "CURRENT_MODE": 0.5,
    }.items():  # fmt: skip
        assert got.count(name) == pytest.approx(10 * rate, abs=1), name
    stamps = [m.time_boot_ms for m in vehicle.messages if hasattr(m, "time_boot_ms")]
    assert stamps == sorted(stamps)


# ACKs


def test_acks_on_the_ground(vehicle):
    """The results listed in AUTOPILOT.md 2, while standing."""
    vehicle.boot()
    assert vehicle.command(31000) == UNSUPPORTED
    assert vehicle.command(34) == UNSUPPORTED  # orbit
    assert vehicle.command(512, 99999) == DENIED
    assert vehicle.command(511, 99999, 100000) == FAILED
    assert vehicle.command(ARM, 1, component=50) is None
    assert vehicle.command(ARM, 1, system=7) is None
    assert vehicle.command(ARM, 2) is None
    assert vehicle.command(DO_SET_MODE, 1, 4, 4) == TEMPORARILY_REJECTED  # no mission
    assert vehicle.command(DO_SET_MODE, 1, 6) == ACCEPTED  # without a stream, while disarmed
    vehicle.fly(1)
    assert vehicle.mode == OFFBOARD
    assert vehicle.latest["HEARTBEAT"].base_mode == 0x11
    assert vehicle.command(ARM, 1) == TEMPORARILY_REJECTED  # in OFFBOARD without a stream
    vehicle.send(mavlink.MAVLink_set_mode_message(1, 1, 4 << 16 | 3 << 24))
    vehicle.fly(1)
    assert vehicle.mode == LOITER
    assert vehicle.latest["COMMAND_ACK"].result == ACCEPTED
    assert vehicle.command(ARM, 1) == ACCEPTED
    assert vehicle.command(ARM, 1) == ACCEPTED  # when armed
    assert vehicle.command(ARM, 0) == ACCEPTED


def test_acks_in_the_air(hovering):
    assert hovering.command(DO_SET_MODE, 1, 6) == TEMPORARILY_REJECTED  # no stream
    assert hovering.command(DO_SET_MODE, 1, 3) == TEMPORARILY_REJECTED  # no sticks
    assert hovering.command(DO_SET_MODE, 1, 1) == TEMPORARILY_REJECTED
    assert hovering.command(DO_SET_MODE, 1, 4, 4) == TEMPORARILY_REJECTED  # no mission
    assert hovering.command(ARM, 0) == TEMPORARILY_REJECTED
    assert hovering.texts()[-1] == "Disarming denied: not landed"
    assert hovering.armed
    assert hovering.command(LAND, 0, 0, 0, NAN) == ACCEPTED
    assert hovering.command(RTL) == ACCEPTED
    assert hovering.command(DO_SET_MODE, 1, 4, 3) == ACCEPTED
    assert hovering.command(ARM, 0, FORCE) == ACCEPTED
    hovering.fly(5)
    assert not hovering.armed
    assert hovering.position[2] == 0.0


def test_command_int_is_understood(vehicle):
    vehicle.boot()
    vehicle.send(mavlink.MAVLink_command_int_message(1, 1, 0, ARM, 0, 0, 1, 0, 0, 0, 0, 0, 0))
    vehicle.fly(1)
    assert vehicle.armed
    assert vehicle.latest["COMMAND_ACK"].command == ARM


def test_ack_goes_to_the_asker(vehicle):
    vehicle.boot()
    vehicle.command(ARM, 1)
    ack = vehicle.latest["COMMAND_ACK"]
    assert (ack.target_system, ack.target_component) == (240, 191)


# Messages


def test_request_message_and_interval(vehicle):
    vehicle.boot()
    assert vehicle.command(512, 148) == ACCEPTED
    assert vehicle.latest["AUTOPILOT_VERSION"].capabilities == 0xE8FF
    assert vehicle.command(512, 49) == ACCEPTED
    assert vehicle.latest["GPS_GLOBAL_ORIGIN"].latitude == 473977430
    assert vehicle.command(511, 32, 20000) == ACCEPTED
    assert vehicle.command(510, 32) == ACCEPTED
    assert vehicle.latest["MESSAGE_INTERVAL"].interval_us == 20000
    before = len(vehicle.messages)
    vehicle.fly(2)
    assert [m.get_type() for m in vehicle.messages[before:]].count("LOCAL_POSITION_NED") == pytest.approx(100, abs=1)
    assert vehicle.command(511, 30, -1) == ACCEPTED
    before = len(vehicle.messages)
    vehicle.fly(1)
    assert "ATTITUDE" not in [m.get_type() for m in vehicle.messages[before:]]
    assert vehicle.command(511, 30, 0) == ACCEPTED
    assert vehicle.link.interval_us("ATTITUDE") == 100_000  # this link's usual rate


def test_clock_services(vehicle):
    """TIMESYNC: tc1 = 0 is a request; the reply mirrors ts1."""
    vehicle.boot()
    vehicle.send(mavlink.MAVLink_timesync_message(0, 123456789))
    vehicle.send(mavlink.MAVLink_ping_message(42, 7, 0, 0))
    vehicle.advance()
    assert vehicle.latest["TIMESYNC"].ts1 == 123456789
    assert vehicle.latest["TIMESYNC"].tc1 > 0
    ping = vehicle.latest["PING"]
    assert (ping.time_usec, ping.seq, ping.target_system, ping.target_component) == (42, 7, 240, 191)


# Takeoff and landing


def test_takeoff_hold_land_and_disarm(vehicle):
    """Landed state 1 -> 3 -> 2 -> 4 -> 1; hold after takeoff; disarm 2 s after landing; home reset at arm."""
    vehicle.take_off()
    assert vehicle.position[2] == pytest.approx(-2.5, abs=0.8)
    vehicle.fly(5)
    assert vehicle.position[2] == pytest.approx(-2.5, abs=0.1)
    assert vehicle.latest["HEARTBEAT"].base_mode == 0x9D
    assert vehicle.command(LAND, 0, 0, 0, NAN) == ACCEPTED
    vehicle.until(lambda: not vehicle.armed, 30)
    states = [m.landed_state for m in vehicle.messages if m.get_type() == "EXTENDED_SYS_STATE"]
    assert [s for i, s in enumerate(states) if i == 0 or s != states[i - 1]] == [1, 3, 2, 4, 1]
    texts = vehicle.texts()
    assert texts[-2:] == ["Landing detected", "Disarmed by landing"]
    assert "Takeoff detected" in texts
    landed_ms, disarmed_ms = (
        first_time_ms(vehicle, "STATUSTEXT", lambda m, text=text: m.text.startswith(text))
        for text in ("Landing detected", "Disarmed by landing")
    )
    assert disarmed_ms - landed_ms == pytest.approx(2000, abs=100)


def test_takeoff_climbs_at_its_own_speed(vehicle):
    """MPC_TKO_SPEED 1.5 m/s; MIS_TAKEOFF_ALT by the altitude asked for.

    Recorded: armed at 4.13 s, asked for 9.9 m at 5.62 s, at most 1.495 m/s, there between 16.13 and 16.23 s.
    """
    vehicle.boot()
    assert vehicle.command(ARM, 1) == ACCEPTED
    vehicle.fly(1.4)
    asked_ms = vehicle.time_ms
    assert vehicle.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, 489.4 + 9.9) == ACCEPTED
    fastest = 0.0
    while vehicle.landed != 2:
        vehicle.advance(10)
        fastest = max(fastest, -vehicle.velocity[2])
        assert vehicle.time_ms < 40_000
    assert fastest == pytest.approx(1.495, abs=0.05)
    took_s = (vehicle.time_ms - asked_ms) / 1000
    assert took_s == pytest.approx(16.18 - 5.62, abs=0.3)  # 0.2 s late, EXTENDED_SYS_STATE at 5 Hz: docs/sitl.md
    vehicle.fly(1.1)
    assert vehicle.mode == LOITER


@pytest.mark.parametrize("number", [512, ARM, 31_999])
def test_a_command_is_acknowledged_in_the_step_in_which_it_is_read(vehicle, number):
    """AUTOPILOT.md 2: "Latency 1 to 20 ms": taken, denied or unknown, within 1 ms of vehicle time here."""
    vehicle.boot()
    vehicle.receive()
    before = len(vehicle.messages)
    vehicle.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, 1, 0, 0, 0, 0, 0, 0))
    vehicle.advance(1)
    acks = [m.command for m in vehicle.messages[before:] if m.get_type() == "COMMAND_ACK"]
    assert acks == [number]


def test_auto_disarm_without_takeoff(vehicle):
    """About 11 s after arming without takeoff."""
    vehicle.boot()
    assert vehicle.command(ARM, 1) == ACCEPTED
    took = vehicle.until(lambda: "Disarmed by auto preflight disarming" in vehicle.texts(), 15)
    assert took == pytest.approx(11, abs=0.6)


def test_home_is_reset_at_arming(vehicle):
    vehicle.take_off()
    vehicle.offboard(2.0, 0.0, 0.0)
    vehicle.fly(4, lambda: vehicle.setpoint(2.0, 0.0, 0.0))
    assert vehicle.command(LAND) == ACCEPTED
    vehicle.until(lambda: not vehicle.armed, 30)
    assert vehicle.latest["HOME_POSITION"].x == pytest.approx(0, abs=0.01)
    assert vehicle.command(DO_SET_MODE, 1, 4, 3) == ACCEPTED
    assert vehicle.command(ARM, 1) == ACCEPTED
    vehicle.fly(2.5)
    assert vehicle.latest["HOME_POSITION"].x == pytest.approx(vehicle.position[0], abs=0.01)
    assert vehicle.position[0] > 3


def test_return_climbs_comes_home_lands_and_disarms(hovering):
    """RTL_RETURN_ALT 30 m, cruise at MPC_XY_CRUISE 5 m/s, landed state 4 on the way down."""
    hovering.offboard(8.0, 0.0, 0.0)
    hovering.fly(8, lambda: hovering.setpoint(8.0, 0.0, 0.0))
    assert hovering.position[0] > 30
    assert hovering.command(RTL) == ACCEPTED
    hovering.fly(1)
    assert hovering.mode == RETURN
    highest = 0.0

    def watch():
        nonlocal highest
        highest = max(highest, -hovering.position[2])

    hovering.until(lambda: not hovering.armed, 120, watch)
    assert highest == pytest.approx(30, abs=1.0)
    assert math.hypot(*hovering.position[:2]) < 0.5
    assert hovering.latest["ATTITUDE"].yaw == pytest.approx(0.0, abs=0.05)  # as at arming
    assert "RTL: start return at 519 m (30 m above destination)" in hovering.texts()
    assert "RTL: land at destination" in hovering.texts()


# OFFBOARD


def test_offboard_at_the_instant_the_stream_starts_is_rejected(hovering):
    hovering.setpoint(0.0, 0.0, 0.0)
    assert hovering.command(DO_SET_MODE, 1, 6) == TEMPORARILY_REJECTED


def test_offboard_after_50_ms_of_stream_is_accepted(hovering):
    hovering.setpoint(0.0, 0.0, 0.0)
    hovering.advance(50)
    hovering.setpoint(0.0, 0.0, 0.0)
    assert hovering.command(DO_SET_MODE, 1, 6) == ACCEPTED


def test_offboard_after_one_setpoint_100_ms_before_is_accepted(hovering):
    hovering.setpoint(0.0, 0.0, 0.0)
    hovering.advance(100)
    assert hovering.command(DO_SET_MODE, 1, 6) == ACCEPTED


@pytest.mark.parametrize(("period_ms", "holds"), [(500, True), (1250, False)])
def test_stream_rates(hovering, period_ms, holds):
    """2 Hz holds; 0.8 Hz cycles the failsafe."""
    hovering.offboard(0.0, 0.0, 0.0)
    for _ in range(8):
        hovering.setpoint(0.0, 0.0, 0.0)
        hovering.advance(period_ms)
    failsafes = hovering.texts().count("Failsafe activated")
    assert failsafes == 0 if holds else failsafes >= 3


def lose_the_stream(vehicle) -> int:
    """Fly north at 3 m/s, stop the stream, wait for the failsafe; milliseconds from the last setpoint."""
    vehicle.offboard(3.0, 0.0, 0.0)
    vehicle.fly(4, lambda: vehicle.setpoint(3.0, 0.0, 0.0))
    vehicle.setpoint(3.0, 0.0, 0.0)
    last = vehicle.time_ms
    while "Failsafe activated" not in vehicle.texts():
        vehicle.advance(10)
        if vehicle.time_ms - last < 1000:
            assert vehicle.velocity[0] > 2.0  # the last setpoint flies on
        assert vehicle.time_ms - last < 3000
    return vehicle.time_ms - last


def test_stream_loss_without_sticks_levels_sinks_lands_disarms(hovering):
    """Failsafe 1.03 to 1.11 s after the last setpoint, to POSCTL: coasts, sinks at 0.7 m/s, lands, disarms."""
    assert 1030 <= lose_the_stream(hovering) <= 1110
    hovering.fly(3)
    assert hovering.mode == POSCTL
    heartbeat = hovering.latest["HEARTBEAT"]
    assert (heartbeat.base_mode, heartbeat.system_status) == (0xD1, 5)
    attitude = hovering.latest["ATTITUDE"]
    assert abs(attitude.pitch) < math.radians(2)
    assert abs(attitude.roll) < math.radians(2)
    assert hovering.velocity[2] == pytest.approx(0.7, abs=0.05)
    assert 0 < hovering.velocity[0] < 1
    hovering.until(lambda: not hovering.armed, 40)
    assert hovering.position[2] == 0.0


def test_resuming_the_stream_reenters_offboard_by_itself(hovering):
    lose_the_stream(hovering)
    hovering.fly(2)
    assert hovering.mode == POSCTL
    hovering.fly(1.5, lambda: hovering.setpoint(0.0, 0.0, 0.0))
    assert hovering.mode == OFFBOARD
    assert hovering.latest["HEARTBEAT"].system_status == 4


@pytest.mark.parametrize(("action", "mode"), [(3, RETURN), (4, LANDING), (5, LOITER)])
def test_stream_loss_action(action, mode):
    """COM_OBL_RC_ACT 3 = RTL, 4 = land, 5 = hold."""
    with direct(COM_OBL_RC_ACT=action) as vehicle:
        vehicle.take_off(499.4)
        assert 1030 <= lose_the_stream(vehicle) <= 1110
        vehicle.fly(1.2)
        assert vehicle.mode == mode
        if action == 3:
            vehicle.until(lambda: not vehicle.armed, 120)
            assert math.hypot(*vehicle.position[:2]) < 0.5


def test_user_mode_change_ends_the_failsafe(hovering):
    lose_the_stream(hovering)
    assert hovering.command(RTL) == ACCEPTED
    hovering.fly(1.2)
    assert hovering.mode == RETURN
    assert hovering.latest["HEARTBEAT"].system_status == 4
    hovering.fly(2, lambda: hovering.setpoint(0.0, 0.0, 0.0))
    assert hovering.mode == RETURN  # a stream alone does not take the vehicle back


def test_offboard_entered_during_takeoff_is_not_stolen(vehicle):
    """AUTOPILOT.md 6: "takeoff complete -> hold" must not fire after the user entered OFFBOARD."""
    vehicle.boot()
    vehicle.command(ARM, 1)
    vehicle.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, 499.4)
    vehicle.until(lambda: vehicle.landed == 3, 10)
    vehicle.offboard(0.0, 0.0, -1.0)
    vehicle.fly(15, lambda: vehicle.setpoint(0.0, 0.0, -1.0))
    assert vehicle.mode == OFFBOARD
    assert vehicle.position[2] < -11


def test_takeoff_in_offboard(vehicle):
    vehicle.boot()
    for _ in range(4):
        vehicle.setpoint(0.0, 0.0, -1.0)
        vehicle.advance()
    assert vehicle.command(DO_SET_MODE, 1, 6) == ACCEPTED
    vehicle.setpoint(0.0, 0.0, -1.0)
    assert vehicle.command(ARM, 1) == ACCEPTED
    vehicle.fly(8, lambda: vehicle.setpoint(0.0, 0.0, -1.0))
    assert vehicle.position[2] < -3
    assert vehicle.velocity[2] == pytest.approx(-1, abs=0.2)
    vehicle.fly(12, lambda: vehicle.setpoint(0.0, 0.0, 1.0))
    vehicle.until(lambda: not vehicle.armed, 10, lambda: vehicle.setpoint(0.0, 0.0, 1.0))


# Setpoints


@pytest.mark.parametrize("mask", [2503, 3527, 1479])
def test_velocity_masks(hovering, mask):
    hovering.offboard(2.0, -1.0, -0.5)
    hovering.fly(8, lambda: hovering.setpoint(2.0, -1.0, -0.5, mask=mask))
    assert hovering.velocity == pytest.approx((2.0, -1.0, -0.5), abs=0.35)


def test_velocity_with_yaw(hovering):
    hovering.offboard(0.0, 0.0, 0.0)
    hovering.fly(5, lambda: hovering.setpoint(0.0, 0.0, 0.0, yaw=1.5))
    assert hovering.latest["ATTITUDE"].yaw == pytest.approx(1.5, abs=0.05)


def test_body_frame_velocity_follows_the_heading(hovering):
    hovering.offboard(0.0, 0.0, 0.0)
    hovering.fly(5, lambda: hovering.setpoint(0.0, 0.0, 0.0, yaw=math.pi / 2))
    hovering.fly(6, lambda: hovering.setpoint(2.0, 0.0, 0.0, frame=8, yaw=math.pi / 2))
    assert hovering.velocity[1] == pytest.approx(1.8, abs=0.3)
    assert hovering.velocity[0] == pytest.approx(0, abs=0.2)


@pytest.mark.parametrize("frame", [0, 7, 9, 12])
def test_other_frames_are_refused(hovering, frame):
    hovering.setpoint(1.0, 0.0, 0.0, frame=frame)
    hovering.advance(100)
    assert hovering.texts()[-1] == f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported"
    assert hovering.command(DO_SET_MODE, 1, 6) == TEMPORARILY_REJECTED


@pytest.mark.parametrize(
    ("velocity", "mask"),
    [((3.0, NAN, 0.0), 2503), ((NAN, NAN, 0.0), 2503), ((math.inf, 0.0, 0.0), 2503), ((3.0, 0.0, 0.0), 2503 | 16)],
)
def test_incomplete_setpoints_brake_and_stay_offboard(hovering, velocity, mask):
    """One NaN or ignored axis, a NaN pair, or inf: brakes to 0, stays OFFBOARD."""
    hovering.offboard(3.0, 0.0, 0.0)
    hovering.fly(3, lambda: hovering.setpoint(3.0, 0.0, 0.0))
    hovering.fly(8, lambda: hovering.setpoint(*velocity, mask=mask))
    assert math.hypot(*hovering.velocity) < 0.3
    assert hovering.mode == OFFBOARD


def test_all_nan_is_invalid_and_lets_the_failsafe_come(hovering):
    hovering.offboard(0.0, 0.0, 0.0)
    hovering.fly(2.5, lambda: hovering.setpoint(NAN, NAN, NAN))
    assert "SET_POSITION_TARGET_LOCAL_NED invalid" in hovering.texts()
    assert "Failsafe activated" in hovering.texts()


def test_foreign_target_is_ignored_and_broadcast_taken(hovering):
    for _ in range(3):
        hovering.setpoint(1.0, 0.0, 0.0, target=7)
        hovering.advance()
    assert hovering.command(DO_SET_MODE, 1, 6) == TEMPORARILY_REJECTED
    for _ in range(3):
        hovering.setpoint(1.0, 0.0, 0.0, target=0)
        hovering.advance()
    assert hovering.command(DO_SET_MODE, 1, 6) == ACCEPTED


def test_position_setpoint_and_mask_0(hovering):
    """Mask 0 flies to the position given; position with velocity uses it as feed-forward."""
    hovering.offboard(0.0, 0.0, 0.0)
    hovering.fly(20, lambda: hovering.setpoint(0.0, 0.0, 0.0, mask=0, position=(5.0, -3.0, -12.0)))
    assert hovering.position == pytest.approx((5.0, -3.0, -12.0), abs=0.3)


# Battery


def drained(action: int):
    """A vehicle whose small battery is at the critical level half a minute after takeoff."""
    return direct(COM_LOW_BAT_ACT=action, BAT1_CAPACITY=80.0, BAT_LOW_THR=0.5, BAT_CRIT_THR=0.4)


@pytest.mark.parametrize(("action", "mode"), [(0, LOITER), (2, LANDING), (3, RETURN)])
def test_low_battery(action, mode):
    """COM_LOW_BAT_ACT 0 warns; 2 lands, 3 returns at the critical level, after COM_FAIL_ACT_T (5 s) of hold."""
    with drained(action) as vehicle:
        vehicle.take_off()
        vehicle.until(lambda: "Critical battery" in vehicle.texts(), 60)
        assert "Low battery" in vehicle.texts()
        critical_ms = vehicle.time_ms
        vehicle.fly(4)
        assert vehicle.mode == LOITER
        assert (vehicle.latest["HEARTBEAT"].system_status == 5) == bool(action)
        if not action:
            return
        vehicle.until(lambda: vehicle.mode in (LANDING, RETURN), 3)
        assert vehicle.time_ms - critical_ms == pytest.approx(5000, abs=1100)
        assert vehicle.mode == mode


def test_battery_drains_by_the_papers_power_model(hovering):
    """Hover: 192.5 W for the paper's wing (PAPER.md 5) out of BAT1_CAPACITY."""
    battery = hovering.commander.battery
    hovering.fly(5)
    before = battery.used_j
    hovering.fly(10)
    assert battery.used_j - before == pytest.approx(1925, rel=0.01)
    assert battery.pack.capacity_j == pytest.approx(5.0 * 3600 * 15.3)
    status = hovering.latest["SYS_STATUS"]
    assert status.voltage_battery / 1000 * status.current_battery / 100 == pytest.approx(192.5, rel=0.01)
    assert status.battery_remaining == math.ceil(100 * battery.remaining)


# Links


def test_ground_link_wakes_up_when_spoken_to_and_frames_are_forwarded(vehicle):
    """GCS link rates; each peer's frames reach the other link."""
    vehicle.boot()
    station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    heard: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind(vehicle.gcs.peer)
        udp.setblocking(False)

        def listen() -> None:
            with contextlib.suppress(BlockingIOError):
                while True:
                    heard.append(station.decode(bytearray(udp.recv(65535))).get_type())

        vehicle.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        vehicle.fly(2, listen)
        assert set(heard) == {"HEARTBEAT"}
        heard.clear()
        udp.sendto(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(station), ("127.0.0.1", vehicle.gcs.port))
        vehicle.fly(2, listen)
        for name in ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE", "SERVO_OUTPUT_RAW"):
            assert heard.count(name) == pytest.approx(100, abs=6), name
        assert any(m.get_srcSystem() == 255 for m in vehicle.messages)
