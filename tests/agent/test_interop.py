"""Learners of other libraries train on the environment as they are."""

import gymnasium
import numpy as np
import pytest
import torch
from stable_baselines3 import DDPG, SAC, TD3
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_checker import check_env

import agent  # noqa: F401 - registers AerialStar-v0

STEPS = 300


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Watch(BaseCallback):
    """Keeps what the learner did and what it got."""

    def __init__(self):
        super().__init__()
        self.actions, self.rewards, self.ends = [], [], 0

    def _on_step(self) -> bool:
        self.actions.append(self.locals["actions"])
        self.rewards.append(self.locals["rewards"])
        self.ends += sum("TimeLimit.truncated" in info and info["TimeLimit.truncated"] for info in self.locals["infos"])
        return True


@pytest.mark.parametrize(
    ("algorithm", "policy", "observations"),
    [
        (DDPG, "MlpPolicy", "flat"),
        (TD3, "MlpPolicy", "flat"),
        (SAC, "MlpPolicy", "flat"),
        (SAC, "MultiInputPolicy", "dict"),
    ],
)
def test_stable_baselines3_trains(algorithm, policy, observations):
    env = gymnasium.make("AerialStar-v0", observation_form=observations)
    model = algorithm(policy, env, learning_starts=200, batch_size=32, seed=0, device="cpu")
    before = [parameter.clone() for parameter in model.policy.parameters()]
    watch = Watch()
    model.learn(STEPS, callback=watch, log_interval=1)

    actions = np.concatenate(watch.actions)
    assert actions.shape == (STEPS, *env.action_space.shape)
    assert (np.abs(actions) <= 1).all()
    assert np.isfinite(watch.rewards).all()
    assert watch.ends == STEPS // 30  # each episode's end is a time limit, so that its value is bootstrapped
    losses = [value for name, value in model.logger.name_to_value.items() if name.endswith("_loss")]
    assert len(losses) >= 2
    assert np.isfinite(losses).all()
    after = list(model.policy.parameters())
    assert all(torch.isfinite(parameter).all() for parameter in after)
    assert any(not torch.equal(old, new) for old, new in zip(before, after, strict=True))
    action, _ = model.predict(env.reset(seed=1)[0], deterministic=True)
    assert env.action_space.contains(action)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_stable_baselines3s_own_check_passes():
    check_env(gymnasium.make("AerialStar-v0").unwrapped, skip_render_check=True)
