import pytest
import torch

from agent.exploration import OrnsteinUhlenbeck, decayed, epsilon_greedy, random_actions


def test_noise_has_unit_variance_and_decorrelates_by_theta():
    noise = OrnsteinUhlenbeck((4000, 3), theta=0.15)
    generator = torch.Generator().manual_seed(0)
    for _ in range(60):  # 0.85^60 of the start is left
        before = noise.value
        after = noise.step(generator)
    count = after.numel()
    assert after.mean().abs() < 5 / count**0.5
    assert after.var().item() == pytest.approx(1, abs=5 * (2 / count) ** 0.5)
    assert (before * after).mean().item() == pytest.approx(0.85, abs=5 * (2 / count) ** 0.5)


def test_environments_and_dimensions_are_independent():
    noise = OrnsteinUhlenbeck((20_000, 2), theta=0.5)
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        x = noise.step(generator)
    assert (x[:, 0] * x[:, 1]).mean().abs() < 5 / 20_000**0.5


@pytest.mark.parametrize("epsilon", [0.0, 0.3, 1.0])
def test_epsilon_of_the_signs_become_random(epsilon):
    generator = torch.Generator().manual_seed(0)
    signs = torch.ones(500, 400)
    explored = epsilon_greedy(signs, epsilon, generator)
    assert set(explored.unique().tolist()) <= {-1.0, 1.0}
    flipped = (explored != signs).float().mean().item()
    assert flipped == pytest.approx(epsilon / 2, abs=5 * (0.25 / signs.numel()) ** 0.5)


def test_scale_decays_linearly_and_then_stays():
    assert decayed(0.2, 0.02, 0.0, 0.6) == 0.2
    assert decayed(0.2, 0.02, 0.3, 0.6) == pytest.approx(0.11)
    assert decayed(0.2, 0.02, 0.6, 0.6) == pytest.approx(0.02)
    assert decayed(0.2, 0.02, 1.0, 0.6) == pytest.approx(0.02)


def test_warm_up_actions_fill_the_box_and_end_in_signs():
    actions = random_actions((5000, 6), 4, torch.Generator().manual_seed(0))
    assert actions[:, :4].abs().max() <= 1
    assert actions[:, :4].var().item() == pytest.approx(1 / 3, abs=0.02)
    assert set(actions[:, 4:].unique().tolist()) == {-1.0, 1.0}
