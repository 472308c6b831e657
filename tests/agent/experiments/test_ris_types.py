"""The surfaces' order and gains against the design's prototype, in worlds that are the same for all."""

import pytest
import torch

from agent.experiments.intervals import ratio_interval
from agent.experiments.ris_types import SCENARIO, flight, outcome
from rf_model.reference.episode import episode_rewards
from rf_model.scenario import preset


@pytest.fixture(scope="module")
def hovering():
    return flight("hovering", 12, 1)


def gain(flown, above, below, iterations, metric="efficiency_bit_per_j", objective="harmonic"):
    pair = (outcome(flown, surface, "hovering", objective, iterations) for surface in (above, below))
    return ratio_interval(*(getattr(one, metric) for one in pair))


@pytest.mark.parametrize(("iterations", "design"), [(3, 1.16), (10, 1.215)])
def test_coupled_over_dual_hovering_is_the_designs_after_3_and_10_iterations(hovering, iterations, design):
    ratio = gain(hovering, "coupled", "dual", iterations)
    assert ratio.value == pytest.approx(design, abs=0.02 + ratio.half_width)
    assert ratio.half_width < 0.03


def test_independent_is_slightly_above_coupled(hovering):
    ratio = gain(hovering, "independent", "coupled", 40)
    assert 1.02 < ratio.value < 1.05


def test_the_gain_grows_with_the_search_and_is_larger_in_reward(hovering):
    after = [gain(hovering, "coupled", "dual", iterations).value for iterations in (1, 10, 40)]
    assert after == sorted(after)
    assert gain(hovering, "coupled", "dual", 40, "reward").value > after[-1]


def test_conventional_leaves_transmission_users_with_nothing_fair_but_beats_dual_on_the_sum(hovering):
    conventional = outcome(hovering, "conventional", "hovering", "harmonic", 40)
    coupled = outcome(hovering, "coupled", "hovering", "harmonic", 40)
    assert conventional.fair_rate_bps.mean() < 0.01 * coupled.fair_rate_bps.mean()
    assert gain(hovering, "conventional", "dual", 40, "sum_rate_bps", "sum_rate").value > 1.2


def test_greedy_flights_earn_what_the_references_own_episodes_do():
    flown = flight("greedy", 24, 2)
    ours = outcome(flown, "coupled", "greedy", "harmonic", 10).reward
    theirs = episode_rewards(preset(SCENARIO), 24, 2, 10)  # in other worlds
    error = ((ours.var() + theirs.var()) / 24) ** 0.5
    assert ours.mean().item() == pytest.approx(theirs.mean().item(), abs=3 * error.item())


def test_hovering_costs_hover_power_and_metrics_agree(hovering):
    assert torch.allclose(hovering.power_w, torch.tensor(hovering.power_w[0, 0].item(), dtype=torch.float64))
    one = outcome(hovering, "dual", "hovering", "harmonic", 1)
    assert one.efficiency_bit_per_j.numpy() == pytest.approx(
        (one.sum_rate_bps / hovering.power_w.mean(0)).numpy(), rel=1e-12
    )
    scenario = preset(SCENARIO)
    power = hovering.power_w.mean() / scenario.hover_power_w
    expected = 30 * (one.fair_rate_bps / 1e6 - 0.1 * power)
    assert one.reward.numpy() == pytest.approx(expected.numpy(), rel=1e-9)
