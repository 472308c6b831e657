import json

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from agent import checkpoint
from agent.checkpoint import CheckpointError
from agent.daddpg import DualActorDdpg
from agent.policies import TrainedPolicy, sizes
from agent.training import save_policy
from agent.training_config import TrainingConfig
from rf_model.scenario import preset

SMALL = preset("physical_small")
CONFIG = TrainingConfig(hidden=(32, 16))


@pytest.fixture
def saved(tmp_path):
    agent = DualActorDdpg(sizes(SMALL), CONFIG)
    path = tmp_path / "policy.safetensors"
    save_policy(path, agent, SMALL, CONFIG, {"episodes": 12})
    return path, agent


def test_a_round_trip_keeps_every_decision_bit_for_bit(saved):
    path, agent = saved
    observation = torch.randn(7, sizes(SMALL).state, generator=torch.Generator().manual_seed(0))
    assert torch.equal(TrainedPolicy(path, SMALL)(observation, 0), agent.act(observation))


def test_metadata_says_how_to_train_it_again(saved):
    metadata = checkpoint.read_metadata(saved[0])
    assert (metadata.elements, metadata.antennas, metadata.users) == (16, 4, 4)
    assert TrainingConfig.model_validate(metadata.config) == CONFIG
    assert type(SMALL).model_validate(metadata.scenario) == SMALL
    assert metadata.training == {"episodes": 12}
    assert metadata.versions["torch"]


def test_a_single_observation_needs_no_batch(saved):
    policy = TrainedPolicy(saved[0], SMALL)
    observation = torch.randn(2, sizes(SMALL).state)
    torch.testing.assert_close(policy(observation[1], 0), policy(observation, 0)[1])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"rows": 5}, "trained with elements N = 16, the scenario has 20"),
        ({"antennas": 8}, "trained with antennas M = 4, the scenario has 8"),
        ({"users": 6}, "trained with users J = 4, the scenario has 6"),
        ({"motion": "spherical"}, "trained with motion = cartesian, the scenario has spherical"),
        ({"state_norm": "raw"}, "trained with state_norm = link_reference, the scenario has raw"),
        ({"surface": "dual"}, "trained with surface = coupled, the scenario has dual"),
        ({"state_extra": ["time"]}, r"trained with state_extra = \[\], the scenario has \['time'\]"),
    ],
)
def test_what_does_not_fit_is_refused_with_both_sides_named(saved, changes, text):
    with pytest.raises(CheckpointError, match=text) as error:
        TrainedPolicy(saved[0], preset("physical_small", **changes))
    assert "\n" not in str(error.value)


def test_a_checkpoint_that_names_no_state_extra_has_none(saved):
    metadata = checkpoint.read_metadata(saved[0])
    older = {name: value for name, value in metadata.scenario.items() if name not in ("state_extra", "surface")}
    older = metadata.model_copy(update={"scenario": older})
    checkpoint.require_fit(saved[0], older, SMALL)
    with pytest.raises(CheckpointError, match="state_extra"):
        checkpoint.require_fit(saved[0], older, preset("physical_small", state_extra=["users"]))


def test_missing_foreign_and_broken_files_are_named_in_one_line(saved, tmp_path):
    path, _ = saved
    missing = tmp_path / "none.safetensors"
    text = tmp_path / "text.safetensors"
    text.write_text("not a checkpoint")
    foreign = tmp_path / "foreign.safetensors"
    save_file({"a": np.zeros(3)}, foreign)
    odd = tmp_path / "odd.safetensors"
    save_file({"a": np.zeros(3)}, odd, metadata={"aerialstar": json.dumps({"format": "aerialstar-other-9"})})
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(path.read_bytes()[:-100])
    for file, why in (
        (missing, "no such file"),
        (text, "not a safetensors file"),
        (foreign, "not one of Aerial-STAR's"),
        (odd, "metadata format: Input should be 'aerialstar-daddpg-1'"),
        (cut, "not a safetensors file"),
        (tmp_path, "no such file"),
    ):
        with pytest.raises(CheckpointError, match=why) as error:
            checkpoint.load(file)
        assert str(file) in str(error.value)
        assert "\n" not in str(error.value)


def test_weights_that_contradict_the_metadata_are_refused(saved):
    path, _ = saved
    loaded = checkpoint.load(path)
    wrong = loaded.metadata.model_copy(update={"hidden": (8, 8)})
    checkpoint.save(path, checkpoint.Checkpoint(wrong, loaded.arrays))
    with pytest.raises(CheckpointError, match="weights do not match its metadata") as error:
        TrainedPolicy(path, SMALL)
    assert "\n" not in str(error.value)
