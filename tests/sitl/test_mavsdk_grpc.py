"""MAVSDK-Python (mavsdk-grpc 4.0), which nobody here wrote: the flights that its examples show, on PX4.

One vehicle, one mavsdk_server for all of them; what is asserted on is where the vehicle goes.
"""

import asyncio
import json
import math
import socket
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from typing import Any

import pytest

pytest.importorskip("mavsdk_grpc", reason="mavsdk-grpc is not installed: pip install -e '.[dev]'")

from mavsdk_grpc import System
from mavsdk_grpc.action import ActionError
from mavsdk_grpc.geofence import FenceType, GeofenceData, Point, Polygon
from mavsdk_grpc.mission import MissionItem, MissionPlan
from mavsdk_grpc.offboard import (
    Attitude,
    OffboardError,
    PositionNedYaw,
    VelocityBodyYawspeed,
    VelocityNedYaw,
)
from mavsdk_grpc.telemetry import FlightMode, LandedState

from tests.sitl.plans import ORIGIN
from tests.sitl.process import sitl_process
from tests.sitl.test_mavsdk_missions import QGC_PLAN

SPEED = 8.0
LIMIT_S = 60.0
NAN = math.nan
PARAMETERS = {"COM_OF_LOSS_T": 10.0, "RTL_RETURN_ALT": 8.0, "MIS_TAKEOFF_ALT": 4.0}
"""A busy machine may keep the client from sending for a while, and a return need not go high."""


async def first(stream: AsyncIterator[Any], wanted: Callable[[Any], bool] = lambda _: True) -> Any:
    """The first thing of a stream that is wanted."""

    async def search() -> Any:
        async for told in stream:
            if wanted(told):
                return told
        raise AssertionError("the stream has ended")

    return await asyncio.wait_for(search(), LIMIT_S)


class Drone:
    """A connected System, and where it is."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.action, self.offboard, self.telemetry = system.action, system.offboard, system.telemetry

    async def place(self) -> tuple[float, float, float]:
        p = (await first(self.telemetry.position_velocity_ned())).position
        return p.north_m, p.east_m, p.down_m

    async def near(self, place: tuple[float, float, float], within: float = 0.5) -> None:
        await first(
            self.telemetry.position_velocity_ned(),
            lambda told: math.dist((told.position.north_m, told.position.east_m, told.position.down_m), place) < within,
        )

    async def velocity(self, wanted: tuple[float, float, float], share: float = 0.25) -> tuple[float, float, float]:
        """Wait until it flies like this; SIH's drag takes 13 %."""

        def like(told: Any) -> bool:
            v = told.velocity
            return math.dist((v.north_m_s, v.east_m_s, v.down_m_s), wanted) < share * math.hypot(*wanted) + 0.1

        v = (await first(self.telemetry.position_velocity_ned(), like)).velocity
        return v.north_m_s, v.east_m_s, v.down_m_s

    async def mode(self, mode: FlightMode) -> None:
        await first(self.telemetry.flight_mode(), lambda told: told == mode)

    async def take_control(self) -> None:
        """Start OFFBOARD; PX4 rejects it at the very instant at which setpoints begin (AUTOPILOT.md 2)."""
        await asyncio.sleep(0.5 / SPEED)
        await self.offboard.start()
        await self.mode(FlightMode.OFFBOARD)

    async def take_off(self) -> None:
        await self.action.arm()
        await self.action.takeoff()
        await first(self.telemetry.position_velocity_ned(), lambda told: told.position.down_m < -3.5)
        await self.mode(FlightMode.HOLD)

    async def land(self) -> None:
        await self.action.land()
        await first(self.telemetry.armed(), lambda armed: not armed)
        assert (await self.place())[2] == pytest.approx(0.0, abs=0.1)


@pytest.fixture(scope="module")
def loop() -> Iterator[asyncio.AbstractEventLoop]:
    loop = asyncio.new_event_loop()
    yield loop
    loop.close()


