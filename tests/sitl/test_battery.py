"""The battery: charge and voltage against closed forms, and as it is shown."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from airframe.power import NO_PANEL, Panel, RotaryWing, total_power
from sitl.flight.battery import LIPO, Battery, Pack, propulsion_power
from sitl.flight.physics import body_at_rest
from sitl.injection import inject
from tests.sitl.client import direct

IDEAL = Pack(4, 5000.0, 4.2, 3.3, (0.15, 0.07, 0.05))
CELLS = Pack(4, 5000.0, 4.2, 3.3, (0.15, 0.07, 0.05), cell_ohm=0.005)


def test_ideal_source():
    """Voltage linear in charge; a full battery gives its mean voltage times its charge."""
    battery = Battery(IDEAL)
    assert battery.voltage == pytest.approx(16.8)
    battery.drain(1000.0, 0.5 * IDEAL.capacity_j / 1000.0)
    assert battery.remaining == pytest.approx(0.5)
    assert battery.voltage == pytest.approx(4 * 3.75)
    battery.drain(1000.0, IDEAL.capacity_j)
    assert battery.remaining == 0.0


def test_cells_sag_under_load_and_recover():
    """V = V0 - R I with P = V I."""
    battery = Battery(CELLS)
    rest = battery.voltage
    battery.drain(200.0, 1e-9)
    ohm, volts, amps = 4 * 0.005, battery.voltage, battery.current_a
    assert volts < rest
    assert volts == pytest.approx(rest - ohm * amps)
    assert volts * amps == pytest.approx(200.0)
    battery.drain(0.0, 1.0)
    assert battery.voltage == pytest.approx(rest)


def test_charge_of_cells_by_an_independent_integration():
    """Coulombs: d(charge)/dt = -I, I from the quadratic, against scipy."""

    def current(charge: float) -> float:
        x, y = np.array(LIPO, float).T
        open_v = 4 * (3.3 + 0.9 * np.interp(charge, x, y))
        roots = np.roots([0.02, -open_v, 250.0])
        return float(min(roots))

    reference = solve_ivp(lambda _, q: [-current(q[0]) / (5.0 * 3600.0)], (0, 600), [1.0], max_step=2.0)
    battery = Battery(CELLS)
    for _ in range(60_000):
        battery.drain(250.0, 0.01)
    assert battery.remaining == pytest.approx(reference.y[0, -1], abs=1e-4)
    assert battery.used_j == pytest.approx(150_000)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1e5))
def test_any_load_leaves_a_voltage(remaining, power):
    """More than the cells can give: half the voltage, the current of greatest power."""
    battery = Battery(CELLS)
    battery.leave(remaining)
    battery.drain(power, 1e-9)
    assert 0.0 < battery.voltage <= 16.8
    assert battery.voltage >= 0.5 * CELLS.open_circuit_v(battery.remaining) - 1e-9


def test_curve_is_increasing_from_empty_to_full():
    curve = [CELLS.open_circuit_v(x) for x in np.linspace(0, 1, 101)]
    assert np.all(np.diff(curve) > 0)
    assert (curve[0], curve[-1]) == (pytest.approx(13.2), pytest.approx(16.8))


@given(st.tuples(*[st.floats(-15, 15)] * 6), st.floats(-3.1, 3.1))
def test_power_is_the_papers_by_the_velocity_through_the_air(v, yaw):
    """Eq. 15 to 19 of the paper; x east, y north, z up there."""
    body = body_at_rest()
    body.velocity[:], body.air[:] = v[:3], v[3:]
    body.attitude[:] = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    n, e, d = body.velocity - body.air
    panel = Panel(area_m2=0.09)
    expected = total_power(RotaryWing(), panel, e, n, -d, math.sin(yaw), math.cos(yaw))
    assert propulsion_power(body, panel) == pytest.approx(expected)
    without = total_power(RotaryWing(), NO_PANEL, e, n, -d, 1.0, 0.0)
    assert propulsion_power(body, NO_PANEL) == pytest.approx(without)
    assert propulsion_power(body, panel) >= propulsion_power(body, NO_PANEL) - 1e-9


def test_sag_is_shown():
    """SYS_STATUS and BATTERY_STATUS: the terminal voltage, which comes back when the load is gone."""
    with direct(SITL_BAT_R=0.01) as vehicle:
        vehicle.boot()
        rest = vehicle.latest["SYS_STATUS"].voltage_battery
        assert rest == pytest.approx(4 * 4050, abs=2)
        vehicle.take_off(499.4)
        vehicle.fly(5)
        status = vehicle.latest["SYS_STATUS"]
        assert status.voltage_battery < rest - 300
        assert status.voltage_battery / 1000 * status.current_battery / 100 == pytest.approx(192.5, rel=0.02)
        assert vehicle.latest["BATTERY_STATUS"].voltages[0] == pytest.approx(status.voltage_battery, abs=50)
        vehicle.command(21, 0, 0, 0, math.nan)
        vehicle.until(lambda: not vehicle.armed, 40)
        vehicle.fly(1)
        assert vehicle.latest["SYS_STATUS"].voltage_battery > rest - 300


def test_wind_costs_power(hovering):
    """Into a wind of 12 m/s hovering costs what flying at 12 m/s does."""
    inject(hovering.autopilot, "wind 12,0,0")
    hovering.fly(15)
    expected = total_power(RotaryWing(), NO_PANEL, 0.0, 12.0, 0.0, 1.0, 0.0)
    assert hovering.commander.battery.power_w == pytest.approx(expected, rel=0.03)
