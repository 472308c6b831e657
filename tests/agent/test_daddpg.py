"""The update rule against the paper's equations, written out a second time in plain steps."""

import copy

import pytest
import torch
from torch import Tensor

from agent.daddpg import DualActorDdpg, Sizes, signs, soft_update
from agent.networks import Actor, Critic
from agent.replay_buffer import Batch
from agent.training_config import TrainingConfig

SIZES = Sizes(state=6, continuous=4, discrete=3)


def agent_with(**changes) -> DualActorDdpg:
    return DualActorDdpg(SIZES, TrainingConfig(hidden=(32, 16), **changes))


def random_batch(count: int = 64, seed: int = 0, terminated: float = 0.0) -> Batch:
    generator = torch.Generator().manual_seed(seed)
    action = torch.rand(count, 7, generator=generator) * 2 - 1
    action[:, 4:] = signs(action[:, 4:])
    return Batch(
        observation=torch.randn(count, 6, generator=generator),
        action=action,
        reward=torch.randn(count, generator=generator),
        next_observation=torch.randn(count, 6, generator=generator),
        terminated=torch.full((count,), terminated),
    )


def weights(network: torch.nn.Module) -> list[Tensor]:
    return [parameter.detach().clone() for parameter in network.parameters()]


def same(first: list[Tensor], second: list[Tensor]) -> bool:
    return all(torch.equal(a, b) for a, b in zip(first, second, strict=True))


@pytest.mark.parametrize(("target_state", "terminated"), [("next", 0.0), ("next", 1.0), ("current", 0.0)])
def test_critic_loss_is_eq_26_towards_eq_27(target_state, terminated):
    agent = agent_with(target_state=target_state, discount=0.9, reward_scale=0.5)
    batch = random_batch(terminated=terminated)
    state = batch.next_observation if target_state == "next" else batch.observation
    before = copy.deepcopy(agent)
    losses = agent.update(batch)
    with torch.no_grad():
        action = torch.cat(
            [
                before.target_continuous_actor(state),
                torch.sign(before.target_discrete_actor(state)),
            ],
            dim=1,
        )
        y = 0.5 * batch.reward + 0.9 * (1 - terminated) * before.target_critic(state, action)
        q = before.critic.train()(batch.observation, batch.action)
    assert losses.critic.item() == pytest.approx(((y - q) ** 2).mean().item(), rel=1e-5)


def test_critic_loss_falls_on_a_fixed_batch():
    agent = agent_with(discount=0.0)
    batch = random_batch()
    losses = [agent.update(batch).critic.item() for _ in range(300)]
    assert losses[-1] < 0.05 * losses[0]


@pytest.mark.parametrize("gradient", ["straight_through", "tanh"])
def test_replay_other_gives_each_actor_the_other_half_from_replay(gradient):
    """Eq. 28 by hand: one separate loss per actor, the other half as stored."""
    agent = agent_with(discrete_gradient=gradient, saturation_penalty=0.0)
    batch = random_batch()
    agent.update(batch)  # gives batch norm some statistics
    critic = copy.deepcopy(agent)  # the critic as it will be after its own step
    critic.update(batch)
    judge = critic.critic.eval()
    continuous, discrete = copy.deepcopy(agent.continuous_actor).train(), copy.deepcopy(agent.discrete_actor).train()

    loss = -judge(batch.observation, torch.cat([continuous(batch.observation), batch.action[:, 4:]], 1)).mean()
    loss.backward()
    own = discrete(batch.observation)
    half = own + (torch.sign(own) - own).detach() if gradient == "straight_through" else own
    loss = -judge(batch.observation, torch.cat([batch.action[:, :4], half], 1)).mean()
    loss.backward()

    agent.update(batch)
    for ours, reference in (
        (agent.continuous_actor, continuous),
        (agent.discrete_actor, discrete),
    ):
        for a, b in zip(ours.parameters(), reference.parameters(), strict=True):
            torch.testing.assert_close(a.grad, b.grad, rtol=1e-4, atol=1e-7)


def test_joint_update_feeds_both_fresh_halves():
    agent = agent_with(actor_update="joint", saturation_penalty=0.0, discrete_gradient="tanh")
    batch = random_batch()
    agent.update(batch)
    critic = copy.deepcopy(agent)
    critic.update(batch)
    continuous, discrete = copy.deepcopy(agent.continuous_actor).train(), copy.deepcopy(agent.discrete_actor).train()
    action = torch.cat([continuous(batch.observation), discrete(batch.observation)], 1)
    (-critic.critic.eval()(batch.observation, action).mean()).backward()
    agent.update(batch)
    for a, b in zip(agent.discrete_actor.parameters(), discrete.parameters(), strict=True):
        torch.testing.assert_close(a.grad, b.grad, rtol=1e-4, atol=1e-7)


def test_with_replay_other_an_actor_never_feels_the_other():
    """Another discrete actor changes nothing of what the continuous one learns."""
    first, second = agent_with(), agent_with()
    with torch.no_grad():
        for parameter in second.discrete_actor.parameters():
            parameter.mul_(-1.5)
    batch = random_batch(terminated=1.0)  # terminated: the target does not see the actors either
    for agent in (first, second):
        agent.update(batch)
    assert same(weights(first.continuous_actor), weights(second.continuous_actor))
    assert not same(weights(first.discrete_actor), weights(second.discrete_actor))


