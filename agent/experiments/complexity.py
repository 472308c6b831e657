"""What a pass through the networks costs (paper section "Complexity analysis"), counted by its formula."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from agent.decoding import continuous_size, discrete_size
from agent.observation import state_size
from rf_model.scenario import preset

TANH, RELU, BATCH_NORM = 6, 1, 5
"""Operations a node, as the paper counts them."""
SIDES = (4, 16)
"""Of the surface: N = 16 is the paper's, 256 the default's."""
HIDDEN = (256, 384, 512)
"""The paper has 256 to 512 neurons in both hidden layers."""


@dataclass(frozen=True)
class Cost:
    """One pass of one input through a network, and its size."""

    multiply_adds: int
    """Sum of theta_i theta_i+1 over the dense layers."""
    tanh: int
    relu: int
    batch_norm: int
    """Nodes of each kind."""
    parameters: int
    """Weights and biases of the dense layers, scale and shift of batch norm."""

    @property
    def operations(self) -> int:
        """The paper's count: a multiplication with its addition is one operation, biases cost nothing."""
        return self.multiply_adds + TANH * self.tanh + RELU * self.relu + BATCH_NORM * self.batch_norm

    def __add__(self, other: "Cost") -> "Cost":
        return Cost(
            self.multiply_adds + other.multiply_adds,
            self.tanh + other.tanh,
            self.relu + other.relu,
            self.batch_norm + other.batch_norm,
            self.parameters + other.parameters,
        )


@dataclass(frozen=True)
class Complexity:
    """Networks of DA-DDPG, and the one actor of DDPG, for one size of surface and of hidden layer."""

    elements: int
    hidden: int
    continuous: Cost
    discrete: Cost
    critic: Cost
    ddpg_actor: Cost
    """One actor of the same shape for both halves of the action."""

    @property
    def claimed_operations(self) -> int:
        """max(C_c, C_d): the paper's complexity of the two actors."""
        return max(self.continuous.operations, self.discrete.operations)

    @property
    def actors(self) -> Cost:
        """Both actors: what is computed, one after the other or side by side."""
        return self.continuous + self.discrete


def complexities() -> list[Complexity]:
    """For every size of surface (M = J = 4) and of hidden layer."""
    return [complexity(side, hidden) for side in SIDES for hidden in HIDDEN]


def complexity(side: int, hidden: int) -> Complexity:
    """For a coupled surface of side x side elements and two hidden layers."""
    scenario = preset("physical_1km", rows=side, columns=side)
    state, continuous, discrete = state_size(scenario), continuous_size(scenario), discrete_size(scenario)
    return Complexity(
        elements=scenario.elements,
        hidden=hidden,
        continuous=actor_cost(state, continuous, (hidden, hidden)),
        discrete=actor_cost(state, discrete, (hidden, hidden)),
        critic=critic_cost(state, continuous + discrete, (hidden, hidden)),
        ddpg_actor=actor_cost(state, continuous + discrete, (hidden, hidden)),
    )


def actor_cost(state: int, action: int, hidden: Sequence[int]) -> Cost:
    """Of `agent.networks.Actor`: batch norm, dense ReLU layers, a dense tanh layer."""
    return _norm(state) + _dense((state, *hidden)) + _layer(hidden[-1], action, tanh=action)


def critic_cost(state: int, action: int, hidden: Sequence[int]) -> Cost:
    """Of `agent.networks.Critic`: a state and an action branch, joined before the last two layers."""
    state_branch = _norm(state) + _dense((state, *hidden))
    action_branch = _norm(action) + _dense((action, hidden[-1]))
    return state_branch + action_branch + _dense((2 * hidden[-1], hidden[-1])) + _layer(hidden[-1], 1)


def _norm(nodes: int) -> Cost:
    return Cost(multiply_adds=0, tanh=0, relu=0, batch_norm=nodes, parameters=2 * nodes)


def _dense(widths: Sequence[int]) -> Cost:
    cost = Cost(0, 0, 0, 0, 0)
    for inputs, outputs in itertools.pairwise(widths):
        cost += _layer(inputs, outputs, relu=outputs)
    return cost


def _layer(inputs: int, outputs: int, tanh: int = 0, relu: int = 0) -> Cost:
    return Cost(inputs * outputs, tanh, relu, 0, parameters=(inputs + 1) * outputs)
