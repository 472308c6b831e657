"""MAVSDK 4.1, which nobody here wrote, flies the ArduCopter personality over TCP; asserting on where it is."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from mavsdk import mavsdk
from mavsdk.component_type import ComponentType
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.offboard import Offboard, VelocityNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import LandedState, Telemetry

from tests.sitl.process import sitl_process

SPEED = 10.0


def wait_for(condition: Callable[[], bool], limit_s: float = 60.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@contextmanager
def connected() -> Iterator[mavsdk.System]:
    with sitl_process("--personality", "arducopter", "--tcp-port", "0", lockstep=False, speed=SPEED) as sitl:
        client = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        try:
            client.add_any_connection(f"tcpout://127.0.0.1:{sitl.tcp}")
            system = client.first_autopilot(10.0)
            assert system is not None
            yield system
        finally:
            client.destroy()


def test_mavsdk_gets_health_after_asking_for_rates_and_flies_5_mps():
    """AUTOPILOT.md 3: nothing is streamed until asked; after `set_rate_*` health is true once armable (41 s here),
    `offboard.start()` puts it in GUIDED, and 5 m/s setpoints are flown at 5.08 m/s."""
    with connected() as system:
        action, telemetry, offboard = Action(system), Telemetry(system), Offboard(system)
        time.sleep(1.0)
        assert not telemetry.health_all_ok()
        for set_rate in (
            telemetry.set_rate_position_velocity_ned,
            telemetry.set_rate_position,
            telemetry.set_rate_health,
            telemetry.set_rate_home,
            telemetry.set_rate_landed_state,
            telemetry.set_rate_attitude_euler,
            telemetry.set_rate_gps_info,
            telemetry.set_rate_battery,
        ):
            set_rate(10.0)
        wait_for(telemetry.health_all_ok)
        assert telemetry.home().latitude_deg == pytest.approx(47.397743, abs=1e-6)
        assert telemetry.gps_info().num_satellites == 10

        def place() -> tuple[float, float, float]:
            position = telemetry.position_velocity_ned().position
            return position.north_m, position.east_m, position.down_m

        action.set_takeoff_altitude(6.0)
        action.arm()
        action.takeoff()
        wait_for(lambda: telemetry.landed_state() == LandedState.IN_AIR and abs(place()[2] + 6.0) < 0.3)
        with pytest.raises(ActionError):
            action.disarm()
        offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        offboard.start()
        offboard.set_velocity_ned(VelocityNedYaw(5.0, 0.0, 0.0, 90.0))
        wait_for(lambda: place()[0] > 25.0)
        assert telemetry.position_velocity_ned().velocity.north_m_s == pytest.approx(5.08, abs=0.15)
        assert telemetry.attitude_euler().yaw_deg == pytest.approx(90.0, abs=3.0)
        assert place()[2] == pytest.approx(-6.0, abs=0.5)
        offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 90.0))
        wait_for(lambda: abs(telemetry.position_velocity_ned().velocity.north_m_s) < 0.2)
        action.return_to_launch()
        wait_for(lambda: not telemetry.armed())
        assert place()[2] == pytest.approx(0.0, abs=0.05)
        assert abs(place()[0]) < 0.5


def test_mavsdk_reads_and_writes_parameters():
    """AUTOPILOT.md 1: ArduPilot's integers are C casts; MAVSDK knows."""
    with connected() as system:
        param = Param(system)
        assert param.get_param_int("RTL_ALT") == 1500
        param.set_param_int("RTL_ALT", 2000)
        assert param.get_param_int("RTL_ALT") == 2000
        assert param.get_param_float("WPNAV_SPEED") == pytest.approx(1000.0)
        everything = param.get_all_params()
        assert len(everything.int_params) + len(everything.float_params) >= 120
