"""Power of the rotary wing and its panel against published figures and closed forms."""

import math

import numba
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airframe.power import (
    NO_PANEL,
    ZENG_2019,
    Panel,
    RotaryWing,
    drag_force,
    hover_induced_velocity,
    hover_power,
    panel_area_m2,
    power_terms,
    total_power,
)

PAPER_WING = RotaryWing()
SPACING_M = 0.03  # lambda / 2 at 5 GHz
speeds = st.floats(-30, 30)
wings = st.tuples(
    st.floats(1, 200), st.sampled_from(["sqrt", "paper", "zeng"]), st.sampled_from(["nonnegative", "signed"])
).map(lambda drawn: RotaryWing(weight_n=drawn[0], induced=drawn[1], climb=drawn[2]))


def forward_power(wing: RotaryWing, panel: Panel, speed):
    return total_power(wing, panel, speed, 0.0, 0.0, 1.0, 0.0)


def square_panel(elements: int) -> Panel:
    side = math.isqrt(elements)
    return Panel(area_m2=panel_area_m2(side, side, SPACING_M), v_perp="speed")


def test_zeng_2019_hover():
    terms = power_terms(ZENG_2019, NO_PANEL, 0.0, 0.0, 0.0, 1.0, 0.0)
    assert terms.blade == pytest.approx(79.8563, abs=5e-5)
    assert terms.induced == pytest.approx(88.6279, abs=5e-5)
    assert ZENG_2019.induced_velocity_mps == pytest.approx(4.0285, abs=5e-5)


@pytest.mark.parametrize(
    ("speed", "watts"),
    [(5, 143.595), (10, 126.017), (15, 138.535), (20, 178.289), (25, 248.947), (30, 356.280)],
)
def test_zeng_2019_forward_flight(speed, watts):
    assert forward_power(ZENG_2019, NO_PANEL, float(speed)) == pytest.approx(watts, abs=5e-4)


def test_zeng_2019_maximum_endurance_and_range():
    speed = np.linspace(1, 30, 29001)
    power = forward_power(ZENG_2019, NO_PANEL, speed)
    assert speed[power.argmin()] == pytest.approx(10.21, abs=0.01)
    assert speed[(power / speed).argmin()] == pytest.approx(18.29, abs=0.01)


def test_paper_wing_hovers_on_192_watts():
    assert hover_power(PAPER_WING) == pytest.approx(192.5, abs=0.05)
    assert PAPER_WING.induced_velocity_mps == pytest.approx(4.504, abs=5e-4)


@pytest.mark.parametrize(("elements", "watts"), [(0, 140.5), (16, 150.9), (256, 401.0)])
def test_panel_seen_face_on_at_ten_metres_per_second(elements, watts):
    panel = square_panel(elements)._replace(v_perp="normal") if elements else NO_PANEL
    assert forward_power(PAPER_WING, panel, 10.0) == pytest.approx(watts, abs=0.05)


@pytest.mark.parametrize(("elements", "speed"), [(0, 19.0), (16, 15.3), (64, 10.8), (256, 7.15), (1024, 4.5)])
def test_maximum_range_falls_with_the_panel(elements, speed):
    grid = np.linspace(1, 30, 29001)
    panel = square_panel(elements) if elements else NO_PANEL
    assert grid[(forward_power(PAPER_WING, panel, grid) / grid).argmin()] == pytest.approx(speed, abs=0.05)


def test_edge_on_panel_costs_nothing_unless_drag_is_read_by_speed():
    panel = Panel(area_m2=0.2)
    sideways = power_terms(PAPER_WING, panel, 0.0, 10.0, 0.0, 1.0, 0.0)
    assert sideways.panel_drag == 0
    by_speed = power_terms(PAPER_WING, panel._replace(v_perp="speed"), 0.0, 10.0, 0.0, 1.0, 0.0)
    assert by_speed.panel_drag == pytest.approx(0.5 * 1.225 * 0.2 * 2.1 * 1000)


def test_printed_induced_power_lacks_both_roots():
    printed = power_terms(PAPER_WING._replace(induced="paper"), NO_PANEL, 10.0, 0.0, 0.0, 1.0, 0.0).induced
    disc = 2 * 1.225 * 0.503
    v = PAPER_WING.induced_velocity_mps
    assert printed == pytest.approx(25**1.5 / disc * (math.sqrt(10**4 / (4 * v**4) + 1) - 10**2 / (2 * v**2)))


