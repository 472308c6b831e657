import subprocess
import sys

import pytest
import torch
from pydantic import ValidationError

from agent.decoding import action_size, decode
from agent.observation import state_size
from agent.policies import make_policy
from agent.policy import SHIPPED_FOLDER, PolicyConfig
from rf_model.link import identity_beamforming
from rf_model.scenario import preset
from rf_model.star_ris import neutral_trc

SMALL = preset("physical_small")


def test_the_config_imports_no_torch():
    code = "import sys, agent.policy, agent.checkpoint, agent.training_config; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_default_is_the_shipped_checkpoint():
    assert PolicyConfig().checkpoint_path == SHIPPED_FOLDER / "physical_small.safetensors"


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"kind": "greedy"}, "kind"),
        ({"kind": "random", "checkpoint": "a.safetensors"}, "kind 'random' takes none"),
        ({"checkpoint": "no_such"}, "neither a file ending in .safetensors nor a shipped one"),
        ({"checkpoints": "a.safetensors"}, "checkpoints"),
    ],
)
def test_bad_configs_name_the_field(fields, text):
    with pytest.raises(ValidationError, match=text):
        PolicyConfig.model_validate(fields)


def test_a_path_is_taken_as_it_is():
    assert str(PolicyConfig(checkpoint="runs/a.safetensors").checkpoint_path) == "runs/a.safetensors"
    assert PolicyConfig(kind="hover").checkpoint_path is None


def test_random_actions_follow_from_seed_and_slot_alone():
    observation = torch.zeros(5, state_size(SMALL))
    policy = make_policy(PolicyConfig(kind="random"), SMALL, seed=3)
    policy(observation, 0)
    later = policy(observation, 4)
    assert torch.equal(later, make_policy(PolicyConfig(kind="random"), SMALL, seed=3)(observation, 4))
    assert not torch.equal(later, policy(observation, 5))
    assert not torch.equal(later, make_policy(PolicyConfig(kind="random"), SMALL, seed=4)(observation, 4))
    assert later.abs().max() <= 1
    assert later.shape == (5, action_size(SMALL))


@pytest.mark.parametrize("motion", ["cartesian", "spherical"])
@pytest.mark.parametrize("users", [4, 6])
def test_hovering_stays_and_is_neutral(motion, users):
    scenario = preset("physical_small", motion=motion, users=users)
    policy = make_policy(PolicyConfig(kind="hover"), scenario, seed=0)
    action = decode(policy(torch.zeros(state_size(scenario)), 0).double(), scenario)
    neutral = neutral_trc(16, torch.float64)
    assert action.displacement_enu.abs().max() < 1e-12
    assert torch.equal(action.theta_reflection, neutral.theta_reflection)
    torch.testing.assert_close(action.split_angle, neutral.split_angle)
    assert torch.equal(action.sign, neutral.sign)
    torch.testing.assert_close(action.beamforming, identity_beamforming(scenario, torch.complex128))
