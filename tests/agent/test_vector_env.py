import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, NormalizeObservation, RecordEpisodeStatistics

import agent  # noqa: F401 - registers AerialStar-v0
from agent.vector_env import AerialStarVectorEnv
from rf_model.scenario import preset

SHORT = preset("physical_small", slots=4)


def actions_of(envs, steps: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (steps, *envs.action_space.shape)).astype(np.float32)


def rollout(envs, actions: np.ndarray, seed: int | None) -> np.ndarray:
    """Observations and rewards [steps + 1, B, S + 1]."""
    first, _ = envs.reset(seed=seed)
    seen = [np.column_stack([first, np.zeros(envs.num_envs)])]
    for action in actions:
        observation, reward, *_ = envs.step(action)
        seen.append(np.column_stack([observation, reward]))
    return np.stack(seen)


@pytest.mark.parametrize("mode", [None, "vector_entry_point"])
def test_gymnasium_makes_it(mode):
    envs = gymnasium.make_vec("AerialStar-v0", num_envs=3, vectorization_mode=mode, scenario=SHORT)
    assert isinstance(envs, AerialStarVectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    single = gymnasium.make("AerialStar-v0", scenario=SHORT)
    assert envs.single_action_space == single.action_space
    assert envs.single_observation_space == single.observation_space
    observation, info = envs.reset(seed=0)
    assert envs.observation_space.contains(observation)
    assert info == {}
    observation, reward, terminated, truncated, info = envs.step(envs.action_space.sample())
    assert envs.observation_space.contains(observation)
    assert [values.shape for values in (reward, terminated, truncated)] == [(3,)] * 3
    assert terminated.dtype == truncated.dtype == np.bool_
    assert {name: info[name].shape for name in ("rate_bps", "power_w", "position_enu")} == {
        "rate_bps": (3, 4),
        "power_w": (3,),
        "position_enu": (3, 3),
    }


def assert_same(ours, theirs):
    """Equal arrays in equal structures; single precision where Gymnasium has double."""
    if isinstance(theirs, dict):
        assert ours.keys() == theirs.keys()
        for name, value in theirs.items():
            assert_same(ours[name], value)
    elif theirs.dtype == object:
        for our, their in zip(ours, theirs, strict=True):
            assert_same(our, their)
    else:
        np.testing.assert_array_equal(ours, theirs.astype(ours.dtype))


@pytest.mark.parametrize("form", ["flat", "dict"])
@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_a_batch_of_one_is_gymnasiums_own_vector_of_the_single_environment(mode, form):
    """Over several episodes, with all that each way of resetting puts into observations and info."""
    scenario = preset("physical_small", slots=SHORT.slots, state_extra=["users", "time"])
    kwargs = {"scenario": scenario, "action_form": form, "observation_form": form}
    envs = gymnasium.make_vec("AerialStar-v0", num_envs=1, autoreset_mode=mode, **kwargs)
    theirs = SyncVectorEnv([lambda: gymnasium.make("AerialStar-v0", **kwargs)], autoreset_mode=mode)
    assert envs.metadata["autoreset_mode"] is mode
    assert envs.action_space == theirs.action_space
    assert envs.observation_space == theirs.observation_space
    assert_same(envs.reset(seed=5)[0], theirs.reset(seed=5)[0])
    truncations = []
    for _ in range(12):
        action = envs.action_space.sample()
        *our_step, our_info = envs.step(action)
        *their_step, their_info = theirs.step(action)
        for ours, expected in zip(our_step, their_step, strict=True):
            assert_same(ours, expected)
        assert_same(our_info, their_info)
        truncations.append(bool(our_step[3][0]))
    cycle = [False] * 3 + [True]
    assert truncations == (cycle * 3 if mode is AutoresetMode.SAME_STEP else [*cycle, False] * 2 + cycle[:2])


def test_the_same_seed_and_batch_give_the_same_rollout_bit_for_bit():
    one, other = (gymnasium.make_vec("AerialStar-v0", num_envs=5, scenario=SHORT) for _ in range(2))
    actions = actions_of(one, 10)
    first = rollout(one, actions, seed=3)
    following = rollout(one, actions, seed=None)
    assert np.array_equal(first, rollout(other, actions, seed=3))
    assert np.array_equal(following, rollout(other, actions, seed=None))
    assert np.array_equal(first, rollout(one, actions, seed=3))
    assert not np.array_equal(first, following)
    assert not np.array_equal(first, rollout(one, actions, seed=4))


def test_no_rows_outcome_depends_on_the_actions_of_others():
    one, other = (gymnasium.make_vec("AerialStar-v0", num_envs=6, scenario=SHORT) for _ in range(2))
    actions, altered = actions_of(one, 10), actions_of(one, 10, seed=1)
    altered[:, 2] = actions[:, 2]
    ours, theirs = rollout(one, actions, seed=0), rollout(other, altered, seed=0)
    assert np.array_equal(ours[:, 2], theirs[:, 2])
    for row in (0, 1, 3, 4, 5):
        assert not np.array_equal(ours[1:, row], theirs[1:, row])


def test_rows_are_worlds_of_their_own():
    envs = gymnasium.make_vec("AerialStar-v0", num_envs=4, scenario=SHORT)
    observation, _ = envs.reset(seed=0)
    assert len(np.unique(observation[:, 3:], axis=0)) == 4


def test_same_step_autoreset():
    """Gymnasium's SAME_STEP: the last step of an episode returns the first observation of the next."""
    envs = gymnasium.make_vec("AerialStar-v0", num_envs=2, scenario=SHORT)
    envs.reset(seed=0)
    start = np.zeros((2, 3), np.float32)
    start[:, 2] = (60 - 75) / 45
    for step, action in enumerate(np.abs(actions_of(envs, 12)), start=1):
        observation, reward, terminated, truncated, info = envs.step(action)
        assert not terminated.any()
        assert (reward != 0).all()
        if step % 4:
            assert not truncated.any()
            assert "final_obs" not in info
            assert not np.array_equal(observation[:, :3], start)
        else:
            assert truncated.all()
            assert info["_final_obs"].all()
            assert info["_final_info"].all()
            np.testing.assert_allclose(observation[:, :3], start, atol=1e-6)
            low, high = np.array(SHORT.box_enu).T
            for row in range(2):
                assert envs.single_observation_space.contains(info["final_obs"][row])
                position = info["final_obs"][row][:3] * (high - low) / 2 + (high + low) / 2
                np.testing.assert_allclose(position, info["final_info"]["position_enu"][row], atol=1e-4)
            assert not np.allclose(info["final_info"]["position_enu"], [0, 0, 60])


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_gymnasiums_wrappers_take_it(mode):
    envs = gymnasium.make_vec("AerialStar-v0", num_envs=3, scenario=SHORT, autoreset_mode=mode)
    envs = RecordEpisodeStatistics(envs)
    if mode is AutoresetMode.NEXT_STEP:
        envs = NormalizeObservation(envs)
    envs = DictInfoToList(envs)
    envs.reset(seed=0)
    total, episodes = np.zeros(3), 0
    for action in actions_of(envs, 12):
        observation, reward, _, truncated, infos = envs.step(action)
        assert np.isfinite(observation).all()
        total += reward
        if truncated.all():
            assert [info["episode"]["l"] for info in infos] == [4] * 3
            np.testing.assert_allclose([info["episode"]["r"] for info in infos], total, rtol=1e-5)
            total[:] = 0
            episodes += 1
    assert episodes == (3 if mode is AutoresetMode.SAME_STEP else 2)


def test_tensors_are_those_that_arrays_would_hold():
    arrays, tensors = (
        gymnasium.make_vec("AerialStar-v0", num_envs=3, scenario=SHORT, tensors=wanted) for wanted in (False, True)
    )
    assert torch.equal(torch.from_numpy(arrays.reset(seed=0)[0]), tensors.reset(seed=0)[0])
    for action in actions_of(arrays, 6):
        expected, got = arrays.step(action), tensors.step(torch.from_numpy(action))
        for array, tensor in zip(expected[:4], got[:4], strict=True):
            assert isinstance(tensor, torch.Tensor)
            assert torch.equal(torch.from_numpy(array), tensor)
        info, their_info = expected[4], got[4]
        if "final_obs" in info:
            assert torch.equal(torch.from_numpy(np.stack(info["final_obs"])), their_info["final_obs"])
            info, their_info = info["final_info"], their_info["final_info"]
        assert torch.equal(torch.from_numpy(info["rate_bps"]), their_info["rate_bps"])


def test_tensors_can_be_learned_from():
    envs = gymnasium.make_vec("AerialStar-v0", num_envs=3, tensors=True)
    layer = torch.nn.Linear(envs.single_observation_space.shape[0], 1)
    observation, _ = envs.reset(seed=0)
    _, reward, *_ = envs.step(envs.action_space.sample())
    (layer(observation)[:, 0] - reward).square().mean().backward()
    assert torch.isfinite(layer.weight.grad).all()


@pytest.mark.parametrize("acceleration", [None, 3.0])
@pytest.mark.parametrize("name", ["paper_literal", "physical_1km", "physical_small", "prototype_s4"])
def test_nothing_is_made_on_another_device_than_the_worlds(name, acceleration):
    """Every tensor made without its device would land on `meta` here, and would not mix with the worlds' own."""
    scenario = preset(name, slots=2, state_extra=["users", "time"])
    envs = gymnasium.make_vec(
        "AerialStar-v0", num_envs=3, scenario=scenario, tensors=True, acceleration_mps2=acceleration
    )
    actions = torch.from_numpy(actions_of(envs, 3))
    with torch.device("meta"):
        envs.reset(seed=0)
        for action in actions:
            observation, reward, *_ = envs.step(action)
    assert observation.device.type == reward.device.type == "cpu"
    assert torch.isfinite(reward).all()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_worlds_on_a_gpu():
    envs, other = (
        gymnasium.make_vec("AerialStar-v0", num_envs=5, scenario=SHORT, device="cuda", tensors=True) for _ in range(2)
    )
    assert torch.equal(envs.reset(seed=0)[0], other.reset(seed=0)[0])
    for action in actions_of(envs, 6):
        (observation, reward, *_), (theirs, *_) = envs.step(action), other.step(action)
        assert observation.device.type == reward.device.type == "cuda"
        assert torch.equal(observation, theirs)


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="num_envs: 0 must be at least 1"):
        AerialStarVectorEnv(num_envs=0)
    with pytest.raises(ValueError, match=r"autoreset_mode: .*DISABLED.* is not SAME_STEP or NEXT_STEP"):
        AerialStarVectorEnv(num_envs=2, autoreset_mode=AutoresetMode.DISABLED)
    envs = gymnasium.make_vec("AerialStar-v0", num_envs=2)
    with pytest.raises(ValueError, match="reset_mask: not possible, all worlds start and end together"):
        envs.reset(options={"reset_mask": np.array([True, False])})
    envs.reset(seed=0)
    with pytest.raises(ValueError, match="number 3 is not finite"):
        envs.step(np.where(np.arange(83) == 3, np.nan, 0.5).astype(np.float32)[None].repeat(2, 0))
