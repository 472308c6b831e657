"""MAVSDK 4.1, which nobody here wrote: a mission and a goto on the ArduCopter personality, over TCP."""

import math

import pytest
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.geofence import Circle, FenceType, Geofence, GeofenceData, Point
from mavsdk.plugins.mission_raw import MissionItem, MissionRaw, MissionRawError
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import FlightMode, Telemetry

from tests.sitl.plans import NAN, ORIGIN, TAKEOFF, WAYPOINT, item, order
from tests.sitl.test_mavsdk_arducopter import connected, wait_for

LAND = 21
PLAN = [
    item(WAYPOINT, 0.0, 0.0, ORIGIN.altitude, frame=0),
    item(TAKEOFF, up=6.0),
    order(178, 1, 6.0),
    item(WAYPOINT, 20.0, 0.0, 10.0),
    item(WAYPOINT, 20.0, 12.0, 8.0),
    item(LAND, 10.0, 12.0, 0.0),
]


def raw(plan):
    return [
        MissionItem(seq, frame, command, int(seq == 0), 1, *p, x, y, z, 0)
        for seq, (frame, command, p, x, y, z) in enumerate(plan)
    ]


def test_mavsdk_flies_a_mission_and_goes_somewhere_on_arducopter():
    """AUTOPILOT.md 1: mission, fence, goto; ArduCopter's AUTO 3 and item 0 as home. The fence NAKs a destination."""
    with connected() as system:
        action, telemetry, mission, param = Action(system), Telemetry(system), MissionRaw(system), Param(system)
        for set_rate in (telemetry.set_rate_position_velocity_ned, telemetry.set_rate_health, telemetry.set_rate_home,
                         telemetry.set_rate_landed_state):  # fmt: skip
            set_rate(20.0)

        def place():
            position = telemetry.position_velocity_ned().position
            return position.north_m, position.east_m, position.down_m

        wait_for(telemetry.health_all_ok)
        with pytest.raises(MissionRawError):
            mission.upload_mission(raw([*PLAN[:2], item(34)]))
        mission.upload_mission(raw(PLAN))
        assert [i.command for i in mission.download_mission()] == [i[1] for i in PLAN]
        Geofence(system).upload_geofence(
            GeofenceData([], [Circle(Point(*ORIGIN.globe(0.0, 0.0)), 40.0, FenceType.INCLUSION)])
        )
        param.set_param_int("FENCE_ENABLE", 1)

        action.set_takeoff_altitude(8.0)
        action.arm()
        action.takeoff()
        wait_for(lambda: place()[2] < -7.5)
        with pytest.raises(ActionError, match="DENIED"):
            action.goto_location(*ORIGIN.globe(60.0, 0.0), ORIGIN.altitude + 8.0, NAN)
        action.goto_location(*ORIGIN.globe(-6.0, 3.0), ORIGIN.altitude + 9.0, NAN)
        wait_for(lambda: math.dist(place(), (-6.0, 3.0, -9.0)) < 0.6)

        mission.start_mission()
        wait_for(lambda: telemetry.flight_mode() == FlightMode.MISSION)
        wait_for(lambda: math.dist(place(), (20.0, 0.0, -10.0)) < 3.5)
        wait_for(lambda: not telemetry.armed())
        assert place() == pytest.approx((10.0, 12.0, 0.0), abs=0.6)
        assert mission.mission_progress().current >= len(PLAN) - 1
