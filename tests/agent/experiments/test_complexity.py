"""Counts by formula against the real networks: torch's FLOP counter and their parameters."""

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from agent.daddpg import DualActorDdpg, Sizes
from agent.experiments.complexity import complexities, complexity
from agent.networks import Actor
from agent.training_config import TrainingConfig


def measured(module, *inputs):
    """Twice the multiply-adds (biases and activations are free in torch's count), and parameters."""
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        module.eval()(*inputs)
    return counter.get_total_flops(), sum(parameter.numel() for parameter in module.parameters())


@pytest.mark.parametrize(("side", "hidden"), [(4, 256), (4, 384), (16, 512)])
def test_counts_are_those_of_the_networks(side, hidden):
    N = side * side
    state, continuous, discrete = 3 + 2 * (4 * N + 16 + 4 * N), 3 + 2 * N + 32, N
    counted = complexity(side, hidden)
    learner = DualActorDdpg(Sizes(state, continuous, discrete), TrainingConfig(hidden=(hidden, hidden)))
    s, a = torch.zeros(1, state), torch.zeros(1, continuous + discrete)
    for cost, network, inputs in (
        (counted.continuous, learner.continuous_actor, (s,)),
        (counted.discrete, learner.discrete_actor, (s,)),
        (counted.critic, learner.critic, (s, a)),
        (counted.ddpg_actor, Actor(state, continuous + discrete, (hidden, hidden)), (s,)),
    ):
        assert (2 * cost.multiply_adds, cost.parameters) == measured(network, *inputs)


def test_operations_by_hand_for_the_papers_sizes():
    counted = complexity(4, 256)
    dense = 291 * 256 + 256 * 256
    assert counted.continuous.operations == dense + 256 * 67 + 6 * 67 + 512 + 5 * 291
    assert counted.discrete.operations == dense + 256 * 16 + 6 * 16 + 512 + 5 * 291
    assert counted.critic.operations == dense + 83 * 256 + 512 * 256 + 256 + 4 * 256 + 5 * (291 + 83)


def test_the_sum_is_nearly_twice_the_papers_max_and_more_than_ddpg():
    for counted in complexities():
        assert counted.claimed_operations == counted.continuous.operations
        assert 1.90 < counted.actors.operations / counted.claimed_operations < 1.95
        assert counted.claimed_operations < counted.ddpg_actor.operations < counted.actors.operations
    assert complexity(4, 384).actors.operations / complexity(4, 384).claimed_operations == pytest.approx(1.93, abs=5e-3)
