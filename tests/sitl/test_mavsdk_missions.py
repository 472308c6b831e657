"""MAVSDK 4.1, which nobody here wrote: missions, fences, goto and sticks on PX4; asserting on where the vehicle is."""

import json
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from mavsdk import mavsdk
from mavsdk.component_type import ComponentType
from mavsdk.plugins.action import Action
from mavsdk.plugins.geofence import Circle, FenceType, Geofence, GeofenceData, Point, Polygon
from mavsdk.plugins.manual_control import ManualControl
from mavsdk.plugins.mission import Mission, MissionError, MissionItem, MissionPlan
from mavsdk.plugins.mission_raw import MissionItem as RawItem
from mavsdk.plugins.mission_raw import MissionRaw, MissionRawError
from mavsdk.plugins.telemetry import FlightMode, Telemetry

from tests.sitl.plans import ORIGIN
from tests.sitl.process import sitl_process

CameraAction, VehicleAction = MissionItem.CameraAction, MissionItem.VehicleAction
NAN = math.nan


def wait_for(condition: Callable[[], bool], limit_s: float = 60.0) -> None:
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


class Craft:
    """A healthy vehicle and the plugins."""

    def __init__(self, system: mavsdk.System) -> None:
        self.system = system
        self.action, self.telemetry = Action(system), Telemetry(system)
        wait_for(self.telemetry.health_all_ok)

    @property
    def place(self) -> tuple[float, float, float]:
        position = self.telemetry.position_velocity_ned().position
        return position.north_m, position.east_m, position.down_m

    @property
    def speed(self) -> float:
        velocity = self.telemetry.position_velocity_ned().velocity
        return math.hypot(velocity.north_m_s, velocity.east_m_s, velocity.down_m_s)

    def take_off(self, height: float) -> None:
        self.action.set_takeoff_altitude(height)
        self.action.arm()
        self.action.takeoff()
        wait_for(lambda: self.telemetry.flight_mode() == FlightMode.HOLD and self.telemetry.in_air())
        wait_for(lambda: abs(self.place[2] + height) < 0.3)


@contextmanager
def craft(speed: float, **parameters: float) -> Iterator[Craft]:
    with sitl_process(lockstep=False, speed=speed, parameters=parameters) as sitl:
        client = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        try:
            client.add_any_connection(f"udpin://127.0.0.1:{sitl.companion}")
            system = client.first_autopilot(10.0)
            assert system is not None
            yield Craft(system)
        finally:
            client.destroy()


def waypoint(north: float, east: float, up: float, speed: float = NAN, through: bool = True, **more: object):
    latitude, longitude = ORIGIN.globe(north, east)
    return MissionItem(
        latitude, longitude, up, speed, through, NAN, NAN, CameraAction.NONE, NAN, 1.0, NAN, NAN, NAN,
        VehicleAction.NONE, **more,
    )  # fmt: skip


def test_mission_is_uploaded_flown_paused_and_comes_home():
    """AUTOPILOT.md 1: mission; the flow of MAVSDK-Python's mission example, with a pause and a return at the end."""
    places = [(30.0, 0.0, 15.0), (30.0, 25.0, 15.0), (0.0, 25.0, 12.0)]
    with craft(speed=8.0) as c:
        mission = Mission(c.system)
        mission.set_return_to_launch_after_mission(True)
        with pytest.raises(MissionError):
            mission.start_mission()  # there is none
        mission.upload_mission(MissionPlan([waypoint(*place, speed=6.0) for place in places]))
        back = mission.download_mission().mission_items
        assert [(i.latitude_deg, i.longitude_deg) for i in back] == [
            pytest.approx(ORIGIN.globe(*place[:2]), abs=2e-7) for place in places
        ]
        assert [i.relative_altitude_m for i in back] == [place[2] for place in places]
        assert [i.speed_m_s for i in back] == [6.0] * 3

        c.action.arm()
        mission.start_mission()
        nearest = [math.inf] * 3
        fastest = 0.0

        def watch() -> None:
            nonlocal fastest
            for i, (north, east, up) in enumerate(places):
                nearest[i] = min(nearest[i], math.dist(c.place, (north, east, -up)))
            fastest = max(fastest, c.speed)

        def watched(condition: Callable[[], bool]) -> Callable[[], bool]:
            def both() -> bool:
                watch()
                return condition()

            return both

        wait_for(watched(lambda: mission.mission_progress().current >= 1))
        wait_for(watched(lambda: c.place[1] > 8.0))
        mission.pause_mission()
        wait_for(lambda: c.telemetry.flight_mode() == FlightMode.HOLD)
        wait_for(lambda: c.speed < 0.1)
        held = c.place
        time.sleep(0.3)
        assert math.dist(c.place, held) < 0.5
        mission.start_mission()
        wait_for(watched(mission.is_mission_finished))
        wait_for(lambda: c.telemetry.flight_mode() == FlightMode.RETURN_TO_LAUNCH)
        wait_for(lambda: not c.telemetry.armed())
        # NAV_ACC_RAD 2 m and NAV_MC_ALT_RAD 0.8 m, seen every 0.2 s of vehicle time at 5 m/s
        assert all(distance < 3.2 for distance in nearest), nearest
        assert fastest > 5.0  # DO_CHANGE_SPEED 6, less SIH's drag; MPC_XY_CRUISE alone gives 4.6
        assert c.place == pytest.approx((0.0, 0.0, 0.0), abs=0.6)
        mission.clear_mission()
        assert mission.download_mission().mission_items == []