@pytest.fixture(scope="module")
def connected(loop) -> Iterator[Drone]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        grpc_port = probe.getsockname()[1]
    with sitl_process(lockstep=False, speed=SPEED, parameters=PARAMETERS) as sitl:
        system = System(port=grpc_port)

        async def connect() -> Drone:
            await system.connect(f"udpin://127.0.0.1:{sitl.companion}")
            await first(system.core.connection_state(), lambda told: told.is_connected)
            await first(system.telemetry.health_all_ok(), bool)
            return Drone(system)

        try:
            yield loop.run_until_complete(connect())
        finally:
            system._stop_mavsdk_server()


@pytest.fixture
def fly(loop, connected) -> Iterator[Callable[[Callable[[Drone], Coroutine]], None]]:
    """Runs a flight; whatever became of it, the next one begins on the ground."""
    yield lambda flight: loop.run_until_complete(asyncio.wait_for(flight(connected), 2 * LIMIT_S))

    async def down() -> None:
        if await first(connected.telemetry.armed()):
            await connected.land()
        await connected.action.hold()

    loop.run_until_complete(down())


def test_takeoff_and_land(fly):
    async def flight(drone: Drone) -> None:
        await drone.action.arm()
        assert await first(drone.telemetry.armed())
        await drone.action.takeoff()
        await first(drone.telemetry.landed_state(), lambda state: state == LandedState.IN_AIR)
        north, east, _ = await drone.place()
        await drone.near((north, east, -4.0))
        with pytest.raises(ActionError):
            await drone.action.disarm()
        await drone.action.land()
        await first(drone.telemetry.landed_state(), lambda state: state == LandedState.LANDING)
        await first(drone.telemetry.in_air(), lambda in_air: not in_air)
        await first(drone.telemetry.armed(), lambda armed: not armed)
        assert (await drone.place())[2] == pytest.approx(0.0, abs=0.1)

    fly(flight)


def test_telemetry(fly):
    async def flight(drone: Drone) -> None:
        t = drone.telemetry
        assert (await first(t.battery())).voltage_v > 10.0
        gps = await first(t.gps_info())
        assert gps.num_satellites >= 10
        position = await first(t.position())
        assert position.latitude_deg == pytest.approx(ORIGIN.latitude, abs=1e-3)
        assert position.absolute_altitude_m - position.relative_altitude_m == pytest.approx(ORIGIN.altitude, abs=1.0)
        home = await first(t.home())
        assert home.absolute_altitude_m == pytest.approx(ORIGIN.altitude, abs=1.0)
        assert not await first(t.in_air())
        assert await first(t.flight_mode()) == FlightMode.HOLD
        assert abs((await first(t.attitude_euler())).roll_deg) < 2.0
        await drone.take_off()
        assert await first(t.in_air())
        height = -(await drone.place())[2]
        relative = (await first(t.position())).relative_altitude_m
        assert relative == pytest.approx(height, abs=0.3)
        assert (await first(t.altitude())).altitude_relative_m == pytest.approx(height, abs=0.5)
        await drone.land()

    fly(flight)


def test_offboard_velocity_ned(fly):
    async def flight(drone: Drone) -> None:
        await drone.take_off()
        with pytest.raises(OffboardError):
            await drone.offboard.start()  # without a setpoint
        await drone.offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        await drone.take_control()
        for wanted in ((0.0, 0.0, -1.5), (4.0, 0.0, 0.0), (0.0, 3.0, 0.0), (-4.0, 0.0, 0.0), (0.0, -3.0, 0.0)):
            await drone.offboard.set_velocity_ned(VelocityNedYaw(*wanted, 90.0))
            await drone.velocity(wanted)
            if wanted[2]:
                await first(drone.telemetry.position_velocity_ned(), lambda told: told.position.down_m < -5.5)
        assert (await drone.place())[2] < -5.0
        yaw = (await first(drone.telemetry.attitude_euler())).yaw_deg
        assert yaw == pytest.approx(90.0, abs=4.0)
        await drone.offboard.stop()
        await drone.mode(FlightMode.HOLD)
        await drone.land()

    fly(flight)


def test_offboard_position_ned(fly):
    async def flight(drone: Drone) -> None:
        await drone.take_off()
        north, east, _ = await drone.place()
        await drone.offboard.set_position_ned(PositionNedYaw(north, east, -4.0, 0.0))
        await drone.take_control()
        for there in ((north, east, -7.0), (north + 5.0, east, -7.0), (north + 5.0, east + 6.0, -5.0)):
            await drone.offboard.set_position_ned(PositionNedYaw(*there, 90.0))
            await drone.near(there)
        await drone.offboard.stop()
        await drone.land()

    fly(flight)


