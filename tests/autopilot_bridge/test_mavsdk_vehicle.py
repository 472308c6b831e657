"""A whole flight by MAVSDK, at the wall clock's pace since it knows no other; all pairs: test_vehicle_contract.py."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.clock import Paced
from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.link import Link
from autopilot_bridge.mavsdk_vehicle import DARK_WALL_S, MavsdkVehicle
from autopilot_bridge.vehicle import Mode


def test_a_flight_by_mavsdk(sitl, fly, bridge_config, tmp_path):
    tlog = tmp_path / "flight.tlog"
    config = bridge_config(
        sitl("--param", "COM_OF_LOSS_T=3"),  # so that a busy machine's stalls do not pass for a lost stream
        backend="mavsdk",
        slots=3,
        start_position_enu=(0.0, 0.0, 6.0),
        box={"x": (-50, 50), "y": (-50, 50), "z": (4, 40)},
        takeoff_altitude_m=5.0,
    )
    flight = fly(config, lambda opened: (2.0, 0.0, 0.0) if opened.slot != 1 else None, tlog)
    assert flight.wait() == 0
    assert [flown.outcome for flown in flight.flown if flown.slot != 1] == ["flown", "flown"]
    assert flight.flown[1].outcome == "missing"
    assert flight.flown[0].flown_enu[0] > 0.8
    assert not flight.states[-1].armed

    log, setpoints, heard = mavutil.mavlink_connection(str(tlog), notimestamps=False), [], []
    while (message := log.recv_match()) is not None:
        if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED":
            setpoints.append(message)
            assert (message.get_srcSystem(), message.get_srcComponent()) == (245, 191)
            assert (message.type_mask, message.coordinate_frame) == (2503, 1)
        elif message.get_type() == "HEARTBEAT" and message.get_srcSystem() == 1:
            heard.append(message._timestamp)
    streamed_s = setpoints[-1]._timestamp - setpoints[0]._timestamp
    assert 0.7 * 20 * streamed_s < len(setpoints) < 1.1 * 20 * streamed_s + 2  # ours: one per step, no repeats
    assert heard[-1] - setpoints[-1]._timestamp > 5.0  # and none while it lands


def test_what_waited_while_our_loop_stood_still_is_not_sent_late():
    sent = []
    link = Link("udpin://127.0.0.1:0", 1, tamper_out=lambda frame: sent.append(frame) or ())
    clock = Paced(1.0, 50)
    vehicle = MavsdkVehicle(link, dialects("auto"), 1, clock, lambda: clock.step(vehicle))
    vehicle.poll(0.0)
    sent.clear()
    deadline = time.monotonic() + 10.0
    while len(vehicle._outbox) < 3:  # MAVSDK's heartbeats, one a second
        assert time.monotonic() < deadline
        time.sleep(0.01)
    vehicle.poll(0.0)
    vehicle.close()
    assert vehicle.counters["stale_dropped"] >= 1
    assert len(sent) <= 2
    assert all(frame[7:10] == bytes([mavlink.MAVLINK_MSG_ID_HEARTBEAT, 0, 0]) for frame in sent)


def test_a_repeat_that_comes_in_between_does_not_delay_the_setpoint_asked_for():
    """MAVSDK's own timer drifts through our steps; the race is played here, since it comes every 16 s."""
    sent = []
    link = Link("udpin://127.0.0.1:0", 1, tamper_out=lambda frame: sent.append(frame) or ())
    vehicle = MavsdkVehicle(link, dialects("auto"), 1, Paced(1.0, 50), lambda: None)
    codec = mavlink.MAVLink(None, srcSystem=245, srcComponent=191)

    def hand_over(north):
        message = mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 2503, *[0.0] * 3, north, 0.0, -0.0, *[0.0] * 5
        )
        vehicle._hand_over(bytes(message.pack(codec)))

    class Racing:
        def set_velocity_ned(self, velocity):
            hand_over(1.0)  # the repeat of what was before
            threading.Timer(0.005, hand_over, (velocity.north_m_s,)).start()

    vehicle._offboard = Racing()
    vehicle.send_velocity(np.array([0.0, 2.0, 0.0]), 0.0)
    setpoints = [frame for frame in sent if frame[7:10] == bytes([84, 0, 0])]
    vehicle.close()
    assert [mavlink.MAVLink(None).decode(bytearray(frame)).vx for frame in setpoints] == [2.0]
    assert vehicle.counters["repeats_dropped"] == 1


class TakenOverError(Exception):
    """Raised from waiting, as the loop does once a pilot has chosen a mode."""


def commands(sent):
    """Of the COMMAND_LONGs that were sent."""
    command_long = bytes([mavlink.MAVLINK_MSG_ID_COMMAND_LONG, 0, 0])
    decode = mavlink.MAVLink(None).decode
    return [decode(bytearray(frame)).command for frame in sent if frame[7:10] == command_long]


def test_a_command_that_we_have_given_up_waiting_for_is_not_repeated(sitl):
    """Its ACK was lost, so MAVSDK asks again 0.5 s later; but by then a pilot has chosen."""
    sent, ack, lost = [], bytes([mavlink.MAVLINK_MSG_ID_COMMAND_ACK, 0, 0]), []
    autopilot = sitl()
    link = Link(
        f"udpin://127.0.0.1:{autopilot.port}",
        1,
        tamper_in=lambda datagram: () if lost and datagram[7:10] == ack else (datagram,),
        tamper_out=lambda frame: sent.append(frame) or (frame,),
    )
    clock, taken_over = Paced(1.0, 50), []

    def wait():
        clock.step(vehicle)
        if lost and vehicle.telemetry.mode is Mode.RETURN:
            taken_over.append(True)
            raise TakenOverError

    def wait_for(seconds):
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            clock.step(vehicle)

    vehicle = MavsdkVehicle(link, dialects("auto"), 1, clock, wait)
    try:
        vehicle.connect()
        sent.clear()
        lost.append("ACKs")
        with pytest.raises(TakenOverError):
            vehicle.set_mode(Mode.RETURN)
        asked = commands(sent)
        assert asked
        autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 3)
        wait_for(2.5)
        assert commands(sent) == asked
        assert vehicle.telemetry.mode is Mode.HOLD
        assert vehicle.counters["given_up_dropped"] > 0
        lost.clear()
        vehicle.set_mode(Mode.LAND)  # what is asked for anew passes
        assert vehicle.telemetry.mode is Mode.LAND
    finally:
        vehicle.close()


def test_nothing_is_asked_of_an_armed_vehicle_that_is_not_heard():
    """It would arrive after a failsafe has chosen."""
    sent = []
    link = Link("udpin://127.0.0.1:0", 1, tamper_out=lambda frame: sent.append(frame) or ())
    vehicle = MavsdkVehicle(link, dialects("auto"), 1, Paced(1.0, 50), lambda: None)
    land = bytes(
        mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_NAV_LAND, 0, *[0.0] * 7).pack(
            mavlink.MAVLink(None, srcSystem=245, srcComponent=191)
        )
    )
    vehicle._hand_over(land)
    vehicle.poll(0.0)
    assert commands(sent) == [mavlink.MAV_CMD_NAV_LAND]
    vehicle._telemetry = replace(vehicle._telemetry, armed=True)
    vehicle._heard_at = time.monotonic() - 2 * DARK_WALL_S
    vehicle._hand_over(land)
    vehicle.poll(0.0)
    vehicle.close()
    assert commands(sent) == [mavlink.MAV_CMD_NAV_LAND]
    assert vehicle.counters["dark_dropped"] == 1
