"""The policy that comes with the package is worth flying."""

import math

import pytest

from agent.checkpoint import read_metadata
from agent.evaluation import baselines, evaluate
from agent.policies import TrainedPolicy
from agent.policy import SHIPPED_FOLDER, PolicyConfig, shipped_checkpoints
from rf_model.scenario import Scenario, preset

SEED = 20_261_122
"""Worlds of neither training nor selection."""


@pytest.fixture(scope="module", params=shipped_checkpoints())
def shipped(request) -> tuple[TrainedPolicy, Scenario]:
    scenario = preset(request.param)
    path = PolicyConfig(checkpoint=request.param).checkpoint_path
    assert path is not None
    return TrainedPolicy(path, scenario), scenario


def test_there_is_one_for_the_demo_and_all_are_small():
    assert "physical_small" in shipped_checkpoints()
    for name in shipped_checkpoints():
        file = SHIPPED_FOLDER / f"{name}.safetensors"
        assert file.stat().st_size < 5e6
        assert Scenario.model_validate(read_metadata(file).scenario) == preset(name)


@pytest.mark.parametrize("acceleration_mps2", [None, 3.0], ids=["teleport", "inertia"])
def test_it_beats_random_and_hovering_far_beyond_chance(shipped, acceleration_mps2):
    """By five standard errors of the difference of the means of 256 episodes, in worlds it never saw."""
    policy, scenario = shipped
    trained = evaluate(policy, scenario, 256, SEED, acceleration_mps2)
    for other in baselines(scenario, 256, SEED, acceleration_mps2).values():
        error = math.hypot(trained.half_width, other.half_width) / 1.96
        assert trained.mean - other.mean > 5 * error
