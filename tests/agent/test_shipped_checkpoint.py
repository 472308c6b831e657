"""The policy that comes with the package is worth flying."""

import math

import pytest
import torch

from agent.checkpoint import read_metadata
from agent.environment import Environment
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
        assert read_metadata(file).scenario == preset(name).model_dump(mode="json")


def test_it_beats_random_and_hovering_far_beyond_chance(shipped):
    """By five standard errors of the difference of the means of 256 episodes, in worlds it never saw."""
    policy, scenario = shipped
    trained = evaluate(policy, scenario, 256, SEED)
    for other in baselines(scenario, 256, SEED).values():
        error = math.hypot(trained.half_width, other.half_width) / 1.96
        assert trained.mean - other.mean > 5 * error


def test_it_flies_inside_the_box_and_smoothly(shipped):
    """Moves at the middle of the flight change by less than an autopilot can follow in a slot, in nearly all slots."""
    policy, scenario = shipped
    environment = Environment(scenario, batch=256, seed=SEED)
    observation = environment.reset()
    moves = []
    for slot in range(scenario.slots):
        step = environment.step(policy(observation, slot))
        observation = step.observation
        moves.append(step.action.displacement_enu)
    change = torch.stack(moves).diff(dim=0).norm(dim=-1) / scenario.slot_s**2
    assert change.quantile(0.95) < 3.0  # m/s^2, the acceleration of the bridge's slot profile