def test_climb_is_weight_times_rate_and_descent_is_free_or_signed():
    def climb(wing: RotaryWing, rate: float) -> float:
        return float(power_terms(wing, NO_PANEL, 3.0, 0.0, rate, 1.0, 0.0).climb)

    assert climb(PAPER_WING, 2.0) == 50.0
    assert climb(PAPER_WING, -2.0) == 0.0
    assert climb(PAPER_WING._replace(climb="signed"), -2.0) == -50.0


def test_panel_area_by_eq_17_and_in_full():
    assert panel_area_m2(4, 4, SPACING_M) == pytest.approx(9 * SPACING_M**2)
    assert panel_area_m2(4, 8, SPACING_M, "full") == pytest.approx(32 * SPACING_M**2)


def test_induced_velocity_of_20_newton_is_the_one_printed():
    assert hover_induced_velocity(20.0, 1.225, 0.503) == pytest.approx(4.028, abs=1e-3)


@given(wings, speeds, speeds, speeds, st.floats(-math.pi, math.pi), st.sampled_from(["normal", "speed"]))
@settings(deadline=None)
def test_floats_and_tensors_agree(wing, x, y, z, heading, v_perp):
    panel = Panel(area_m2=0.2, v_perp=v_perp)
    nx, ny = math.cos(heading), math.sin(heading)
    tensor = total_power(wing, panel, *(torch.tensor([v, v], dtype=torch.float64) for v in (x, y, z)), nx, ny)
    assert tensor.tolist() == pytest.approx([total_power(wing, panel, x, y, z, nx, ny)] * 2, rel=1e-12)


def test_compiled_terms_agree():
    compiled = numba.njit(power_terms)
    for induced in ("sqrt", "paper", "zeng"):
        wing = PAPER_WING._replace(induced=induced)
        arguments = (wing, Panel(area_m2=0.2), 7.0, -3.0, 1.0, 0.6, 0.8)
        assert compiled(*arguments) == pytest.approx(power_terms(*arguments), rel=1e-12)


@given(speeds, speeds, speeds)
@settings(deadline=None)
def test_default_power_never_falls_below_what_level_flight_costs(x, y, z):
    panel = Panel(area_m2=0.2)
    level = total_power(PAPER_WING, panel, x, y, 0.0, 1.0, 0.0)
    assert total_power(PAPER_WING, panel, x, y, z, 1.0, 0.0) >= level > 100.0


def test_float32_stays_finite_at_high_speed_and_gradient_at_rest():
    fast = total_power(PAPER_WING, NO_PANEL, torch.tensor([1.0, 30.0, 300.0]), 0.0, 0.0, 1.0, 0.0)
    assert torch.isfinite(fast).all()
    velocity = torch.zeros(3, requires_grad=True)
    total_power(PAPER_WING, Panel(area_m2=0.2), velocity[0], velocity[1], velocity[2], 1.0, 0.0).backward()
    assert torch.isfinite(velocity.grad).all()


@given(wings, speeds, speeds, st.floats(-math.pi, math.pi), st.sampled_from(["normal", "speed"]))
@settings(deadline=None)
def test_drag_force_times_velocity_is_the_power_that_drag_takes(wing, x, y, heading, v_perp):
    panel = Panel(area_m2=0.2, v_perp=v_perp)
    normal = (math.cos(heading), math.sin(heading))
    terms = power_terms(wing, panel, x, y, 0.0, *normal)
    fx, fy = drag_force(wing, panel, x, y, *normal)
    assert fx * x + fy * y == pytest.approx(terms.parasite + terms.panel_drag, rel=1e-6, abs=1e-6)


def test_panel_is_pushed_along_its_normal_only():
    fx, fy = drag_force(PAPER_WING._replace(fuselage_drag_ratio=0.0), Panel(area_m2=0.2), 3.0, 4.0, 1.0, 0.0)
    assert fx == pytest.approx(0.5 * 1.225 * 0.2 * 2.1 * 9)
    assert fy == 0