def test_offboard_position_and_velocity(fly):
    async def flight(drone: Drone) -> None:
        await drone.take_off()
        north, east, _ = await drone.place()
        await drone.offboard.set_position_ned(PositionNedYaw(north, east, -4.0, 0.0))
        await drone.take_control()
        there = (north + 12.0, east, -6.0)
        await drone.offboard.set_position_velocity_ned(PositionNedYaw(*there, 0.0), VelocityNedYaw(1.0, 0.0, 0.0, 0.0))
        # Velocity is fed forward: it comes to rest where P * (p_sp - p) takes it away again, 1 / 0.95 m beyond.
        await drone.near((there[0] + 1.0 / 0.95, there[1], there[2]), 0.4)
        await drone.offboard.set_position_ned(PositionNedYaw(*there, 0.0))
        await drone.near(there)
        await drone.offboard.stop()
        await drone.land()

    fly(flight)


def test_offboard_velocity_body(fly):
    async def flight(drone: Drone) -> None:
        await drone.take_off()
        await drone.offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, 0.0, 0.0))
        await drone.take_control()
        await drone.offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.0, -1.0, 30.0))
        before = (await first(drone.telemetry.attitude_euler())).yaw_deg
        await first(drone.telemetry.attitude_euler(), lambda told: (told.yaw_deg - before) % 360.0 > 70.0)  # clockwise
        await drone.offboard.set_velocity_body(VelocityBodyYawspeed(3.0, 0.0, 0.0, 0.0))
        await asyncio.sleep(6.0 / SPEED)
        heading = math.radians((await first(drone.telemetry.attitude_euler())).yaw_deg)
        await drone.velocity((3.0 * math.cos(heading), 3.0 * math.sin(heading), 0.0))
        # A circle: forward and turning; it comes back to where it began.
        await drone.offboard.set_velocity_body(VelocityBodyYawspeed(2.0, 0.0, 0.0, 40.0))
        await asyncio.sleep(5.0 / SPEED)
        north, east, _ = await drone.place()
        await first(
            drone.telemetry.position_velocity_ned(),
            lambda told: math.hypot(told.position.north_m - north, told.position.east_m - east) > 3.0,
        )
        await first(
            drone.telemetry.position_velocity_ned(),
            lambda told: math.hypot(told.position.north_m - north, told.position.east_m - east) < 1.5,
        )
        await drone.offboard.stop()
        await drone.land()

    fly(flight)


def test_offboard_attitude(fly):
    async def flight(drone: Drone) -> None:
        await drone.take_off()
        north, east, _ = await drone.place()
        await drone.offboard.set_attitude(Attitude(0.0, 0.0, 0.0, 0.52))
        await drone.take_control()
        await drone.offboard.set_attitude(Attitude(20.0, 0.0, 0.0, 0.6))
        await first(drone.telemetry.attitude_euler(), lambda told: abs(told.roll_deg - 20.0) < 3.0)
        await first(drone.telemetry.position_velocity_ned(), lambda told: told.position.east_m > east + 4.0)
        assert (await drone.place())[2] < -2.0
        assert abs((await drone.place())[0] - north) < 2.0
        await drone.offboard.set_attitude(Attitude(-20.0, 0.0, 0.0, 0.6))
        await first(drone.telemetry.attitude_euler(), lambda told: abs(told.roll_deg + 20.0) < 3.0)
        await drone.offboard.stop()
        await drone.mode(FlightMode.HOLD)
        await drone.land()

    fly(flight)


def waypoint(north: float, east: float, up: float) -> MissionItem:
    latitude, longitude = ORIGIN.globe(north, east)
    return MissionItem(
        latitude, longitude, up, 5.0, True, NAN, NAN, MissionItem.CameraAction.NONE, NAN, NAN, NAN, NAN, NAN,
        MissionItem.VehicleAction.NONE,
    )  # fmt: skip


