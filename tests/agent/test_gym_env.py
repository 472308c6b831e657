import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import agent  # noqa: F401 - registers AerialStar-v0
from rf_model.scenario import ScenarioError, preset


@pytest.mark.parametrize("name", ["physical_small", "prototype_s4"])
@pytest.mark.filterwarnings("ignore:.*A Box observation space .* is .*infinity")
def test_gymnasiums_own_check_passes(name):
    env = gymnasium.make("AerialStar-v0", scenario=name)
    check_env(env.unwrapped, skip_render_check=True)


def test_an_episode_is_truncated_by_its_time_limit_and_never_terminates():
    env = gymnasium.make("AerialStar-v0", scenario=preset("physical_small", slots=5))
    env.reset(seed=1)
    ends = [env.step(env.action_space.sample())[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]


def test_a_seed_fixes_the_episode_and_the_next_one_differs():
    def episode(env, seed):
        first, _ = env.reset(seed=seed)
        action = np.zeros(env.action_space.shape, np.float32)
        return np.stack([first, *(env.step(action)[0] for _ in range(3))])

    env, other = gymnasium.make("AerialStar-v0"), gymnasium.make("AerialStar-v0")
    one, following = episode(env, 3), episode(env, None)
    assert np.array_equal(one, episode(other, 3))
    assert np.array_equal(following, episode(other, None))
    assert not np.array_equal(one, following)


def test_info_tells_rates_power_and_position():
    env = gymnasium.make("AerialStar-v0")
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, np.float32)
    action[:3] = [0.5, 0.0, 0.1]  # 5 m east, 1 m up
    action[35:67] = 1.0
    info = env.step(action)[4]
    np.testing.assert_allclose(info["position_enu"], [5, 0, 61], rtol=1e-5)
    assert info["rate_bps"].shape == (4,)
    assert (info["rate_bps"] > 0).all()
    assert info["power_w"] == pytest.approx(150, rel=0.5)


def test_an_unknown_preset_is_refused():
    with pytest.raises(ScenarioError, match="'nowhere' is not one of"):
        gymnasium.make("AerialStar-v0", scenario="nowhere")
