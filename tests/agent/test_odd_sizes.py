"""The whole loop lives with sizes that are unusual: one-sided service, more users than antennas, any panel."""

import pytest
import torch

from agent.environment import Environment
from agent.policies import RandomPolicy
from rf_model.scenario import preset


@pytest.mark.parametrize(
    "fields",
    [
        {"reflection_users": 0},
        {"reflection_users": 4},
        {"users": 1},
        {"users": 3},
        {"users": 6, "antennas": 2},
        {"antennas": 1},
        {"rows": 2, "columns": 5},
        {"rows": 1, "columns": 1},
        {"user_radius_m": (0.0, 1.0), "box_enu": ((-1, 1), (-1, 1), (2, 3)), "start_enu": (0, 0, 2)},
    ],
    ids=["P = 0", "Q = 0", "J = 1", "J odd", "M < J", "M = 1", "not square", "N = 1", "users at the surface"],
)
@pytest.mark.parametrize("region", ["geometric", "fixed"])
def test_episodes_of_odd_sizes_are_finite(fields, region):
    scenario = preset("physical_small", region=region, slots=3, **fields)
    environment = Environment(scenario, batch=3, seed=0)
    observation = environment.reset()
    policy = RandomPolicy(scenario, 0)
    for slot in range(3):
        step = environment.step(policy(observation, slot))
        observation = step.observation
        assert torch.isfinite(step.reward).all()
        assert torch.isfinite(observation).all()
        assert (step.rates.rate_bps >= 0).all()