QGC_PLAN = {
    "fileType": "Plan",
    "groundStation": "QGroundControl",
    "version": 1,
    "geoFence": {"circles": [], "polygons": [], "version": 2},
    "rallyPoints": {"points": [], "version": 2},
    "mission": {
        "cruiseSpeed": 15, "hoverSpeed": 5, "firmwareType": 12, "vehicleType": 2, "version": 2,
        "plannedHomePosition": [ORIGIN.latitude, ORIGIN.longitude, ORIGIN.altitude],
        "items": [
            {"type": "SimpleItem", "command": 22, "frame": 3, "autoContinue": True, "doJumpId": 1,
             "params": [0, 0, 0, None, *ORIGIN.globe(0.0, 0.0), 6]},
            {"type": "SimpleItem", "command": 530, "frame": 2, "autoContinue": True, "doJumpId": 2,
             "params": [0, 0, 0, None, None, None, None]},
            {"type": "SimpleItem", "command": 16, "frame": 3, "autoContinue": True, "doJumpId": 3,
             "params": [0, 0, 0, None, *ORIGIN.globe(12.0, -6.0), 8]},
            {"type": "SimpleItem", "command": 21, "frame": 3, "autoContinue": True, "doJumpId": 4,
             "params": [0, 0, 0, None, *ORIGIN.globe(12.0, 4.0), 0]},
        ],
    },
}  # fmt: skip


def test_a_plan_of_qgroundcontrol_is_imported_and_flown():
    """Issue 4, item 9: the published mission import flow; its camera item is passed over, there is no camera."""
    with craft(speed=8.0) as c:
        raw = MissionRaw(c.system)
        items = raw.import_qgroundcontrol_mission_from_string(json.dumps(QGC_PLAN)).mission_items
        assert [i.command for i in items] == [22, 530, 16, 21]
        raw.upload_mission(items)
        assert [i.command for i in raw.download_mission()] == [22, 530, 16, 21]
        with pytest.raises(MissionRawError):  # unsupported item: ACK 3
            raw.upload_mission([RawItem(0, 6, 34, 1, 1, 0.0, 0.0, 0.0, 0.0, 0, 0, 1.0, 0)])
        with pytest.raises(MissionRawError):  # rally points are not kept
            raw.upload_rally_points([RawItem(0, 3, 5100, 0, 1, 0.0, 0.0, 0.0, 0.0, 473977430, 85455940, 1.0, 2)])
        c.action.arm()
        raw.start_mission()
        wait_for(c.telemetry.in_air)
        wait_for(lambda: math.dist(c.place, (12.0, -6.0, -8.0)) < 2.3)
        wait_for(lambda: not c.telemetry.armed())
        assert c.place == pytest.approx((12.0, 4.0, 0.0), abs=0.6)
        assert raw.mission_progress().current == 4


def test_geofence_holds_the_vehicle_and_goto_is_flown():
    """AUTOPILOT.md 1: fence; goto. 2: GF_ACTION 2 = hold on breach. The flows of the published examples."""
    corners = [Point(*ORIGIN.globe(n, e)) for n, e in ((-25.0, -25.0), (-25.0, 25.0), (25.0, 25.0), (25.0, -25.0))]
    with craft(speed=4.0) as c:
        geofence = Geofence(c.system)
        polygon = Polygon(corners, FenceType.INCLUSION)
        circle = Circle(Point(*ORIGIN.globe(0.0, 12.0)), 4.0, FenceType.EXCLUSION)
        geofence.upload_geofence(GeofenceData([polygon], [circle]))
        c.take_off(10.0)
        c.action.goto_location(*ORIGIN.globe(10.0, -5.0), ORIGIN.altitude + 14.0, 90.0)
        wait_for(lambda: math.dist(c.place, (10.0, -5.0, -14.0)) < 0.5)
        wait_for(lambda: abs(c.telemetry.attitude_euler().yaw_deg - 90.0) < 3.0)
        c.action.goto_location(*ORIGIN.globe(40.0, 0.0), ORIGIN.altitude + 14.0, NAN)
        time.sleep(1.0)
        assert math.dist(c.place, (10.0, -5.0, -14.0)) < 1.0  # outside: not flown to
        geofence.clear_geofence()
        c.action.goto_location(*ORIGIN.globe(40.0, 0.0), ORIGIN.altitude + 14.0, NAN)
        wait_for(lambda: c.place[0] > 39.0)


def test_manual_control_flies_in_position_mode():
    """Issue 4, item 2: MANUAL_CONTROL sticks: MAVSDK's manual_control plugin."""
    with craft(speed=2.0) as c:
        sticks = ManualControl(c.system)
        axes = [0.0, 0.0, 0.5, 0.0]
        flying = threading.Event()
        flying.set()

        def send() -> None:
            while flying.is_set():
                sticks.set_manual_control_input(*axes)
                time.sleep(0.02)

        sender = threading.Thread(target=send)
        sender.start()
        try:
            c.take_off(5.0)
            sticks.start_position_control()
            wait_for(lambda: c.telemetry.flight_mode() == FlightMode.POSCTL)
            axes[0] = 0.6
            wait_for(lambda: c.place[0] > 5.0)
            axes[0] = 0.0
            wait_for(lambda: c.speed < 0.1)
            held = c.place
            time.sleep(1.5)
            assert math.dist(c.place, held) < 0.6
        finally:
            flying.clear()
            sender.join()
