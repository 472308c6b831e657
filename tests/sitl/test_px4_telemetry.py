"""What PX4 tells of itself and how often: lines of AUTOPILOT.md 2 about links, flags and the parameter list."""

import contextlib
import socket

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.px4.personality import PX4
from tests.sitl.client import direct

ARM, DO_SET_MODE = 400, 176


def test_ground_link_rates():
    """AUTOPILOT.md 2: "GCS link: LOCAL/GLOBAL_POSITION, ATTITUDE(+QUATERNION, TARGET), SERVO_OUTPUT_RAW,
    POSITION_TARGET 50; GPS_RAW_INT 5; the rest 1"."""
    with direct({"HEARTBEAT": 1.0}) as vehicle, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        station = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        heard: list[str] = []
        udp.bind(vehicle.gcs.peer)
        udp.setblocking(False)

        def listen() -> None:
            with contextlib.suppress(BlockingIOError):
                while True:
                    heard.append(station.decode(bytearray(udp.recv(65535))).get_type())

        def speak() -> None:
            heartbeat = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
            udp.sendto(heartbeat.pack(station), ("127.0.0.1", vehicle.gcs.port))

        vehicle.boot()
        vehicle.command(ARM, 1)
        listen()
        assert "Armed by external command" in vehicle.texts()
        assert set(heard) == {"HEARTBEAT"}  # docs/sitl.md: until the ground station speaks, texts neither
        speak()
        vehicle.fly(4)
        speak()
        listen()
        heard.clear()
        vehicle.fly(8, listen)
        fast = {
            "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE", "ATTITUDE_QUATERNION", "ATTITUDE_TARGET",
            "SERVO_OUTPUT_RAW", "POSITION_TARGET_LOCAL_NED",
        }  # fmt: skip
        for name in fast:
            assert heard.count(name) == pytest.approx(8 * 50, abs=12), name
        assert heard.count("GPS_RAW_INT") == pytest.approx(8 * 5, abs=2)
        for name in ("HEARTBEAT", "SYS_STATUS", "EXTENDED_SYS_STATE", "ALTITUDE", "VFR_HUD", "ESTIMATOR_STATUS"):
            assert heard.count(name) == pytest.approx(8, abs=1), name
        assert "HIGHRES_IMU" not in heard


def test_base_modes_while_armed(vehicle):
    """AUTOPILOT.md 2: "base_mode: 0x1d loiter, 0x9d armed, 0x11 OFFBOARD, 0x91 armed"."""
    vehicle.boot()
    assert vehicle.latest["HEARTBEAT"].base_mode == 0x1D
    for _ in range(4):
        vehicle.setpoint(0.0, 0.0, 0.0)
        vehicle.advance()
    assert vehicle.command(DO_SET_MODE, 1, 6) == 0
    vehicle.fly(1.1, lambda: vehicle.setpoint(0.0, 0.0, 0.0))
    assert vehicle.latest["HEARTBEAT"].base_mode == 0x11
    assert vehicle.command(ARM, 1) == 0
    vehicle.fly(1.1, lambda: vehicle.setpoint(0.0, 0.0, 0.0))
    assert vehicle.latest["HEARTBEAT"].base_mode == 0x91


def test_parameter_list_comes_at_about_1000_per_second(vehicle):
    """AUTOPILOT.md 2: "901 parameters in 0.9 s"."""
    vehicle.boot()
    vehicle.send(mavlink.MAVLink_param_request_list_message(1, 1))
    start_ms = vehicle.time_ms
    got = 0
    while got < len(PX4.table):
        vehicle.advance(10)
        got = sum(message.get_type() == "PARAM_VALUE" for message in vehicle.messages)
        assert vehicle.time_ms - start_ms < 2000
    assert got / (vehicle.time_ms - start_ms) == pytest.approx(1.0, rel=0.25)


def test_health_is_whole_at_4_8_s(vehicle):
    """AUTOPILOT.md 2: "`health_all_ok` true at 4.8 s": a HOME_POSITION and, within SYS_STATUS, the PREARM_CHECK bit."""
    vehicle.until(
        lambda: (
            "HOME_POSITION" in vehicle.latest
            and "SYS_STATUS" in vehicle.latest
            and vehicle.latest["SYS_STATUS"].onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK
        ),
        6,
    )
    assert 3.9 <= vehicle.time_ms / 1000 <= 4.8


def test_no_gps_in_sys_status_before_it_may_arm(vehicle):
    """The recorded boot: nothing present, then all but GPS, then GPS too, which MAVSDK's `health_all_ok` needs."""
    told = []
    for _ in range(60):
        vehicle.fly(0.1)
        if "SYS_STATUS" in vehicle.latest:
            status = vehicle.latest["SYS_STATUS"]
            armable = bool(status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_PREARM_CHECK)
            told.append((status.onboard_control_sensors_present, armable))
    assert list(dict.fromkeys(told)) == [(0, False), (0x0300400D, False), (0x0300402D, True)]


@pytest.mark.parametrize("period_ms", [670, 1000])
def test_marginal_streams_do_not_fly_away(hovering, period_ms):
    """AUTOPILOT.md 2: "1.5 to 1 Hz is marginal": OFFBOARD may drop out, but comes back by itself with each setpoint."""
    hovering.offboard(0.0, 0.0, 0.0)
    for _ in range(10):
        hovering.setpoint(0.0, 0.0, 0.0)
        hovering.advance(period_ms)
    assert abs(hovering.position[2] + 10) < 1.5
    hovering.fly(2, lambda: hovering.setpoint(0.0, 0.0, 0.0))
    assert hovering.mode == (6, 0)
