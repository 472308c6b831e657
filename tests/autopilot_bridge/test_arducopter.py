"""Flights that ArduCopter flies in its own way: takeoff in GUIDED, what becomes of it without us, a pilot's LOITER."""

import time

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.clock import Lockstep
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.dialects.arducopter import ARDUCOPTER, LOITER
from autopilot_bridge.dialects.known import dialects
from autopilot_bridge.link import Link
from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle
from autopilot_bridge.vehicle import Mode
from tests.sitl.process import sitl_process

ARDU = ("--personality", "arducopter")
WITHOUT_BATTERY_FAILSAFE = ("--param", "BATT_FS_LOW_ACT=2", "--param", "BATT_LOW_VOLT=10.5")


def outcomes(flight):
    return [flown.outcome for flown in flight.flown]


def test_a_flight_as_planned_in_lockstep(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep", *ARDU, *WITHOUT_BATTERY_FAILSAFE)), lambda _: (3.0, 0.0, 0.0))
    assert flight.wait() == 0
    assert len(flight.flown) == 4
    assert set(outcomes(flight)) <= {"flown", "clipped"}
    assert flight.flown[-1].flown_enu[0] > 1.5
    assert any("acceleration_mps2=2.5" in text for text in flight.told("limits"))
    told = " ".join(flight.told("parameter"))
    assert "FS_GCS_ENABLE was 0" in told
    assert "MAV_GCS_SYSID was 255" in told
    assert "GUID_TIMEOUT was 3 s, for which the last velocity of a dead link is flown on: set to 1" in told
    assert "GUID_TIMEOUT put back to 3" in told
    assert {state.mode for state in flight.states if state.phase == "slots"} == {"GUIDED"}
    assert not flight.states[-1].armed


def test_a_pilot_in_loiter_is_obeyed_until_resume(sitl, fly, bridge_config):
    autopilot = sitl("--lockstep", *ARDU, *WITHOUT_BATTERY_FAILSAFE)

    def slowly(_):
        time.sleep(0.02)
        return (0.0, 0.0, 0.0)

    flight = fly(bridge_config(autopilot, slots=40), slowly)
    flight.until_slot(2)
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, 1, LOITER)
    flight.until_phase("yielded")
    assert any("LOITER was chosen" in text for text in flight.told("mode"))
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, 1, 17)
    flight.until(lambda: flight.states[-1].mode == "BRAKE", "BRAKE, in which no sticks are needed")
    assert flight.command("resume").accepted
    flight.until(lambda: flight.states[-1].mode == "GUIDED", "GUIDED again")
    assert flight.command("land").accepted
    assert flight.wait() == 3


def test_over_tcp(fly):
    with sitl_process(*ARDU, "--tcp-port", "0", *WITHOUT_BATTERY_FAILSAFE, lockstep=False, speed=10.0) as autopilot:
        config = BridgeConfig(
            autopilot=f"tcp://127.0.0.1:{autopilot.tcp}",
            clock={"kind": "paced", "speed": 10.0},
            dialect="arducopter",
            slots=2,
            start_position_enu=(0.0, 0.0, 9.0),
            box={"x": (-50, 50), "y": (-50, 50), "z": (8, 40)},
            at_end="land",
            autostart=True,
            parameters={"GUID_TIMEOUT": 5, "FS_GCS_TIMEOUT": 30},  # a busy machine's stalls are ten times as long
        )
        flight = fly(config)
        assert flight.wait() == 0
        assert len(flight.flown) == 2
        assert not flight.states[-1].armed


def test_the_wrong_dialect_is_told(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep", *ARDU), dialect="px4"))
    assert flight.wait() == 1
    assert "is MAV_AUTOPILOT_ARDUPILOTMEGA; we fly px4 (dialect)" in flight.told("error")[0]


@pytest.fixture
def hovering(sitl):
    """A vehicle in GUIDED at 10 m, as preflight leaves it, in lockstep."""
    autopilot = sitl("--lockstep", *ARDU)
    link = Link(f"udpin://127.0.0.1:{autopilot.port}", 1)
    clock = Lockstep(autopilot.control, 50)

    def step():
        if round(clock.now * 20) % 20 == 0:
            vehicle.beat()
        clock.step(vehicle)

    vehicle = PymavlinkVehicle(link, dialects("auto"), 1, clock, step)
    vehicle.connect()
    assert vehicle.dialect is ARDUCOPTER
    for name, values in ARDUCOPTER.failsafes.items():
        vehicle.set_parameter(name, values[0])
    vehicle.await_armable()
    vehicle.arm()
    vehicle.takeoff(10.0)
    yield vehicle, clock, link
    clock.close(over=True)
    vehicle.close()


def test_a_bridge_that_is_gone_ends_in_a_return(hovering):
    """GUID_TIMEOUT: 3 s on, then it brakes and stays in GUIDED; FS_GCS_TIMEOUT: 5 s without our heartbeat, RTL."""
    vehicle, clock, link = hovering
    for step in range(200):
        if step % 20 == 0:
            vehicle.beat()
        vehicle.send_velocity(np.array([4.0, 0.0, 0.0]), 0.0)
        clock.step(vehicle)
    assert vehicle.telemetry.position_enu[0] > 25.0
    link._tamper_out = lambda frame: ()
    gone = clock.now

    def after(seconds):
        while clock.now < gone + seconds:
            clock.step(vehicle)
        return vehicle.telemetry

    assert np.linalg.norm(after(2.8).velocity_enu) == pytest.approx(4.0, abs=0.3)
    assert after(4.0).mode is Mode.OFFBOARD
    assert after(6.2).mode is Mode.RETURN
    home = after(150.0)
    assert not home.armed
    assert np.linalg.norm(home.position_enu) < 1.0


def test_without_the_failsafe_of_its_ground_station_nobody_brings_it_down(hovering):
    """Why preflight sets it: the same, as ArduCopter comes."""
    vehicle, clock, link = hovering
    vehicle.set_parameter("FS_GCS_ENABLE", 0)
    link._tamper_out = lambda frame: ()
    for _ in range(60 * 20):
        clock.step(vehicle)
    assert vehicle.telemetry.mode is Mode.OFFBOARD
    assert vehicle.telemetry.position_enu[2] == pytest.approx(10.0, abs=0.5)
