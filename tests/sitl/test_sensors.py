"""What the vehicle believes and shows: noise, an estimator that errs, a position that is lost."""

import math

import numpy as np
import pytest

from sitl.flight.sensors import ACCELEROMETER, ERROR_RATE, Estimator, Faults, Loss
from sitl.injection import inject
from tests.sitl.client import Direct, direct
from tests.sitl.copter import copter

DT = 0.01


def test_estimators_error_has_its_deviation_and_fits_its_velocity():
    """Second-order Gauss-Markov: deviation sigma, of the velocity rate x sigma; the velocity is the derivative."""
    estimator = Estimator(2.0, seed=5)
    positions, velocities = [], []
    for _ in range(60_000):
        estimator.wander(0.25)
        positions.append(estimator.position_error.copy())
        velocities.append(estimator.velocity_error.copy())
    p, v = np.array(positions), np.array(velocities)
    assert p.std() == pytest.approx(2.0, rel=0.1)
    assert v.std() == pytest.approx(2.0 * ERROR_RATE, rel=0.1)
    assert np.diff(p, axis=0) / 0.25 == pytest.approx(v[1:], abs=1e-9)


def test_without_gps_the_error_grows():
    with_gps, without = Estimator(1.0, 1), Estimator(1.0, 1)
    without.gps = False
    for _ in range(20_000):
        with_gps.wander(DT)
        without.wander(DT)
    assert np.linalg.norm(without.position_error) > 3 * np.linalg.norm(with_gps.position_error)


def test_a_position_lasts_beyond_the_last_fix():
    estimator = Estimator(0.0, 0)
    valid = {}
    for ms in range(0, 20_000, 10):
        estimator.step(ms, gps=ms < 5000 or ms >= 15_000, solution=True, dead_reckoning_s=5.0)
        valid[ms] = estimator.valid
    assert [valid[ms] for ms in (4990, 9990, 10_000, 14_990, 15_000)] == [True, True, False, False, True]
    estimator.step(20_000, gps=True, solution=False, dead_reckoning_s=5.0)
    assert not estimator.valid


def test_faults_end_by_themselves():
    faults = Faults()
    assert not any(faults.lost(what, 0) for what in Loss)
    faults.lose(Loss.GPS, 1000.0)
    faults.lose(Loss.STICKS, math.inf)
    assert (faults.lost(Loss.GPS, 999), faults.lost(Loss.GPS, 1000)) == (True, False)
    assert faults.lost(Loss.STICKS, 10**9)
    assert not faults.lost(Loss.GCS, 0)


IMU_HZ = {"HIGHRES_IMU": 50.0, "GPS_RAW_INT": 8.0, "HEARTBEAT": 1.0, "EXTENDED_SYS_STATE": 5.0}


def shown(**parameters: float) -> list:
    """HIGHRES_IMU messages of 10 s at rest."""
    with direct(IMU_HZ, **parameters) as vehicle:
        vehicle.fly(12)
        return [m for m in vehicle.messages if m.get_type() == "HIGHRES_IMU" and m.time_usec > 2_000_000]


def test_imu_noise_is_seeded_scaled_and_can_be_off():
    usual, loud, none = shown(), shown(SITL_NOISE=10.0), shown(SITL_NOISE=0.0)
    assert [m.xacc for m in usual] == [m.xacc for m in shown()]
    assert np.std([m.xacc for m in usual]) == pytest.approx(ACCELEROMETER, rel=0.1)
    assert np.std([m.yacc for m in loud]) == pytest.approx(10 * ACCELEROMETER, rel=0.1)
    assert np.std([m.abs_pressure for m in usual]) > 0
    assert len({(m.xacc, m.yacc, m.zacc, m.xgyro, m.abs_pressure) for m in none}) == 1


def test_gps_noise_is_in_gps_raw_int_only(hovering):
    raw, position = [], []
    for _ in range(60):
        hovering.advance(130)
        raw.append(hovering.latest["GPS_RAW_INT"].lat)
        position.append(hovering.latest["GLOBAL_POSITION_INT"].lat)
    assert np.std(raw) * 1e-7 * 111_195 == pytest.approx(0.1, rel=0.3)
    assert np.std(position) * 1e-7 * 111_195 < 0.02


def distance(vehicle: Direct) -> float:
    """Between where the vehicle believes to be and where it is [m]."""
    v = vehicle.autopilot.vehicle
    return float(np.linalg.norm(v.body.position - v.model.truth.position))


def test_a_vehicle_that_errs_wanders_but_believes_to_stand():
    """SITL_EST_ERR: control flies by the estimate."""
    with direct(SITL_EST_ERR=2.0, seed=3) as vehicle:
        vehicle.take_off(509.4)
        vehicle.fly(15)
        wandered, believed = [], []
        for _ in range(60):
            vehicle.fly(1)
            wandered.append(vehicle.autopilot.vehicle.model.truth.position.copy())
            believed.append(vehicle.position)
        assert np.std(believed, axis=0).max() < 0.3
        assert np.std(wandered, axis=0).max() > 0.4
        assert distance(vehicle) < 8.0
        truth = vehicle.command(512, 115)  # HIL_STATE_QUATERNION
        assert truth == 0
        shown = vehicle.latest["HIL_STATE_QUATERNION"]
        north, _ = vehicle.autopilot.vehicle.origin.local(shown.lat * 1e-7, shown.lon * 1e-7)
        assert north == pytest.approx(float(vehicle.autopilot.vehicle.model.truth.position[0]), abs=0.2)


def test_a_perfect_estimator_is_the_truth(hovering):
    v = hovering.autopilot.vehicle
    assert v.body is v.model.truth


def test_an_erring_flight_still_lands_and_is_repeatable():
    def flown() -> list[bytes]:
        with direct(SITL_EST_ERR=1.0, seed=4) as vehicle:
            vehicle.take_off(499.4)
            vehicle.command(21, 0, 0, 0, math.nan)
            vehicle.until(lambda: not vehicle.armed, 60)
            assert vehicle.autopilot.vehicle.model.truth.position[2] == 0.0
            return vehicle.raw

    assert flown() == flown()


def test_arducopter_shows_its_gps_noise():
    """SIM_GPS1_NOISE [m]; 0 as recorded."""
    with copter(SIM_GPS1_NOISE=0.0) as vehicle:
        vehicle.until(lambda: "HEARTBEAT" in vehicle.latest, 3)
        vehicle.watch()
        vehicle.fly(11)
        lat = {m.lat for m in vehicle.messages if m.get_type() == "GPS_RAW_INT" and m.fix_type == 6}
        assert len(lat) == 1
        vehicle.autopilot.vehicle.parameters.set("SIM_GPS1_NOISE", 1.0)
        vehicle.fly(2)
        lat = {m.lat for m in vehicle.messages if m.get_type() == "GPS_RAW_INT" and m.fix_type == 6}
        assert len(lat) > 5


def test_gps_loss_shows_zeros(hovering):
    inject(hovering.autopilot, "gps_loss 2")
    hovering.fly(1)
    raw = hovering.latest["GPS_RAW_INT"]
    assert (raw.fix_type, raw.satellites_visible, raw.lat, raw.eph) == (1, 0, 0, 65535)
