"""MAVSDK 4.1, which nobody here wrote, flies the SITL over UDP; the assertions are on where the vehicle is."""

import time
from collections.abc import Callable

import pytest
from mavsdk import mavsdk
from mavsdk.component_type import ComponentType
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.offboard import Offboard, OffboardError, VelocityNedYaw
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry

from tests.sitl.process import sitl_process

SPEED = 4.0


def wait_for(condition: Callable[[], bool], limit_s: float = 60.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_mavsdk_connects_arms_takes_off_flies_offboard_and_lands():
    with sitl_process(lockstep=False, speed=SPEED) as sitl:
        client = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        try:
            client.add_any_connection(f"udpin://127.0.0.1:{sitl.companion}")
            system = client.first_autopilot(10.0)
            assert system is not None
            action, telemetry, offboard, param = Action(system), Telemetry(system), Offboard(system), Param(system)

            def place() -> tuple[float, float, float]:
                position = telemetry.position_velocity_ned().position
                return position.north_m, position.east_m, position.down_m

            wait_for(telemetry.health_all_ok)
            assert telemetry.home().latitude_deg == pytest.approx(47.397743, abs=1e-6)
            assert action.get_takeoff_altitude() == pytest.approx(2.5)
            action.set_takeoff_altitude(4.0)
            param.set_param_int("COM_OBL_RC_ACT", 4)
            assert param.get_param_int("COM_OBL_RC_ACT") == 4

            action.arm()
            with pytest.raises(OffboardError):
                offboard.start()  # without a setpoint
            action.takeoff()
            wait_for(lambda: telemetry.flight_mode() == FlightMode.HOLD and telemetry.in_air())
            wait_for(lambda: abs(place()[2] + 4.0) < 0.3)
            with pytest.raises(ActionError):
                action.disarm()

            offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 90.0))
            time.sleep(0.2)
            offboard.start()
            wait_for(lambda: telemetry.flight_mode() == FlightMode.OFFBOARD)
            offboard.set_velocity_ned(VelocityNedYaw(3.0, 0.0, -0.5, 90.0))
            wait_for(lambda: place()[0] > 6.0)
            assert telemetry.position_velocity_ned().velocity.north_m_s == pytest.approx(2.7, abs=0.4)
            assert telemetry.attitude_euler().yaw_deg == pytest.approx(90.0, abs=3.0)
            assert place()[2] < -4.5
            offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 90.0))
            wait_for(lambda: abs(telemetry.position_velocity_ned().velocity.north_m_s) < 0.5)
            offboard.stop()
            wait_for(lambda: telemetry.flight_mode() == FlightMode.HOLD)

            action.land()
            wait_for(lambda: not telemetry.armed())
            assert telemetry.landed_state() == LandedState.ON_GROUND
            assert place()[2] == pytest.approx(0.0, abs=0.05)
            assert 6.0 < place()[0] < 20.0
        finally:
            client.destroy()
