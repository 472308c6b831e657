"""The ArduCopter personality as its own process, flown over TCP as ArduPilot's own examples do with pymavlink."""

import time

import pytest
from pymavlink import mavutil
from typer.testing import CliRunner

from mission.cli import app
from tests.sitl.process import sitl_process


def wait_message(master, name: str, condition=lambda message: True, limit_s: float = 30.0):
    deadline = time.monotonic() + limit_s
    while time.monotonic() < deadline:
        message = master.recv_match(type=name, blocking=True, timeout=1.0)
        if message is not None and condition(message):
            return message
    raise AssertionError(f"no such {name} within {limit_s} s")


def test_mavutil_flies_it_over_tcp():
    """wait_heartbeat, request_data_stream_send, set_mode by name, arducopter_arm, takeoff, velocity, RTL."""
    with sitl_process("--personality", "arducopter", "--tcp-port", "0", lockstep=False, speed=20.0) as sitl:
        master = mavutil.mavlink_connection(f"tcp:127.0.0.1:{sitl.tcp}", source_system=255)
        try:
            assert master.wait_heartbeat(timeout=10) is not None
            master.mav.request_data_stream_send(1, 1, mavutil.mavlink.MAV_DATA_STREAM_ALL, 4, 1)
            prearm = mavutil.mavlink.MAV_SYS_STATUS_PREARM_CHECK
            wait_message(master, "SYS_STATUS", lambda m: m.onboard_control_sensors_health & prearm)
            assert wait_message(master, "EKF_STATUS_REPORT").flags == 831
            master.set_mode("GUIDED")
            wait_message(master, "HEARTBEAT", lambda m: m.custom_mode == 4)
            assert master.flightmode == "GUIDED"
            master.arducopter_arm()
            master.motors_armed_wait()
            master.mav.command_long_send(1, 1, mavutil.mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 10)
            wait_message(master, "GLOBAL_POSITION_INT", lambda m: m.relative_alt > 9500)
            moving = False
            deadline = time.monotonic() + 30.0
            while not moving:
                assert time.monotonic() < deadline
                master.mav.set_position_target_local_ned_send(0, 1, 1, 9, 3527, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0)
                hud = master.recv_match(type="VFR_HUD", blocking=True, timeout=0.05)
                moving = hud is not None and hud.groundspeed > 3.0
            master.set_mode_rtl()
            master.motors_disarmed_wait()
            assert abs(wait_message(master, "LOCAL_POSITION_NED").z) < 0.1
            assert sitl.process.poll() is None
        finally:
            master.close()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--personality", "betaflight"], ["px4", "arducopter"]),
        (["--personality", "arducopter", "--param", "MPC_XY_VEL_MAX=8"], ["MPC_XY_VEL_MAX", "unknown"]),
        (["--personality", "arducopter", "--param", "WPNAV_SPEED=0"], ["WPNAV_SPEED", "10 to 2000"]),
    ],
)
def test_bad_options_are_one_clear_line(arguments, words):
    result = CliRunner().invoke(app, ["sitl", *arguments])
    assert result.exit_code == 2
    assert all(word in result.output for word in words)
