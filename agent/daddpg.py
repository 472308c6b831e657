"""Dual-actor DDPG (paper section "Proposed Solution", Alg. 1): the whole update in one place."""

import copy
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from agent.networks import Actor, Critic
from agent.replay_buffer import Batch
from agent.training_config import TrainingConfig


@dataclass(frozen=True)
class Sizes:
    """What the networks' shapes follow from."""

    state: int
    continuous: int
    """3 + 2N + 2MJ"""
    discrete: int
    """N, or 0 for surfaces without signs; then the discrete actor says nothing and learns nothing."""

    @property
    def action(self) -> int:
        return self.continuous + self.discrete


@dataclass(frozen=True)
class Losses:
    """What one update saw; detached scalars."""

    critic: Tensor
    continuous_actor: Tensor
    discrete_actor: Tensor | None
    """None without a discrete half."""
    q: Tensor
    """Mean Q of the replayed actions."""


def signs(raw: Tensor) -> Tensor:
    """Threshold at 0 (eq. 30): +1 where raw > 0, else -1."""
    return torch.where(raw > 0, 1.0, -1.0)


class DualActorDdpg:
    """Two actors, one critic, their targets and optimisers."""

    def __init__(self, sizes: Sizes, config: TrainingConfig) -> None:
        """Initial weights follow from `config.seed` alone."""
        self.sizes = sizes
        self.config = config
        with torch.random.fork_rng():  # torch's initialisers know only the global generator
            torch.manual_seed(config.seed)
            self.continuous_actor = Actor(sizes.state, sizes.continuous, config.hidden)
            self.discrete_actor = Actor(sizes.state, sizes.discrete, config.hidden)
            self.critic = Critic(sizes.state, sizes.action, config.hidden)
        self.target_continuous_actor = copy.deepcopy(self.continuous_actor).eval().requires_grad_(False)
        self.target_discrete_actor = copy.deepcopy(self.discrete_actor).eval().requires_grad_(False)
        self.target_critic = copy.deepcopy(self.critic).eval().requires_grad_(False)
        self.continuous_optimiser = torch.optim.Adam(self.continuous_actor.parameters(), config.actor_lr, fused=True)
        self.discrete_optimiser = torch.optim.Adam(self.discrete_actor.parameters(), config.actor_lr, fused=True)
        self.critic_optimiser = torch.optim.Adam(self.critic.parameters(), config.critic_lr, fused=True)

    def act(self, observation: Tensor) -> Tensor:
        """Whole raw action [B, A] of the current actors, the discrete half as signs; no exploration."""
        self.continuous_actor.eval()
        self.discrete_actor.eval()
        with torch.no_grad():
            return torch.cat(
                [self.continuous_actor(observation), signs(self.discrete_actor(observation))],
                dim=-1,
            )

    def update(self, batch: Batch, cloning: float = 0.0) -> Losses:
        """One step of the critic, of both actors and of the targets on a batch from replay.

        `cloning` > 0 adds the imitation loss to the actors', with this weight relative to |Q|, for learning offline.
        """
        config = self.config
        continuous = batch.action[:, : self.sizes.continuous]
        discrete = batch.action[:, self.sizes.continuous :]

        # Critic: minimise (26) towards the target (27).
        state = batch.next_observation if config.target_state == "next" else batch.observation
        with torch.no_grad():
            action = torch.cat([self.target_continuous_actor(state), signs(self.target_discrete_actor(state))], dim=-1)
            bootstrap = (1 - batch.terminated) * self.target_critic(state, action)
            target = config.reward_scale * batch.reward + config.discount * bootstrap
        self.critic.train()
        q = self.critic(batch.observation, batch.action)
        critic_loss = functional.mse_loss(q, target)
        self.critic_optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(critic_loss)
        self.critic_optimiser.step()

        # Actors: ascend Q (28). The critic stands still and normalises by its running statistics.
        self.critic.eval().requires_grad_(False)
        self.continuous_actor.train()
        self.discrete_actor.train()
        pre_continuous = self.continuous_actor.pre_tanh(batch.observation)
        pre_discrete = self.discrete_actor.pre_tanh(batch.observation)
        own_continuous = torch.tanh(pre_continuous)
        own_discrete = torch.tanh(pre_discrete)
        if config.discrete_gradient == "straight_through":
            own_discrete = own_discrete + (signs(own_discrete) - own_discrete).detach()
        value_discrete: Tensor | None = None
        if config.actor_update == "replay_other" and self.sizes.discrete:
            value_continuous = self.critic(batch.observation, torch.cat([own_continuous, discrete], dim=-1))
            value_discrete = self.critic(batch.observation, torch.cat([continuous, own_discrete], dim=-1))
            value = value_continuous.mean() + value_discrete.mean()
        else:
            value_continuous = self.critic(batch.observation, torch.cat([own_continuous, own_discrete], dim=-1))
            if self.sizes.discrete:
                value_discrete = value_continuous
            value = value_continuous.mean()
        actor_loss = -value + config.saturation_penalty * (
            pre_continuous.square().mean() + _mean(pre_discrete.square())
        )
        if cloning > 0:
            actor_loss = actor_loss + cloning * value.abs().detach() * imitation(
                pre_continuous, pre_discrete, continuous, discrete
            )
        self.continuous_optimiser.zero_grad(set_to_none=True)
        self.discrete_optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(actor_loss)
        self.continuous_optimiser.step()
        self.discrete_optimiser.step()
        self.critic.requires_grad_(True)

        for target_network, network in self._pairs():
            soft_update(target_network, network, config.soft_update)
        return Losses(
            critic=critic_loss.detach(),
            continuous_actor=-value_continuous.detach().mean(),
            discrete_actor=None if value_discrete is None else -value_discrete.detach().mean(),
            q=q.detach().mean(),
        )

    def clone(self, batch: Batch) -> Tensor:
        """One step of both actors towards the executed actions; returns the loss. The targets follow."""
        self.continuous_actor.train()
        self.discrete_actor.train()
        loss = imitation(
            self.continuous_actor.pre_tanh(batch.observation),
            self.discrete_actor.pre_tanh(batch.observation),
            batch.action[:, : self.sizes.continuous],
            batch.action[:, self.sizes.continuous :],
        )
        self.continuous_optimiser.zero_grad(set_to_none=True)
        self.discrete_optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        self.continuous_optimiser.step()
        self.discrete_optimiser.step()
        for target_network, network in self._pairs():
            soft_update(target_network, network, self.config.soft_update)
        return loss.detach()

    def modules(self) -> dict[str, nn.Module]:
        """All networks by name."""
        return {
            "continuous_actor": self.continuous_actor,
            "discrete_actor": self.discrete_actor,
            "critic": self.critic,
            "target_continuous_actor": self.target_continuous_actor,
            "target_discrete_actor": self.target_discrete_actor,
            "target_critic": self.target_critic,
        }

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """All optimisers by the name of what they train."""
        return {
            "continuous_actor": self.continuous_optimiser,
            "discrete_actor": self.discrete_optimiser,
            "critic": self.critic_optimiser,
        }

    def _pairs(self) -> list[tuple[nn.Module, nn.Module]]:
        return [
            (self.target_continuous_actor, self.continuous_actor),
            (self.target_discrete_actor, self.discrete_actor),
            (self.target_critic, self.critic),
        ]


def imitation(pre_continuous: Tensor, pre_discrete: Tensor, continuous: Tensor, discrete: Tensor) -> Tensor:
    """Cloning loss: squared error of the continuous half, logistic loss of the signs (tanh z = 2 sigmoid(2z) - 1)."""
    error = functional.mse_loss(torch.tanh(pre_continuous), continuous)
    return error + _mean(functional.soft_margin_loss(2 * pre_discrete, discrete, reduction="none"))


def _mean(values: Tensor) -> Tensor:
    """The mean; of nothing 0, which is what surfaces without signs have in place of a discrete half."""
    return values.mean() if values.numel() else values.sum()


def soft_update(target: nn.Module, source: nn.Module, tau: float) -> None:
    """w' <- (1 - tau) w' + tau w for weights; batch norm's running statistics are copied, being averages already."""
    with torch.no_grad():
        torch._foreach_lerp_(list(target.parameters()), list(source.parameters()), tau)
        for ours, theirs in zip(target.buffers(), source.buffers(), strict=True):
            ours.copy_(theirs)
