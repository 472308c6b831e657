"""Efficiency against the surface's size: the design's optima, and the statistics behind them."""

import numpy as np
import pytest
import torch

from agent.experiments.efficiency_vs_elements import Best, Size, best, power_w, sizes
from agent.experiments.intervals import mean_interval, ratio_interval


@pytest.fixture(scope="module")
def found():
    return sizes(32, 1)


def bests(found, method):
    return [one for one in best(found, 1) if one.method == method]


@pytest.mark.parametrize(("elements", "watts"), [(16, 150.9), (256, 401.0)])
def test_power_is_that_of_flight_face_on(elements, watts):
    assert power_w(elements, 10.0) == pytest.approx(watts, abs=0.5)
    assert power_w(elements, 0.0) == pytest.approx(192.5, abs=0.05)


@pytest.mark.parametrize("method", ["closed_form", "sum_rate"])
def test_best_size_is_near_the_designs_and_falls_with_speed(found, method):
    at_rest, *moving = bests(found, method)
    assert not at_rest.interior
    assert all(one.interior for one in moving)
    elements = [one.elements for one in moving]
    assert elements == sorted(elements, reverse=True)
    assert elements[0] > elements[-1]
    for one, design in zip(moving[1:], (256, 144, 100), strict=True):
        by_size = {size.elements: size.sum_rate_bps.value / power_w(size.elements, one.speed_mps)
                   for size in found if size.method == method}  # fmt: skip
        assert by_size[design] > 0.95 * by_size[one.elements]
        assert 0.5 * design <= one.elements <= 2 * design


def test_evenly_served_users_want_surfaces_far_larger(found):
    for served, plain in zip(bests(found, "harmonic"), bests(found, "closed_form"), strict=True):
        assert served.elements >= plain.elements
    at_ten = bests(found, "harmonic")[3]
    assert at_ten.elements >= 1024


def test_bootstrap_interval_spans_what_worlds_disagree_on():
    agreed = torch.ones(16, 50, dtype=torch.float64) * torch.tensor([n**0.5 for n in range(16)]).unsqueeze(-1)
    made = [Size("closed_form", (2 * n + 4) ** 2, rates) for n, rates in enumerate(agreed)]
    made += [Size(method, size.elements, size.sum_rates_bps) for method in ("sum_rate", "harmonic") for size in made]
    for one in best(made, 0):
        assert isinstance(one, Best)
        assert one.low == one.elements == one.high
    noisy = torch.rand(16, 50, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    split = [
        Size(method, (2 * n + 4) ** 2, rates + 1)
        for method in ("closed_form", "sum_rate", "harmonic")
        for n, rates in enumerate(noisy)
    ]
    assert any(one.low < one.high for one in best(split, 0))


def test_intervals_cover_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(0)
    covered = [0, 0]
    for _ in range(1000):
        below = torch.from_numpy(rng.gamma(9, 1, 64))
        above = 1.2 * below + torch.from_numpy(rng.normal(0, 1, 64))
        for kind, (interval, truth) in enumerate(((mean_interval(below), 9.0), (ratio_interval(above, below), 1.2))):
            covered[kind] += abs(interval.value - truth) <= interval.half_width
    assert covered[0] / 1000 == pytest.approx(0.95, abs=0.025)
    assert covered[1] / 1000 == pytest.approx(0.95, abs=0.025)
