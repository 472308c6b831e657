"""Judging a policy on fixed seeds."""

import math
from dataclasses import dataclass

from torch import Tensor

from agent.environment import Environment
from agent.policies import HoverPolicy, RandomPolicy
from agent.policy import Policy
from rf_model.scenario import Scenario


@dataclass(frozen=True)
class Evaluation:
    """Episode rewards of one policy."""

    rewards: Tensor
    """[episodes], sum over the slots."""

    @property
    def mean(self) -> float:
        return float(self.rewards.mean())

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval of the mean (normal approximation)."""
        return 1.96 * float(self.rewards.std()) / math.sqrt(len(self.rewards))

    def __str__(self) -> str:
        return f"{self.mean:.2f} ± {self.half_width:.2f}"

    def summary(self) -> dict[str, float]:
        """For JSON."""
        return {"mean": self.mean, "half_width_95": self.half_width, "episodes": len(self.rewards)}


def evaluate(
    policy: Policy, scenario: Scenario, episodes: int, seed: int, acceleration_mps2: float | None = None
) -> Evaluation:
    """Fly `episodes` whole episodes side by side, in the worlds that `seed` gives, without exploration."""
    environment = Environment(scenario, episodes, seed, acceleration_mps2)
    observation = environment.reset()
    total = observation.new_zeros(episodes)
    for slot in range(scenario.slots):
        step = environment.step(policy(observation, slot))
        total += step.reward
        observation = step.observation
    return Evaluation(total)


def baselines(
    scenario: Scenario, episodes: int, seed: int, acceleration_mps2: float | None = None
) -> dict[str, Evaluation]:
    """What no learning gives in the same worlds."""
    return {
        policy.name: evaluate(policy, scenario, episodes, seed, acceleration_mps2)
        for policy in (RandomPolicy(scenario, seed), HoverPolicy(scenario))
    }
