"""What may be at the other end of a link and must not be flown: real sockets, told in one line, and nothing arms."""

import contextlib
import math
import socket
import threading
import time

import pytest
from pymavlink.dialects.v20 import common as mavlink

PX4, COPTER, INVALID = (
    mavlink.MAV_AUTOPILOT_PX4,
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    mavlink.MAV_AUTOPILOT_INVALID,
)
QUADROTOR, PLANE, GROUND = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_TYPE_GCS


class Talker:
    """Beats, and tells its position if it has one; takes down what it is asked for. On a socket of its own."""

    def __init__(
        self,
        port,
        system=1,
        component=1,
        kind=QUADROTOR,
        autopilot=PX4,
        position=False,
        home=None,
        parameters=None,
        stubborn=False,
    ):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self._target = ("127.0.0.1", port)
        self._codec = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._kind, self._autopilot, self._position, self._home = kind, autopilot, position, home
        self.commands = []
        self._parameters, self._stubborn = dict(parameters or {}), stubborn
        self._over = False
        self._thread = threading.Thread(target=self._talk)
        self._thread.start()

    def _send(self, message):
        self._socket.sendto(message.pack(self._codec), self._target)

    def _talk(self):
        began = time.monotonic()
        told = -math.inf
        while not self._over:
            now = time.monotonic() - began
            if now - told >= 0.1:
                told = now
                self._send(mavlink.MAVLink_heartbeat_message(self._kind, self._autopilot, 1, 4 << 16 | 3 << 24, 3, 3))
                if self._position:
                    self._send(mavlink.MAVLink_local_position_ned_message(int(now * 1000), 0, 0, 0, 0, 0, 0))
                if self._home is not None:
                    place = [round(c * 1e7) for c in self._home]
                    self._send(mavlink.MAVLink_home_position_message(*place, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0))
            with contextlib.suppress(OSError):
                self._answer(self._socket.recv(4096))

    def _answer(self, data):
        for message in self._codec.parse_buffer(data) or ():
            match message.get_type():
                case "COMMAND_LONG":
                    self.commands.append(message.command)
                    self._send(mavlink.MAVLink_command_ack_message(message.command, mavlink.MAV_RESULT_ACCEPTED))
                    if message.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
                        self._send(mavlink.MAVLink_autopilot_version_message(0, 0, 0, 0, 0, *[[0] * 8] * 3, 0, 0, 1))
                case "PARAM_REQUEST_READ":
                    self._tell(message.param_id)
                case "PARAM_SET":
                    if not self._stubborn:
                        self._parameters[message.param_id] = message.param_value
                    self._tell(message.param_id)

    def _tell(self, name):
        value = self._parameters.get(name, 1000.0)
        self._send(mavlink.MAVLink_param_value_message(name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32, 1, 0))

    def close(self):
        self._over = True
        self._thread.join()
        self._socket.close()


@pytest.fixture
def talk():
    with contextlib.ExitStack() as stack:

        def start(*args, **kwargs):
            talker = Talker(*args, **kwargs)
            stack.callback(talker.close)
            return talker

        yield start


@pytest.fixture
def port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Place:
    """Where a config's autopilot is, without a SITL."""

    control = None

    def __init__(self, port):
        self.port = port


@pytest.fixture
def impatient(monkeypatch):
    """Of a link on which nobody ever answers, and of a vehicle that never knows where it is."""
    monkeypatch.setattr("autopilot_bridge.mavlink_vehicle.CONNECT_WALL_S", 1.5)
    monkeypatch.setattr("autopilot_bridge.mavlink_vehicle.ARMABLE_S", 1.5)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("talkers", "told"),
    [
        ([{"system": 7}], "no HEARTBEAT of system 1 within 1.5 s); heard: system 7 (px4 quadrotor)"),
        (
            [{"system": 255, "component": 190, "kind": GROUND, "autopilot": INVALID}],
            "never answered (no HEARTBEAT of system 1 within 1.5 s); heard: system 255, component 190 (gcs)",
        ),
        ([{"kind": mavlink.MAV_TYPE_ANTENNA_TRACKER, "autopilot": COPTER}], "heard: system 1 (antenna tracker)"),
        ([{"kind": GROUND, "autopilot": INVALID}], "heard: system 1 (gcs)"),
        ([{"kind": GROUND}], "heard: system 1 (gcs)"),
        ([{"autopilot": INVALID}], "heard: system 1 (quadrotor)"),
        ([{"autopilot": 77}], "is MAV_AUTOPILOT 77; we fly px4 or arducopter"),
        ([{"autopilot": mavlink.MAV_AUTOPILOT_AEROB}], "is MAV_AUTOPILOT_AEROB; we fly px4 or arducopter"),
        ([{"kind": PLANE}], "system 1 (px4 fixed wing) is not a multicopter"),
        ([{"kind": 99}], "system 1 (px4 MAV_TYPE 99) is not a multicopter"),
        ([{}], "gives no LOCAL_POSITION_NED: it has no position"),
    ],
)
def test_what_is_no_vehicle_of_ours_is_told(fly, bridge_config, talk, port, talkers, told):
    there = [talk(port, **talker) for talker in talkers]
    flight = fly(bridge_config(Place(port)))
    assert flight.wait() == 1
    (error,) = flight.told("error")
    assert told in error
    assert error.startswith(f"autopilot at udpin://127.0.0.1:{port}")
    assert not any(mavlink.MAV_CMD_COMPONENT_ARM_DISARM in talker.commands for talker in there)


