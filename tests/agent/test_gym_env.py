import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

import agent  # noqa: F401 - registers AerialStar-v0
from agent.decoding import RawActionError, action_size
from agent.environment import Environment
from agent.observation import state_size
from agent.spaces import action_layout
from rf_model.scenario import ScenarioError, preset

FORMS = [(actions, observations) for actions in ("flat", "dict") for observations in ("flat", "dict")]


@pytest.mark.parametrize("name", ["paper_literal", "physical_1km", "physical_small", "prototype_s4"])
@pytest.mark.filterwarnings("ignore:.*A Box observation space .* is .*infinity")
def test_gymnasiums_own_check_passes(name):
    env = gymnasium.make("AerialStar-v0", scenario=name)
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize(("actions", "observations"), FORMS)
@pytest.mark.filterwarnings("ignore:.*A Box observation space .* is .*infinity")
def test_gymnasiums_own_check_passes_for_every_form(actions, observations):
    env = gymnasium.make("AerialStar-v0", action_form=actions, observation_form=observations)
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("form", ["flat", "dict"])
@pytest.mark.filterwarnings("ignore:.*A Box observation space .* is .*infinity")
def test_what_is_observed_besides_has_its_parts(form):
    scenario = preset("physical_small", state_extra=["users", "time"], slots=2)
    env = gymnasium.make("AerialStar-v0", scenario=scenario, observation_form=form)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    observation, *_ = env.step(env.action_space.sample())
    assert gymnasium.spaces.flatdim(env.observation_space) == state_size(scenario)
    if form == "dict":
        assert [*observation] == ["position", "bs_ris", "direct", "ris_user", "users", "time"]
        assert (observation["users"].shape, observation["time"].tolist()) == ((4, 3), [1.0])
    else:
        assert observation[-1] == 1


@pytest.mark.parametrize("surface", ["coupled", "independent", "dual", "conventional"])
def test_every_surface_has_both_forms(surface):
    scenario = preset("physical_small", surface=surface)
    flat = gymnasium.make("AerialStar-v0", scenario=scenario)
    env = gymnasium.make("AerialStar-v0", scenario=scenario, action_form="dict")
    env.reset(seed=0)
    assert flat.action_space.shape == (action_layout(scenario).size,) == (action_size(scenario),)
    assert gymnasium.spaces.flatdim(env.action_space) == action_size(scenario)
    assert ("sign" in env.action_space.spaces) == (surface == "coupled")
    assert np.isfinite(env.step(env.action_space.sample())[1])


def test_a_dict_of_parts_does_what_the_flat_action_does():
    flat, parts = (gymnasium.make("AerialStar-v0", action_form=form) for form in ("flat", "dict"))
    flat.reset(seed=4), parts.reset(seed=4)
    action = parts.action_space.sample()
    joined = np.concatenate(
        [
            action["motion"],
            action["theta_reflection"],
            action["split"],
            action["beamforming"].ravel(),
            2.0 * action["sign"] - 1,
        ]
    )
    one, other = parts.step(action), flat.step(joined.astype(np.float32))
    np.testing.assert_array_equal(one[0], other[0])
    assert one[1] == other[1]


def test_a_dict_observation_holds_the_channels_of_the_flat_one():
    env = gymnasium.make("AerialStar-v0", observation_form="dict").unwrapped
    observation, _ = env.reset(seed=4)
    world, scale = env._environment.world, env._environment.normalisation
    for name, channel in (("bs_ris", "bs_ris"), ("direct", "direct"), ("ris_user", "ris_user")):
        got = observation[name][..., 0] + 1j * observation[name][..., 1]
        np.testing.assert_allclose(got, getattr(world.channels, channel)[0] / getattr(scale, name), rtol=1e-6)
    assert env.observation_space.contains(observation)
    assert gymnasium.spaces.flatdim(env.observation_space) == state_size(preset("physical_small"))
    flat, _ = gymnasium.make("AerialStar-v0").reset(seed=4)
    np.testing.assert_array_equal(np.concatenate([part.ravel() for part in observation.values()]), flat)


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


def test_inertia_can_be_asked_for():
    action = np.zeros(83, np.float32)
    action[0], action[35] = 1.0, 1.0  # 10 m east in a slot
    flown = {}
    for acceleration in (None, 3.0):
        env = gymnasium.make("AerialStar-v0", acceleration_mps2=acceleration)
        env.reset(seed=0)
        flown[acceleration] = env.step(action)[4]["position_enu"][0]
    assert flown[None] == pytest.approx(10, rel=1e-5)
    assert flown[3.0] == pytest.approx(1.5, rel=1e-5)  # a t^2 / 2


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


def test_what_a_learner_does_to_what_it_was_given_changes_nothing():
    one, other = gymnasium.make("AerialStar-v0"), gymnasium.make("AerialStar-v0")
    action = np.ones(83, np.float32)
    for env in (one, other):
        env.reset(seed=0)
    for _ in range(3):
        observation, reward, *_, info = one.step(action)
        expected = other.step(action)
        assert reward == expected[1]
        np.testing.assert_array_equal(info["position_enu"], expected[4]["position_enu"])
        for values in (observation, info["rate_bps"], info["position_enu"]):
            values *= 0


def test_it_is_the_environment_that_training_uses():
    env = gymnasium.make("AerialStar-v0").unwrapped
    first, _ = env.reset(seed=9)
    plain = Environment(preset("physical_small"), batch=1, seed=0)
    plain.generator.manual_seed(int(np.random.default_rng(9).integers(2**63)))
    np.testing.assert_array_equal(first, plain.reset()[0])
    for _ in range(3):
        action = env.action_space.sample()
        observation, reward, *_ = env.step(action)
        step = plain.step(torch.from_numpy(action)[None])
        np.testing.assert_array_equal(observation, step.observation[0])
        assert reward == step.reward.item()


def test_bad_arguments_and_actions_are_refused():
    with pytest.raises(ScenarioError, match="'nowhere' is not one of"):
        gymnasium.make("AerialStar-v0", scenario="nowhere")
    with pytest.raises(ValueError, match="action_form: 'tuple' is not one of flat, dict"):
        gymnasium.make("AerialStar-v0", action_form="tuple")
    with pytest.raises(ValueError, match="observation_form: 'tuple'"):
        gymnasium.make("AerialStar-v0", observation_form="tuple")
    env = gymnasium.make("AerialStar-v0", action_form="dict").unwrapped
    env.reset(seed=0)
    action = env.action_space.sample()
    with pytest.raises(RawActionError, match="must be motion, theta_reflection, split, beamforming, sign"):
        env.step({name: part for name, part in action.items() if name != "sign"})
    with pytest.raises(RawActionError, match=r"split: shape \[15\], must end in \[16\]"):
        env.step(action | {"split": action["split"][1:]})
    with pytest.raises(RawActionError, match="action: ndarray, action_form dict takes a dict"):
        env.step(np.zeros(83, np.float32))
