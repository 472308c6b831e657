"""ArduCopter's failsafes: the decision as a table, then flown, over real UDP."""

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.arducopter.failsafes import Response, Situation, battery, estimator, ground_station
from sitl.arducopter.modes import Mode
from sitl.arducopter.parameters import TABLE
from sitl.injection import inject
from sitl.parameters import Parameters
from tests.sitl.copter import AUTO, DO_SET_MODE, GUIDED, LAND, LOITER, RTL, copter
from tests.sitl.test_sticks import push

FAILED = 4
IN_GUIDED = Situation(Mode.GUIDED, flying=True, located=True)
STOP = Response(stop=True)


def parameters(**values: float) -> Parameters:
    p = Parameters(TABLE)
    for name, value in values.items():
        p.set(name, value)
    return p


@pytest.mark.parametrize(
    ("action", "response"),
    [
        (0, Response()),
        (1, Response(Mode.LAND)),
        (2, Response(Mode.RTL)),
        (3, Response(Mode.RTL)),
        (4, Response(Mode.RTL)),
        (5, STOP),
        (6, Response(Mode.RTL)),
        (7, Response(Mode.BRAKE)),
    ],
)
def test_battery(action, response):
    p = parameters(BATT_FS_LOW_ACT=action)
    assert battery(1, p, IN_GUIDED) == response
    assert battery(2, p, IN_GUIDED) == Response()
    assert battery(2, parameters(BATT_FS_CRT_ACT=action), IN_GUIDED) == response
    on_the_ground = battery(1, p, IN_GUIDED._replace(flying=False))
    assert on_the_ground == (STOP if action else Response())
    blind = battery(1, p, IN_GUIDED._replace(located=False))
    assert blind.mode in (None, Mode.LAND)


@pytest.mark.parametrize(
    ("enabled", "options", "situation", "response"),
    [
        (0, 16, IN_GUIDED, Response()),
        (1, 16, IN_GUIDED, Response(Mode.RTL)),
        (2, 16, IN_GUIDED._replace(mode=Mode.AUTO), Response(note="Continuing Auto Mode")),
        (3, 16, IN_GUIDED._replace(mode=Mode.AUTO), Response(Mode.RTL)),
        (1, 18, IN_GUIDED._replace(mode=Mode.AUTO), Response(note="Continuing Auto Mode")),
        (5, 16, IN_GUIDED, Response(Mode.LAND)),
        (7, 16, IN_GUIDED, Response(Mode.BRAKE)),
        (1, 16, IN_GUIDED._replace(mode=Mode.LOITER), Response(note="Continuing Pilot Control")),
        (1, 0, IN_GUIDED._replace(mode=Mode.LOITER), Response(Mode.RTL)),
        (1, 8, IN_GUIDED._replace(mode=Mode.LAND, landing=True), Response(note="Continuing Landing")),
        (1, 16, IN_GUIDED._replace(flying=False), STOP),
        (1, 16, IN_GUIDED._replace(located=False), Response(Mode.LAND)),
    ],
)
def test_ground_station(enabled, options, situation, response):
    assert ground_station(parameters(FS_GCS_ENABLE=enabled, FS_OPTIONS=options), situation) == response


@pytest.mark.parametrize(
    ("action", "mode", "response"),
    [
        (1, Mode.GUIDED, Response(Mode.LAND)),
        (2, Mode.GUIDED, Response(Mode.ALT_HOLD)),
        (3, Mode.GUIDED, Response(Mode.LAND)),
        (0, Mode.GUIDED, Response()),
        (1, Mode.STABILIZE, Response()),
        (3, Mode.STABILIZE, Response(Mode.LAND)),
    ],
)
def test_estimator(action, mode, response):
    now = Situation(mode, flying=True, located=False)
    assert estimator(parameters(FS_EKF_ACTION=action), now) == response


def hear(vehicle, system: int = 255) -> None:
    mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
    vehicle.udp.sendto(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mav), vehicle.to)


def test_ground_station_lost_is_flown_home_by():
    """FS_GCS_ENABLE 1, FS_GCS_TIMEOUT 5 s; only a station of MAV_GCS_SYSID counts."""
    with copter(FS_GCS_ENABLE=1) as vehicle:
        vehicle.take_off(15.0)
        vehicle.fly(6)
        assert vehicle.mode == GUIDED  # none was ever heard
        hear(vehicle)
        start = vehicle.time_ms
        vehicle.fly(4.5, lambda: hear(vehicle, 77))
        assert vehicle.mode == GUIDED
        vehicle.until(lambda: "GCS Failsafe" in vehicle.texts(), 2)
        assert vehicle.time_ms - start == pytest.approx(5000, abs=100)
        vehicle.fly(0.2)
        assert vehicle.mode == RTL
        hear(vehicle)
        vehicle.fly(1.2)
        assert "GCS Failsafe Cleared" in vehicle.texts()
        assert vehicle.mode == RTL  # until the pilot changes it
        assert vehicle.command(DO_SET_MODE, 1, GUIDED) == 0
        vehicle.fly(1)
        assert vehicle.mode == GUIDED


