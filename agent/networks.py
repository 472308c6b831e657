"""The paper's networks (section "DA-DDPG Architecture"): two actors of one shape and a two-branch critic."""

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn


def dense(widths: Sequence[int]) -> nn.Sequential:
    """Dense layers with ReLU after each."""
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(widths):
        layers += [nn.Linear(inputs, outputs), nn.ReLU()]
    return nn.Sequential(*layers)


class Actor(nn.Module):
    """mu(s): batch norm on the state, dense ReLU layers, tanh output.

    The continuous actor gives 3 + 2N + 2MJ numbers (paper eq. 23a), the discrete one N (eq. 23b).
    """

    def __init__(self, state_size: int, action_size: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.norm = nn.BatchNorm1d(state_size)
        self.hidden = dense([state_size, *hidden])
        self.out = nn.Linear(hidden[-1], action_size)
        nn.init.uniform_(self.out.weight, -3e-3, 3e-3)  # starts in tanh's linear range
        nn.init.zeros_(self.out.bias)

    def pre_tanh(self, state: Tensor) -> Tensor:
        """The last layer's output [B, A], which training keeps from saturating tanh."""
        out: Tensor = self.out(self.hidden(self.norm(state)))
        return out

    def forward(self, state: Tensor) -> Tensor:
        """Raw action [B, A] in [-1, 1] for states [B, S]."""
        return torch.tanh(self.pre_tanh(state))


class Critic(nn.Module):
    """Q(s, {a_c, a_d}): a state and an action branch, each with batch norm, concatenated before the last layers."""

    def __init__(self, state_size: int, action_size: int, hidden: Sequence[int]) -> None:
        super().__init__()
        self.state_branch = nn.Sequential(nn.BatchNorm1d(state_size), dense([state_size, *hidden]))
        self.action_branch = nn.Sequential(nn.BatchNorm1d(action_size), dense([action_size, hidden[-1]]))
        self.joint = nn.Sequential(dense([2 * hidden[-1], hidden[-1]]), nn.Linear(hidden[-1], 1))

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """Q values [B] of states [B, S] and whole actions [B, A_c + A_d]."""
        branches = torch.cat([self.state_branch(state), self.action_branch(action)], dim=-1)
        q: Tensor = self.joint(branches)
        return q.squeeze(-1)
