"""What every vehicle does for the bridge, whatever library and autopilot are behind it; asserting on where it flies.

Four pairs against `sitl/`, a process each, at six times the wall clock's pace. With `--autopilot URL` the same tests
fly the autopilot that answers there, with both back ends one after the other: a real PX4 or ArduCopter in its own
simulation (never a vehicle that people stand beside: it takes off).
"""

import contextlib
import time

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.clock import Paced
from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.link import Link
from autopilot_bridge.mavsdk_vehicle import MavsdkVehicle
from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle
from autopilot_bridge.vehicle import Mode, RefusedError, SilentError, VehicleError
from tests.sitl.process import sitl_process, step

SPEED = 6.0
SIMULATED = {"px4": {"COM_OF_LOSS_T": 3, "RTL_RETURN_ALT": 8}, "arducopter": {"RTL_ALT": 800, "LAND_SPEED": 100}}
"""So that a busy machine's stalls, six times as long, do not pass for a stream that stopped, and returns are short."""
BOOT_MS = {"px4": 5000, "arducopter": 45000}
"""After which it can be armed; skipped in simulation."""
BACKENDS = {"pymavlink": PymavlinkVehicle, "mavsdk": MavsdkVehicle}
PERSONALITIES = ("px4", "arducopter")
NAMES = {
    "px4": {"speed": "MPC_XY_VEL_MAX", "whole": "COM_OBL_RC_ACT", "range": (3, 4)},
    "arducopter": {"speed": "WPNAV_SPEED", "whole": "FS_GCS_ENABLE", "range": (1, 5)},
}
"""A parameter of each kind, and two values of the whole one."""
HEIGHT_M = 6.0


class Pilot:
    """A vehicle, and the time it flies in."""

    def __init__(self, url, backend, speed, sitl=None):
        self.sitl = sitl
        """None when it is a real one."""
        self.link = Link(url, system_id=1, tamper_out=self.note)
        self.setpoints = 0
        """Sent so far."""
        self.clock = Paced(speed, 50)
        self.stream = None
        """Velocity (ENU) and yaw to send at every step."""
        self.stream_from = 0.0
        """Vehicle time before which nothing is sent."""
        self.steps = 0
        self.vehicle = BACKENDS[backend](self.link, dialects("auto"), 1, self.clock, self.step)

    def note(self, frame):
        self.setpoints += frame[7:10] == bytes([mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, 0, 0])
        return (frame,)

    def step(self):
        if self.steps % 20 == 0:
            self.vehicle.beat()
        if self.stream is not None and self.clock.now >= self.stream_from:
            self.vehicle.send_velocity(np.array(self.stream[0]), self.stream[1])
        self.clock.step(self.vehicle)
        self.steps += 1

    def run(self, seconds):
        until = self.clock.now + seconds
        while self.clock.now < until:
            self.step()

    def until(self, condition, within_s):
        until = self.clock.now + within_s
        while not condition() and self.clock.now < until:
            self.step()
        return condition()

    @property
    def telemetry(self):
        return self.vehicle.telemetry

    @property
    def position(self):
        return self.telemetry.position_enu

    @property
    def velocity(self):
        return self.telemetry.velocity_enu

    def aloft(self):
        """In the air, in the mode that flies setpoints, streaming a hold."""
        if not self.telemetry.armed:
            self.vehicle.await_armable()
            self.vehicle.arm()
            self.vehicle.takeoff(HEIGHT_M)
        self.stream = ((0.0, 0.0, 0.0), 0.0)
        self.run(0.5)
        self.vehicle.hear_mode()
        self.vehicle.set_mode(Mode.OFFBOARD)
        self.run(2.0)


def pytest_generate_tests(metafunc):
    if "pair" in metafunc.fixturenames:
        real = metafunc.config.getoption("--autopilot")
        pairs = [(backend, real or name) for name in ((real,) if real else PERSONALITIES) for backend in BACKENDS]
        metafunc.parametrize("pair", pairs, ids=["-".join(pair) for pair in pairs], scope="module", indirect=True)