def test_position_lost_lands_without_it():
    """FS_EKF_ACTION 1, a second after EKF3 has given up its position (10 s without GPS)."""
    with copter() as vehicle:
        vehicle.take_off(8.0)
        inject(vehicle.autopilot, "wind 0,4,0")
        inject(vehicle.autopilot, "gps_loss")
        start = vehicle.time_ms
        vehicle.until(lambda: "EKF variance" in vehicle.texts(), 14)
        assert vehicle.time_ms - start == pytest.approx(11_000, abs=150)
        vehicle.fly(1.5)
        assert vehicle.mode == LAND
        assert vehicle.latest["HEARTBEAT"].system_status == 5
        assert vehicle.command(DO_SET_MODE, 1, GUIDED) == FAILED
        assert vehicle.command(DO_SET_MODE, 1, LOITER) == FAILED
        vehicle.until(lambda: not vehicle.armed, 60)
        assert vehicle.autopilot.vehicle.model.truth.position[1] > 2.0
        assert vehicle.commander.why_not_arm() == ("Need Position Estimate",)
        inject(vehicle.autopilot, "ok")
        vehicle.fly(1)
        assert vehicle.command(DO_SET_MODE, 1, GUIDED) == 0
        assert vehicle.command(400, 1) == 0


def test_failed_motor_crashes_and_disarms():
    """FS_CRASH_CHECK; SIM_ENGINE_FAIL is ArduPilot's own way to stop a motor."""
    with copter() as vehicle:
        vehicle.take_off(25.0)
        vehicle.autopilot.vehicle.parameters.set("SIM_ENGINE_FAIL", 2)
        vehicle.until(lambda: not vehicle.commander.armed, 15)
        assert vehicle.autopilot.vehicle.model.wrecked
        assert any(text.startswith("Crash: Disarming") for text in vehicle.texts())


def test_stopped_motors_do_not_fly_whatever_the_throttle_says():
    """A crash is the end of the flight, also while the pilot asks for a climb."""
    with copter() as vehicle:
        vehicle.take_off(25.0)
        assert vehicle.command(176, 1, 2) == 0  # ALT_HOLD

        def climb() -> None:
            push(vehicle, throttle=0.9)

        vehicle.fly(1, climb)
        vehicle.autopilot.vehicle.parameters.set("SIM_ENGINE_FAIL", 2)
        vehicle.until(lambda: not vehicle.commander.armed, 20, climb)
        vehicle.fly(1, climb)
        assert not vehicle.commander.flying
        assert vehicle.landed == 1


def test_arducopters_own_simulation_parameters_act():
    """SIM_GPS1_ENABLE, SIM_WIND_SPD from SIM_WIND_DIR, SIM_WIND_TURB."""
    with copter(SIM_WIND_SPD=5.0, SIM_WIND_DIR=90.0) as vehicle:
        vehicle.take_off(8.0)
        model = vehicle.autopilot.vehicle.model
        assert model.truth.air == pytest.approx((0.0, -5.0, 0.0), abs=1e-9)
        vehicle.autopilot.vehicle.parameters.set("SIM_WIND_TURB", 2.0)
        vehicle.autopilot.vehicle.parameters.set("SIM_GPS1_ENABLE", 0)
        vehicle.fly(2)
        assert model.truth.air[0] != 0.0
        assert vehicle.latest["GPS_RAW_INT"].fix_type < 2


def test_battery_voltage_lowered_in_flight():
    """SIM_BATT_VOLTAGE below BATT_LOW_VOLT, the usual way to test BATT_FS_LOW_ACT on ArduPilot's simulator.

    It must be so for BATT_LOW_TIMER, 10 s: a shorter time is forgotten.
    """
    with copter(BATT_FS_LOW_ACT=2) as vehicle:
        vehicle.take_off(8.0)
        assert vehicle.mode == GUIDED
        for volts, seconds in ((10.4, 9.0), (12.6, 0.5), (10.4, 9.5)):
            vehicle.autopilot.vehicle.parameters.set("SIM_BATT_VOLTAGE", volts)
            vehicle.fly(seconds)
            assert vehicle.mode == GUIDED
        vehicle.fly(1.5)
        assert vehicle.mode == RTL
        assert "Battery Failsafe" in vehicle.texts()
        assert vehicle.commander.battery.voltage == pytest.approx(10.4, abs=0.1)


def test_auto_goes_on_without_a_ground_station_where_told():
    assert AUTO == Mode.AUTO
    with copter(FS_GCS_ENABLE=5, FS_GCS_TIMEOUT=2.0) as vehicle:
        vehicle.take_off(8.0)
        hear(vehicle)
        vehicle.fly(3.5)
        assert vehicle.mode == LAND