def test_mission(fly):
    async def flight(drone: Drone) -> None:
        mission = drone.system.mission
        places = [(12.0, 0.0, 6.0), (12.0, 12.0, 8.0), (0.0, 12.0, 6.0)]
        await mission.set_return_to_launch_after_mission(True)
        await mission.upload_mission(MissionPlan([waypoint(*place) for place in places]))
        shown = (await mission.download_mission()).mission_items
        assert [item.relative_altitude_m for item in shown] == [place[2] for place in places]
        begin = await drone.place()
        await drone.action.arm()
        await mission.start_mission()
        for north, east, up in places:
            await drone.near((north, east, -up), 3.2)
        progress = await first(mission.mission_progress(), lambda told: told.current == told.total)
        assert progress.total == len(places)
        await first(drone.telemetry.armed(), lambda armed: not armed)
        assert math.dist(await drone.place(), begin) < 1.0
        await mission.clear_mission()

    fly(flight)


def test_mission_import(fly, tmp_path):
    path = tmp_path / "flight.plan"
    path.write_text(json.dumps(QGC_PLAN))

    async def flight(drone: Drone) -> None:
        raw = drone.system.mission_raw
        imported = await raw.import_qgroundcontrol_mission(str(path))
        await raw.upload_mission(imported.mission_items)
        assert [item.command for item in await raw.download_mission()] == [22, 530, 16, 21]
        await drone.action.arm()
        await raw.start_mission()
        await drone.near((12.0, -6.0, -8.0), 3.2)
        await first(drone.telemetry.armed(), lambda armed: not armed)
        assert await drone.place() == pytest.approx((12.0, 4.0, 0.0), abs=0.6)
        await raw.clear_mission()

    fly(flight)


def test_geofence(fly):
    async def flight(drone: Drone) -> None:
        north, east, _ = await drone.place()
        corners = [(-12.0, -12.0), (-12.0, 12.0), (12.0, 12.0), (12.0, -12.0)]
        square = Polygon([Point(*ORIGIN.globe(north + n, east + e)) for n, e in corners], FenceType.INCLUSION)
        await drone.system.geofence.upload_geofence(GeofenceData([square], []))
        await drone.take_off()
        await drone.offboard.set_velocity_ned(VelocityNedYaw(3.0, 0.0, 0.0, 0.0))
        await drone.take_control()
        await first(drone.telemetry.position_velocity_ned(), lambda told: told.position.north_m > north + 10.0)
        await drone.mode(FlightMode.HOLD)  # GF_ACTION 2
        await first(drone.telemetry.position_velocity_ned(), lambda told: abs(told.velocity.north_m_s) < 0.2)
        assert north + 12.0 < (await drone.place())[0] < north + 22.0
        await drone.system.geofence.clear_geofence()
        await drone.land()

    fly(flight)


def test_goto(fly):
    async def flight(drone: Drone) -> None:
        await drone.take_off()
        north, east, _ = await drone.place()
        there = (north + 8.0, east - 6.0)
        await drone.action.goto_location(*ORIGIN.globe(*there), ORIGIN.altitude + 9.0, 90.0)
        await drone.near((*there, -9.0))
        await first(drone.telemetry.attitude_euler(), lambda told: abs(told.yaw_deg - 90.0) < 4.0)
        assert await first(drone.telemetry.flight_mode()) == FlightMode.HOLD
        await drone.action.return_to_launch()
        await first(drone.telemetry.armed(), lambda armed: not armed)
        assert math.hypot((await drone.place())[0] - north, (await drone.place())[1] - east) < 1.0

    fly(flight)


def test_all_params(fly):
    async def flight(drone: Drone) -> None:
        param = drone.system.param
        everything = await param.get_all_params()
        reals = {p.name: p.value for p in everything.float_params}
        wholes = {p.name: p.value for p in everything.int_params}
        assert reals["MIS_TAKEOFF_ALT"] == pytest.approx(4.0)
        assert wholes["MAV_SYS_ID"] == 1
        assert len(reals) + len(wholes) > 100
        await param.set_param_float("MIS_TAKEOFF_ALT", 6.0)
        assert await drone.action.get_takeoff_altitude() == pytest.approx(6.0)
        await drone.take_off()
        await first(drone.telemetry.position_velocity_ned(), lambda told: told.position.down_m < -5.7)
        await param.set_param_float("MIS_TAKEOFF_ALT", 4.0)
        await drone.land()

    fly(flight)