@pytest.fixture(scope="module")
def pair(request):
    """A connected pilot of one pair."""
    backend, autopilot = request.param
    with contextlib.ExitStack() as stack:
        url, speed, sitl = autopilot, 1.0, None
        if autopilot in PERSONALITIES:
            options = {"lockstep": False, "speed": SPEED, "parameters": SIMULATED[autopilot]}
            sitl = stack.enter_context(sitl_process("--personality", autopilot, "--tcp-port", "0", **options))
            step(sitl, BOOT_MS[autopilot])
            url, speed = f"udpin://127.0.0.1:{sitl.companion}", SPEED
        pilot = Pilot(url, backend, speed, sitl)
        stack.callback(pilot.vehicle.close)
        pilot.vehicle.connect()
        whole = NAMES[pilot.vehicle.dialect.name]["whole"]
        before = pilot.vehicle.parameter(whole)
        yield pilot
        pilot.vehicle.set_parameter(whole, before)


def test_connected_it_knows_the_autopilot_and_tells_of_itself(pair):
    assert pair.vehicle.dialect.name in PERSONALITIES
    assert pair.until(lambda: pair.telemetry.battery_remaining is not None, 10)
    assert not pair.telemetry.armed
    assert np.linalg.norm(pair.velocity) < 0.5
    heard, told = pair.vehicle.heard, pair.telemetry.time_s
    pair.run(1.0)
    assert pair.vehicle.heard - heard > 40
    assert pair.telemetry.time_s - told == pytest.approx(1.0, abs=0.3)


def test_what_is_not_to_be_armed_is_refused_with_the_reason(pair):
    pair.vehicle.set_mode(Mode.LAND)
    with pytest.raises(RefusedError, match=r"arm: \w+ by the autopilot: .+"):
        pair.vehicle.arm()
    assert not pair.telemetry.armed


def test_parameters_of_both_kinds_are_read_and_written(pair):
    names = NAMES[pair.vehicle.dialect.name]
    before = pair.vehicle.parameter(names["speed"])
    pair.vehicle.set_parameter(names["speed"], 0.75 * before)
    assert pair.vehicle.parameter(names["speed"]) == pytest.approx(0.75 * before)
    pair.vehicle.set_parameter(names["speed"], before)
    for value in names["range"]:
        pair.vehicle.set_parameter(names["whole"], value)
        assert pair.vehicle.parameter(names["whole"]) == value
    with pytest.raises(VehicleError, match=r"3\.5 is not a whole number"):
        pair.vehicle.set_parameter(names["whole"], 3.5)


def test_an_unknown_parameter_is_told(pair):
    with pytest.raises(VehicleError, match="NO_SUCH: unknown"):
        pair.vehicle.parameter("NO_SUCH")


def test_the_uploaded_fence_is_read(pair, upload):
    if pair.sitl is None:  # what is there is the owner's
        assert isinstance(pair.vehicle.uploaded_fence(), list)
        return
    assert pair.vehicle.uploaded_fence() == []
    corners = [(47.398, 8.544), (47.398, 8.547), (47.396, 8.547)]
    items = [(mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, 3.0, *corner) for corner in corners]
    items.append((mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION, 12.5, 47.3985, 8.5465))
    upload(pair.sitl.gcs, f"127.0.0.1:{pair.sitl.gcs_bind}", items)
    found = pair.vehicle.uploaded_fence()
    assert [(item.command, item.value) for item in found] == [item[:2] for item in items]
    assert [(item.latitude, item.longitude) for item in found] == [pytest.approx(item[2:], abs=1e-7) for item in items]


def test_takes_off_and_hovers_about_home(pair):
    pair.vehicle.await_armable()
    pair.vehicle.arm()
    assert pair.telemetry.armed
    pair.vehicle.takeoff(HEIGHT_M)
    assert pair.telemetry.mode is pair.vehicle.dialect.ready
    pair.run(3.0)
    assert pair.position == pytest.approx([0, 0, HEIGHT_M], abs=1.0)
    assert np.linalg.norm(pair.velocity) < 0.3
    assert not pair.telemetry.landed
    with pytest.raises(RefusedError, match="disarm"):
        pair.vehicle.disarm()
    assert pair.telemetry.armed


