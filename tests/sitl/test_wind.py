"""Wind and Dryden gusts against MIL-F-8785C's closed forms."""

import math

import numpy as np
import pytest
from scipy.signal import welch

from sitl.flight.wind import FOOT_M, Gusts, Wind, turbulence
from tests.sitl.client import direct

DT = 0.01


def series(wind: Wind, height: float, airspeed: float, seconds: float, seed: int = 1, dt: float = DT) -> np.ndarray:
    """Gusts [n, 3] along, across and down, without the mean."""
    gusts = Gusts(seed)
    return np.array([gusts.step(wind, height, airspeed, dt) for _ in range(round(seconds / dt))]) - np.array(wind.mean)


def test_intensities_and_lengths_of_the_low_altitude_model():
    """MIL-F-8785C, 3.7.3.1 at 100 ft: sigma_w = 0.1 W20, sigma_u = sigma_w / (0.177 + 0.000823 h)^0.4, L in ft."""
    t = turbulence(15.0, 100 * FOOT_M)
    base = 0.177 + 0.0823
    assert t.sigma_vertical == pytest.approx(1.5)
    assert t.sigma_horizontal == pytest.approx(1.5 / base**0.4)
    assert t.length_vertical == pytest.approx(100 * FOOT_M)
    assert t.length_horizontal == pytest.approx(100 / base**1.2 * FOOT_M)


@pytest.mark.parametrize("height", [-5.0, 0.0, 1.0, 3.0])
def test_the_model_ends_at_ten_feet(height):
    assert turbulence(10.0, height) == turbulence(10.0, 10 * FOOT_M)


def test_standard_deviations():
    """Over a thousand correlation times, of which one is 15 s: their own scatter is 2 %."""
    found = series(Wind(w20=15.0), 30.0, 10.0, 30_000.0, dt=0.1).std(axis=0)
    t = turbulence(15.0, 30.0)
    assert found == pytest.approx((t.sigma_horizontal, t.sigma_horizontal, t.sigma_vertical), rel=0.08)


def test_spectra_are_drydens():
    """One-sided: S_u = 4 s2 T / (1 + (T w)^2), S_w = 2 s2 T (1 + 3 (T w)^2) / (1 + (T w)^2)^2 over f, T = L / V."""
    speed, height = 10.0, 30.0
    gusts = series(Wind(w20=15.0), height, speed, 2000.0)
    t = turbulence(15.0, height)
    f, found = welch(gusts, fs=1 / DT, nperseg=8192, axis=0)
    chosen = (f > 0.05) & (f < 2.0)
    w = 2 * math.pi * f[chosen]
    for axis, (sigma, length) in enumerate(
        [(t.sigma_horizontal, t.length_horizontal)] * 2 + [(t.sigma_vertical, t.length_vertical)]
    ):
        tw = (length / speed * w) ** 2
        time_s = length / speed
        along = 4 * sigma**2 * time_s / (1 + tw)
        across = 2 * sigma**2 * time_s * (1 + 3 * tw) / (1 + tw) ** 2
        expected = along if axis == 0 else across
        ratio = found[chosen, axis] / expected
        assert np.median(ratio) == pytest.approx(1.0, abs=0.12)
        assert np.all((ratio > 0.3) & (ratio < 3.0))


def test_gusts_turn_with_the_mean_wind():
    """Along is where the mean wind blows: with a wind to the east, what was north is east."""
    north = series(Wind((5.0, 0.0, 0.0), 15.0), 30.0, 5.0, 20.0)
    east = series(Wind((0.0, 5.0, 0.0), 15.0), 30.0, 5.0, 20.0)
    assert east[:, 1] == pytest.approx(north[:, 0])
    assert east[:, 0] == pytest.approx(-north[:, 1])


def test_same_seed_same_gusts():
    wind = Wind(w20=10.0)
    assert np.array_equal(series(wind, 10.0, 5.0, 5.0, seed=3), series(wind, 10.0, 5.0, 5.0, seed=3))
    assert not np.array_equal(series(wind, 10.0, 5.0, 5.0, seed=3), series(wind, 10.0, 5.0, 5.0, seed=4))


def test_no_wind_is_exactly_none(hovering):
    """Off by default: not a bit of the flight differs."""
    assert hovering.autopilot.vehicle.body.air.tolist() == [0.0, 0.0, 0.0]


def test_hovering_in_wind_leans_into_it():
    """Steady: tan(lean) = k_v W / (m g) with linear drag SIH_KDV."""
    with direct(SITL_WIND_N=-4.0) as vehicle:
        vehicle.take_off(499.4)
        vehicle.fly(10)
        assert vehicle.position == pytest.approx((0, 0, -10), abs=0.3)
        lean = -vehicle.latest["ATTITUDE"].pitch
        assert math.tan(lean) == pytest.approx(1.0 * 4.0 / 9.80665, rel=0.02)


def test_flight_in_gusts_is_repeatable_and_holds_its_place():
    def flown(seed):
        with direct(seed=seed, SITL_GUST_W20=10.0) as vehicle:
            vehicle.take_off(499.4)
            vehicle.fly(20)
            return vehicle.raw

    first = flown(1)
    assert flown(1) == first
    assert flown(2) != first
