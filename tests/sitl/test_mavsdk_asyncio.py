"""MAVSDK 4.1's asyncio front flies the SITL: subscriptions as asynchronous iterators, calls awaited."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import aclosing
from typing import TypeVar

from mavsdk.asyncio.mavsdk import Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync, VelocityNedYaw
from mavsdk.asyncio.plugins.telemetry import FlightMode, TelemetryAsync
from mavsdk.component_type import ComponentType

from tests.sitl.process import SitlProcess, sitl_process

SPEED = 4.0
T = TypeVar("T")


async def until(updates: AsyncGenerator[T, None], condition: Callable[[T], bool]) -> T:
    async with asyncio.timeout(60.0), aclosing(updates):
        async for update in updates:
            if condition(update):
                return update
    raise AssertionError("the subscription ended")


async def fly(sitl: SitlProcess) -> None:
    async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as client:
        await client.add_any_connection(f"udpin://127.0.0.1:{sitl.companion}")
        system = await client.first_autopilot(10.0)
        action, offboard, telemetry = ActionAsync(system), OffboardAsync(system), TelemetryAsync(system)
        await until(telemetry.subscribe_health(), lambda health: health.is_armable)

        await action.arm()
        await action.takeoff()
        await until(telemetry.subscribe_position_velocity_ned(), lambda now: now.position.down_m < -2.2)
        await until(telemetry.subscribe_flight_mode(), lambda mode: mode == FlightMode.HOLD)

        await offboard.set_velocity_ned(VelocityNedYaw(0.0, 0.0, 0.0, 0.0))
        await asyncio.sleep(0.2)
        await offboard.start()
        await offboard.set_velocity_ned(VelocityNedYaw(0.0, -3.0, 0.0, 0.0))
        there = await until(telemetry.subscribe_position_velocity_ned(), lambda now: now.position.east_m < -6.0)
        assert abs(there.position.north_m) < 0.5
        assert -3.3 < there.velocity.east_m_s < -2.3

        await action.land()
        await until(telemetry.subscribe_armed(), lambda armed: not armed)
        landed = await telemetry.position_velocity_ned()
        assert abs(landed.position.down_m) < 0.1


def test_mavsdk_asyncio_takes_off_flies_offboard_and_lands():
    with sitl_process(lockstep=False, speed=SPEED) as sitl:
        asyncio.run(fly(sitl))
