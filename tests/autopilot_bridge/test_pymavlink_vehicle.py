"""The back end against a real SITL process, in lockstep, with frames lost on the way."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.clock import Lockstep
from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.dialects.px4 import PX4
from autopilot_bridge.link import Link
from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle
from autopilot_bridge.vehicle import Mode, RefusedError, VehicleError


def message_id(frame):
    return int.from_bytes(frame[7:10], "little")


class Loss:
    """Loses the first `count` frames of a message id."""

    def __init__(self, lost, count):
        self.lost, self.left = lost, count

    def __call__(self, frame):
        if message_id(frame) == self.lost and self.left > 0:
            self.left -= 1
            return ()
        return (frame,)


@pytest.fixture
def autopilot(sitl):
    return sitl("--lockstep")


@pytest.fixture
def connect(autopilot):
    opened = []

    def start(**tamper):
        link = Link(f"udpin://127.0.0.1:{autopilot.port}", 1, **tamper)
        clock = Lockstep(autopilot.control, 50)
        vehicle = PymavlinkVehicle(link, dialects("px4"), 1, clock, lambda: clock.step(vehicle))
        opened.append((clock, vehicle))
        vehicle.connect()
        return vehicle

    yield start
    for clock, vehicle in opened:
        clock.close(over=True)
        vehicle.close()


def test_arms_takes_off_and_hovers_about_home(connect):
    vehicle = connect()
    vehicle.await_armable()
    vehicle.arm()
    vehicle.takeoff(5.0)
    position, _ = vehicle.telemetry.at(vehicle.telemetry.time_s)
    assert position == pytest.approx([0, 0, 5], abs=1.0)
    assert vehicle.telemetry.mode is Mode.HOLD
    assert not vehicle.telemetry.landed
    assert vehicle.telemetry.home_lat_lon_alt == pytest.approx((47.397743, 8.545594, 489.4), abs=0.1)
    with pytest.raises(RefusedError, match="Disarming denied: not landed"):
        vehicle.disarm()
    with pytest.raises(RefusedError, match="Switching to mode 'Offboard' is currently not possible"):
        vehicle.set_mode(Mode.OFFBOARD)
    for mode in (Mode.RETURN, Mode.LAND, Mode.HOLD):
        vehicle.set_mode(mode)
        assert vehicle.telemetry.mode is mode


def test_flies_where_the_setpoints_point_in_enu_over_a_link_that_doubles(connect):
    vehicle = connect(tamper_in=lambda frame: (frame, frame), tamper_out=lambda frame: (frame, frame))
    vehicle.await_armable()
    vehicle.arm()
    vehicle.takeoff(5.0)
    step = vehicle._wait
    vehicle._wait = lambda: (vehicle.send_velocity(np.array([2.0, 0.0, 0.5]), yaw_enu=0.0), step())
    for _ in range(10):
        vehicle._wait()
    vehicle.set_mode(Mode.OFFBOARD)
    start, _ = vehicle.telemetry.at(vehicle.telemetry.time_s)
    for _ in range(100):
        vehicle._wait()
    moved = vehicle.telemetry.position_enu - start
    assert moved[0] > 6.0
    assert moved[1] == pytest.approx(0.0, abs=0.2)
    assert moved[2] > 1.0
    assert vehicle.telemetry.attitude_rad[2] == pytest.approx(0.0, abs=0.1)  # faces east


@pytest.mark.parametrize(
    "tamper",
    [
        {"tamper_in": Loss(mavlink.MAVLINK_MSG_ID_COMMAND_ACK, 1000)},
        {"tamper_out": Loss(mavlink.MAVLINK_MSG_ID_COMMAND_LONG, len(PX4.rates_hz) + 2)},
    ],
    ids=["acks lost", "commands lost"],
)
def test_arms_by_state_and_by_repetition(connect, tamper):
    vehicle = connect(**tamper)
    vehicle.await_armable()
    vehicle.arm()
    assert vehicle.telemetry.armed


def test_long_status_texts_and_parameters_of_both_types(connect):
    vehicle = connect(tamper_out=Loss(mavlink.MAVLINK_MSG_ID_PARAM_SET, 1))
    with pytest.raises(RefusedError, match="Arming denied: Resolve system health failures first"):
        vehicle.arm()  # seconds too early
    assert "Arming denied: Resolve system health failures first" in vehicle.status_texts()
    assert vehicle.status_texts() == []
    assert vehicle.parameter("COM_OBL_RC_ACT") == 0
    vehicle.set_parameter("COM_OBL_RC_ACT", 3)
    assert vehicle.parameter("COM_OBL_RC_ACT") == 3
    vehicle.set_parameter("MPC_XY_VEL_MAX", 7.3)
    assert vehicle.parameter("MPC_XY_VEL_MAX") == pytest.approx(7.3)
    with pytest.raises(VehicleError, match="NO_SUCH: unknown"):
        vehicle.parameter("NO_SUCH")
    with pytest.raises(VehicleError, match=r"COM_OBL_RC_ACT: 3\.5 is not a whole number"):
        vehicle.set_parameter("COM_OBL_RC_ACT", 3.5)
    with pytest.raises(VehicleError, match="COM_OBL_RC_ACT: the autopilot did not take 77"):
        vehicle.set_parameter("COM_OBL_RC_ACT", 77)


def test_rates_are_asked_for_until_they_are_acknowledged(connect):
    lost = iter([True, True, False, True] * 1000)

    def every_other(frame):
        return () if message_id(frame) == mavlink.MAVLINK_MSG_ID_COMMAND_LONG and next(lost) else (frame,)

    vehicle = connect(tamper_out=every_other)
    came = []
    vehicle._link.listener = came.append
    for _ in range(2 * 20):
        vehicle._wait()
    per_s = {number: sum(message_id(frame) == number for frame in came) / 2 for number in PX4.rates_hz}
    for number in (mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_ODOMETRY):
        assert per_s[number] == pytest.approx(PX4.rates_hz[number], abs=0.6)


def test_a_parameter_that_somebody_else_has_set_unheard_is_read_anew(connect, autopilot):
    deaf = [False]
    vehicle = connect(
        tamper_in=lambda frame: () if deaf[0] and message_id(frame) == mavlink.MAVLINK_MSG_ID_PARAM_VALUE else (frame,)
    )
    assert vehicle.parameter("MPC_XY_VEL_MAX") == 12
    deaf[0] = True
    autopilot.say(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_VEL_MAX", 9.0, mavlink.MAV_PARAM_TYPE_REAL32))
    for _ in range(4):
        vehicle._wait()
    deaf[0] = False
    assert vehicle.parameter("MPC_XY_VEL_MAX") == 9


def test_a_home_that_a_ground_station_moves_in_flight_is_told_and_positions_stay(connect, autopilot):
    vehicle = connect()
    vehicle.await_armable()
    vehicle.arm()
    vehicle.takeoff(5.0)
    before = vehicle.telemetry.position_enu
    assert vehicle.remarks() == []
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, 47.398643, 8.545594, 489.4)  # 100 m north
    for _ in range(30):
        vehicle._wait()
    assert vehicle.telemetry.position_enu == pytest.approx(before, abs=1.0)
    (remark,) = vehicle.remarks()
    assert "home was moved to (0." in remark or "home was moved to (-0." in remark
    assert ", 100.1, " in remark or ", 100.0, " in remark


@pytest.mark.parametrize("deaf_to", [3, 1000])
def test_home_is_asked_for_at_arming_until_it_is_told(connect, deaf_to):
    asked, deaf = [], [False]

    def count(frame):
        if message_id(frame) == mavlink.MAVLINK_MSG_ID_COMMAND_LONG:
            (command,) = mavlink.MAVLink(None).parse_buffer(frame)
            asked.extend([command.param1] if command.command == mavlink.MAV_CMD_REQUEST_MESSAGE else [])
        return (frame,)

    def lose(frame):
        home = message_id(frame) == mavlink.MAVLINK_MSG_ID_HOME_POSITION
        return () if home and deaf[0] and len(asked) < deaf_to else (frame,)

    vehicle = connect(tamper_out=count, tamper_in=lose)
    vehicle.await_armable()
    asked.clear()
    deaf[0] = True
    vehicle.arm()
    vehicle._wait()
    if deaf_to == 3:
        assert asked == [mavlink.MAVLINK_MSG_ID_HOME_POSITION] * 3
        assert vehicle.remarks() == []
    else:
        assert vehicle.remarks() == ["home at arming was not told: positions are about the one before"]
