"""Hyper-parameters of `aerialstar train` are read as strictly as a mission."""

import pytest

from agent.training_config import TrainingConfig
from mission.train import TrainInputError, load_config


def test_numbers_may_be_whole_and_have_exponents(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("actor_lr: 1e-4\nreward_scale: 2\nhidden: [64, 32]\nepisodes: 9")
    config = load_config(path, episodes=12, seed=None)
    assert config == TrainingConfig(actor_lr=1e-4, reward_scale=2.0, hidden=(64, 32), episodes=12)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ('episodes: "100"', "episodes: '100' is not allowed: input should be a valid integer"),
        ("episodes: 100.0", "episodes: 100.0 is not allowed: input should be a valid integer"),
        ("seed: true", "seed: True is not allowed: input should be a valid integer"),
        ('actor_lr: "1e-4"', "actor_lr: '1e-4' is not allowed: input should be a valid number"),
        ("discount: true", "discount: True is not allowed: input should be a valid number"),
        ('hidden: ["64"]', "hidden.0: '64' is not allowed: input should be a valid integer"),
        ("hidden: 64", "hidden: 64 is not allowed: input should be a list"),
        ("hidden: []", "hidden: [] is not allowed"),
        ("actor_rl: 1.0e-4", "actor_rl: unknown key, did you mean actor_lr or"),
        ("xyzzy: 1", "xyzzy: unknown key, allowed are seed, environments"),
        ("seed: 1\nseed: 2", "seed: given twice, in lines 1 and 2"),
        ("replay_capacity: 100", "replay_capacity: 100 is less than environments"),
        ("[1]", "must hold a mapping of fields (seed, environments"),
        ("a: [", "not YAML"),
    ],
)
def test_every_mistake_is_one_line_naming_file_field_value_and_what_is_allowed(tmp_path, text, part):
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(TrainInputError) as caught:
        load_config(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert part in line
    assert "\n" not in line
