"""Power curves against the design's table and the formulas written out again."""

import math

import numpy as np
import pytest

from agent.experiments.power_vs_speed import ELEMENTS, curves


def curve(reading, elements):
    (found,) = (one for one in curves() if (one.reading, one.elements) == (reading, elements))
    return found


def power(speed, elements, printed):
    """Eq. 16 to 18 with the paper's table; the roots of (16b) unless printed."""
    disc = 2 * 1.225 * 0.503
    v = 4.028 if printed else math.sqrt(25 / disc)
    a = speed**2 / (2 * v**2)
    blade = 1.225 * 0.012 * 0.503 * 0.05 * 120**3 / 8 * (1 + 3 * speed**2 / 120**2)
    inner = np.sqrt(1 + a**2) - a
    induced = 25**1.5 / disc * inner if printed else 25**1.5 / math.sqrt(disc) * np.sqrt(inner)
    side = math.isqrt(elements)
    area = ((side - 1) * 299792458 / 5e9 / 2) ** 2 if side else 0.0
    return blade + induced + 0.5 * 1.225 * (0.05 * 0.503 * 0.6 + 2.1 * area) * speed**3


@pytest.mark.parametrize("elements", ELEMENTS)
@pytest.mark.parametrize("reading", ["sqrt", "printed"])
def test_curves_are_the_equations(reading, elements):
    found = curve(reading, elements)
    expected = power(found.speed_mps.numpy(), elements, reading == "printed")
    assert found.power_w.numpy() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(("elements", "speed"), [(0, 19.0), (16, 15.3), (64, 10.8), (256, 7.15), (1024, 4.5)])
def test_maximum_range_is_the_designs(elements, speed):
    found = curve("sqrt", elements)
    assert found.speed_mps[found.range].item() == pytest.approx(speed, abs=0.05)


@pytest.mark.parametrize("elements", ELEMENTS)
@pytest.mark.parametrize("reading", ["sqrt", "printed"])
def test_markers_are_where_slopes_vanish(reading, elements):
    found = curve(reading, elements)
    endurance, furthest = (found.speed_mps[index].item() for index in (found.endurance, found.range))

    def slope(function, at):
        return (function(at + 1e-4) - function(at - 1e-4)) / 2e-4

    def watts(speed):
        return power(speed, elements, reading == "printed")

    step = 0.001
    assert slope(watts, endurance - step) < 0 < slope(watts, endurance + step)
    assert slope(lambda v: watts(v) / v, furthest - step) < 0 < slope(lambda v: watts(v) / v, furthest + step)