def test_actors_learn_to_ascend_a_known_value():
    """Reward -|a_c - 0.5|^2 + sum of signs: both halves must find the optimum of a one-step problem."""
    agent = DualActorDdpg(SIZES, TrainingConfig(hidden=(64, 64), discount=0.0, actor_lr=1e-3))
    generator = torch.Generator().manual_seed(0)
    for _ in range(1200):
        observation = torch.randn(64, 6, generator=generator)
        action = torch.rand(64, 7, generator=generator) * 2 - 1
        action[:, 4:] = signs(action[:, 4:])
        reward = -(action[:, :4] - 0.5).square().sum(1) + action[:, 4:].sum(1)
        agent.update(Batch(observation, action, reward, observation, torch.ones(64)))
    action = agent.act(torch.randn(200, 6, generator=generator))
    assert (action[:, :4] - 0.5).abs().mean() < 0.15
    assert (action[:, 4:] == 1).float().mean() > 0.95


def test_the_penalty_pulls_pre_tanh_outputs_back():
    pre = {}
    for penalty in (0.0, 0.1):
        agent = agent_with(saturation_penalty=penalty, discount=0.0, actor_lr=1e-3)
        generator = torch.Generator().manual_seed(0)
        for _ in range(400):
            observation = torch.randn(64, 6, generator=generator)
            action = torch.rand(64, 7, generator=generator) * 2 - 1
            agent.update(Batch(observation, action, action.sum(1), observation, torch.ones(64)))
        agent.continuous_actor.eval()
        pre[penalty] = agent.continuous_actor.pre_tanh(observation).abs().mean().item()
    assert pre[0.1] < 0.5 * pre[0.0]


def test_soft_update_is_a_weighted_mean_and_copies_running_statistics():
    torch.manual_seed(0)
    target, source = Actor(6, 4, (8,)), Actor(6, 4, (8,))
    source(torch.randn(32, 6))
    expected = [0.9 * t + 0.1 * s for t, s in zip(weights(target), weights(source), strict=True)]
    soft_update(target, source, 0.1)
    for ours, wanted in zip(weights(target), expected, strict=True):
        torch.testing.assert_close(ours, wanted)
    assert torch.equal(target.norm.running_mean, source.norm.running_mean)


def test_targets_trail_their_networks_by_tau():
    agent = agent_with(soft_update=0.25)
    before = weights(agent.target_critic)
    agent.update(random_batch())
    for old, new, network in zip(before, weights(agent.target_critic), weights(agent.critic), strict=True):
        torch.testing.assert_close(new, 0.75 * old + 0.25 * network)


def test_same_seed_same_weights_and_the_global_generator_is_left_alone():
    state = torch.random.get_rng_state()
    first, second, other = agent_with(seed=1), agent_with(seed=1), agent_with(seed=2)
    assert torch.equal(state, torch.random.get_rng_state())
    assert same(weights(first.critic), weights(second.critic))
    assert not same(weights(first.critic), weights(other.critic))


def test_architecture_is_the_papers():
    actor, critic = Actor(291, 67, (512, 256)), Critic(291, 83, (512, 256))
    assert isinstance(actor.norm, torch.nn.BatchNorm1d)
    raw = actor(100 * torch.randn(16, 291))
    assert raw.shape == (16, 67)
    assert raw.abs().max() <= 1
    assert critic(torch.randn(16, 291), torch.randn(16, 83)).shape == (16,)


def test_acting_keeps_batch_norm_still_and_gives_signs():
    agent = agent_with()
    agent.update(random_batch())
    mean = agent.continuous_actor.norm.running_mean.clone()
    action = agent.act(torch.randn(5, 6))
    assert torch.equal(mean, agent.continuous_actor.norm.running_mean)
    assert set(action[:, 4:].unique().tolist()) <= {-1.0, 1.0}
    torch.testing.assert_close(agent.act(torch.ones(1, 6)), agent.act(torch.ones(3, 6))[:1])


@pytest.mark.parametrize("changes", [{}, {"actor_update": "joint"}, {"saturation_penalty": 0.1}])
def test_without_signs_all_losses_are_those_of_the_continuous_half(changes):
    """Surfaces without signs (independent, dual, conventional): an update and a clone of a single actor, by hand."""
    agent = DualActorDdpg(
        Sizes(state=6, continuous=4, discrete=0),
        TrainingConfig(hidden=(32, 16), **({"saturation_penalty": 0.0} | changes)),
    )
    full = random_batch()
    batch = Batch(full.observation, full.action[:, :4], full.reward, full.next_observation, full.terminated)
    agent.update(batch)  # gives batch norm some statistics
    after = copy.deepcopy(agent)
    after.update(batch)
    judge, actor = after.critic.eval(), copy.deepcopy(agent.continuous_actor).train()
    pre = actor.pre_tanh(batch.observation)
    value = judge(batch.observation, torch.tanh(pre)).mean()
    (changes.get("saturation_penalty", 0.0) * pre.square().mean() - value).backward()

    losses = agent.update(batch)
    assert losses.discrete_actor is None
    assert losses.continuous_actor.item() == pytest.approx(-value.item(), rel=1e-5)
    for ours, reference in zip(agent.continuous_actor.parameters(), actor.parameters(), strict=True):
        torch.testing.assert_close(ours.grad, reference.grad, rtol=1e-4, atol=1e-7)

    imitated = copy.deepcopy(agent.continuous_actor).train()(batch.observation)
    assert agent.clone(batch).item() == pytest.approx((imitated - batch.action).square().mean().item(), rel=1e-5)
    assert all(torch.isfinite(weight).all() for module in agent.modules().values() for weight in module.parameters())