def test_the_other_dialect_is_told(fly, bridge_config, talk, port):
    talk(port, autopilot=COPTER)
    flight = fly(bridge_config(Place(port), dialect="px4"))
    assert flight.wait() == 1
    assert "is MAV_AUTOPILOT_ARDUPILOTMEGA; we fly px4 (dialect)" in flight.told("error")[0]


@pytest.mark.parametrize("home", [None, (0.0, 0.0)])
def test_without_a_gps_origin_there_is_no_flight(fly, bridge_config, talk, port, home, monkeypatch):
    monkeypatch.setattr("autopilot_bridge.mavlink_vehicle.ARMABLE_S", 2.0)
    talker = talk(port, position=True, home=home)
    flight = fly(bridge_config(Place(port), allow_without=["offboard_loss", "battery_failsafe"], put_back=False))
    assert flight.wait() == 1
    assert "no GPS origin" in flight.told("error")[0]
    assert mavlink.MAV_CMD_COMPONENT_ARM_DISARM not in talker.commands


READY = {"position": True, "home": (47.0, 8.0)}


@pytest.mark.parametrize(
    ("talker", "changes", "told"),
    [
        ({"stubborn": True}, {"parameters": {"MPC_XY_VEL_MAX": 6}}, "MPC_XY_VEL_MAX: the autopilot did not take 6"),
        ({"parameters": {"MPC_XY_VEL_MAX": 0}}, {}, "MPC_XY_VEL_MAX is 0: must be more than 0 to fly within it"),
        (
            {"parameters": {"MPC_Z_VEL_MAX_DN": math.nan}},
            {},
            "parameter MPC_Z_VEL_MAX_DN: the autopilot says that it is",
        ),
        ({"autopilot": COPTER, "parameters": {"FENCE_TYPE": math.nan}}, {}, "parameter FENCE_TYPE: the autopilot says"),
        ({"parameters": {"MPC_TILTMAX_AIR": 0}}, {}, "tilt limit is 0 deg: must be more than 0"),
        ({"autopilot": COPTER, "parameters": {"PSC_JERK_XY": 0}}, {}, "PSC_JERK_XY is 0: must be more than 0"),
        (
            {"parameters": {"COM_OBL_RC_ACT": 3, "COM_OF_LOSS_T": math.nan}},
            {"allow_without": ["battery_failsafe"]},
            "parameter COM_OF_LOSS_T: the autopilot says that it is nan",
        ),
    ],
)
def test_parameters_with_which_nothing_flies_are_told(fly, bridge_config, talk, port, talker, changes, told):
    there = talk(port, **(READY | talker))
    without = {"allow_without": ["offboard_loss", "battery_failsafe"], "put_back": False}
    flight = fly(bridge_config(Place(port), **(without | changes)))
    assert flight.wait() == 1
    assert told in flight.told("error")[0]
    assert mavlink.MAV_CMD_COMPONENT_ARM_DISARM not in there.commands


@pytest.mark.parametrize(
    ("other", "told"),
    [
        ({"system": 2}, "two autopilots on one link: system 1 (px4 quadrotor) and system 2 (px4 quadrotor)"),
        ({"system": 1}, "both speak as system 1"),
    ],
)
def test_two_autopilots_on_one_link_are_not_flown(sitl, fly, bridge_config, talk, other, told):
    autopilot = sitl("--speed", "5", "--param", "COM_OF_LOSS_T=10")
    talk(autopilot.port, **other)
    flight = fly(bridge_config(autopilot, clock={"kind": "paced", "speed": 5.0}))
    assert flight.wait() == 1
    assert told in flight.told("error")[0]
    assert "arming" not in flight.phases
    assert not any(state.armed for state in flight.states)


def test_ground_stations_companions_gimbals_and_trackers_do_no_harm(sitl, fly, bridge_config, talk):
    autopilot = sitl("--speed", "10", "--param", "COM_OF_LOSS_T=10")
    talk(autopilot.port, system=255, component=190, kind=GROUND, autopilot=INVALID)
    talk(autopilot.port, system=1, component=191, kind=mavlink.MAV_TYPE_ONBOARD_CONTROLLER, autopilot=INVALID)
    talk(autopilot.port, system=1, component=154, kind=mavlink.MAV_TYPE_GIMBAL, autopilot=INVALID)
    talk(autopilot.port, system=1, component=156, kind=mavlink.MAV_TYPE_ADSB, autopilot=INVALID, position=True)
    talk(autopilot.port, system=2, component=1, kind=mavlink.MAV_TYPE_ANTENNA_TRACKER, autopilot=COPTER)
    talk(autopilot.port, system=1, component=1, kind=GROUND, autopilot=INVALID)  # with the vehicle's own name
    flight = fly(bridge_config(autopilot, clock={"kind": "paced", "speed": 10.0}))
    assert flight.wait() == 0


def test_who_speaks_as_the_vehicle_in_flight_is_not_believed_and_told(sitl, fly, bridge_config, talk):
    autopilot = sitl("--speed", "10", "--param", "COM_OF_LOSS_T=10")
    flight = fly(bridge_config(autopilot, clock={"kind": "paced", "speed": 10.0}, slots=20))
    flight.until_slot(1)
    talk(autopilot.port, autopilot=PX4, position=True)  # disarmed, at home, in another mode
    talk(autopilot.port, system=2)
    assert flight.wait() == 0
    assert flight.told("mode") == []
    told = " ".join(flight.told("vehicle"))
    assert "both speak as system 1" in told