def test_flies_the_velocity_asked_for_in_enu_and_faces_the_yaw(pair):
    pair.aloft()
    start = pair.position
    pair.stream = ((3.0, 0.0, 0.5), 0.0)
    pair.run(6.0)
    moved = pair.position - start
    assert moved[0] > 10.0
    assert abs(moved[1]) < 0.7
    assert moved[2] > 1.5
    assert pair.velocity == pytest.approx([3.0, 0.0, 0.5], abs=0.5)
    assert pair.telemetry.attitude_rad[2] == pytest.approx(0.0, abs=0.15)
    pair.stream = ((0.0, 0.0, 0.0), 0.0)
    assert pair.until(lambda: np.linalg.norm(pair.velocity) < 0.3, 8)


def test_a_stream_that_stops_stops_at_once_and_the_autopilot_acts(pair):
    """MAVSDK goes on repeating the last velocity; nothing of that may reach the vehicle."""
    pair.aloft()
    pair.stream = ((2.0, 0.0, 0.0), 0.0)
    pair.run(4.0)
    sent = pair.setpoints
    assert sent > 0
    pair.stream = None
    pair.run(2.5)  # on the wall clock long enough for eight repeats
    assert pair.setpoints == sent
    px4 = pair.vehicle.dialect.name == "px4"
    if px4:  # COM_OBL_RC_ACT is 4 since the test of parameters
        assert pair.until(lambda: pair.telemetry.mode is Mode.LAND, 6)
    else:  # GUID_TIMEOUT
        assert pair.until(lambda: np.linalg.norm(pair.velocity) < 0.3, 8)
        assert pair.telemetry.mode is Mode.OFFBOARD


def test_a_stream_that_has_only_just_begun_is_not_refused_for_good(pair):
    """What a stall of ours looks like to PX4. ArduCopter wants no stream."""
    pair.aloft()
    pair.stream = None
    pair.vehicle.set_mode(Mode.HOLD)
    pair.run(4.0)
    pair.stream, pair.stream_from = ((0.0, 0.0, 0.0), 0.0), pair.clock.now + 1.0
    pair.vehicle.set_mode(Mode.OFFBOARD)
    assert pair.telemetry.mode is Mode.OFFBOARD
    pair.run(1.0)
    assert pair.telemetry.mode is Mode.OFFBOARD


def test_holds_where_it_is(pair):
    pair.aloft()
    pair.stream = None
    pair.vehicle.set_mode(Mode.HOLD)
    assert pair.telemetry.mode is Mode.HOLD
    pair.run(3.0)
    place = pair.position
    pair.run(3.0)
    assert np.linalg.norm(pair.position - place) < 0.5


def test_silence_is_seen_and_a_link_that_comes_back_is_heard_again(pair):
    pair.aloft()
    pair.link._tamper_in = lambda datagram: ()
    pair.stream = None
    heard, now = pair.vehicle.heard, pair.clock.now
    wall = time.monotonic()
    while time.monotonic() - wall < 0.5:
        pair.step()
    assert pair.vehicle.heard == heard
    assert pair.clock.now - now < 0.5  # vehicle time stands still, whatever the wall clock says
    pair.link._tamper_in = lambda datagram: (datagram,)
    with contextlib.suppress(SilentError):
        pair.run(1.0)
    assert pair.vehicle.heard > heard


def test_returns_lands_and_disarms_at_home(pair):
    pair.aloft()
    pair.stream = None
    pair.vehicle.set_mode(Mode.RETURN)
    assert pair.telemetry.mode is Mode.RETURN
    pair.run(2.0)
    assert pair.until(lambda: np.linalg.norm(pair.position[:2]) < 0.6 and np.linalg.norm(pair.velocity[:2]) < 0.2, 60)
    pair.vehicle.set_mode(Mode.LAND)
    assert pair.telemetry.mode is Mode.LAND
    assert pair.until(lambda: not pair.telemetry.armed, 90)
    assert pair.telemetry.landed
    assert np.linalg.norm(pair.position) < 1.0
