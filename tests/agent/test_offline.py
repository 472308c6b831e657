import numpy as np
import pytest
import torch

from agent.decoding import continuous_size
from agent.environment import Environment
from agent.evaluation import Evaluation, evaluate
from agent.offline import Transitions, train_offline
from agent.policies import TrainedPolicy, sizes
from agent.training import TrainingError
from agent.training_config import TrainingConfig
from rf_model.scenario import preset

SCENARIO = preset("prototype_s4", slots=8, rows=2, columns=2, users=2, antennas=2)
CONFIG = TrainingConfig(hidden=(64, 64), actor_lr=1e-3, clone_updates=400, offline_updates=200, evaluation_episodes=128)


def flown(noise: float, count: int = 800) -> tuple[Transitions, torch.Tensor]:
    """Transitions of one fixed raw action with some noise on it, and that action."""
    generator = torch.Generator().manual_seed(0)
    size = sizes(SCENARIO)
    fixed = torch.rand(size.action, generator=generator) * 1.4 - 0.7
    environment = Environment(SCENARIO, batch=count // 8, seed=0)
    observation = environment.reset()
    columns: list[list[np.ndarray]] = [[], [], [], []]
    for _ in range(8):
        action = fixed + noise * torch.randn(count // 8, size.action, generator=generator)
        step = environment.step(action)
        for column, value in zip(columns, (observation, action, step.reward, step.observation), strict=True):
            column.append(value.numpy())
        observation = step.observation
    return Transitions(*(np.concatenate(column) for column in columns), np.zeros(count, bool)), fixed


def test_cloning_recovers_the_policy_that_flew(tmp_path):
    transitions, fixed = flown(noise=0.05)
    result = train_offline(SCENARIO, CONFIG.model_copy(update={"offline_updates": 0}), transitions, tmp_path)
    raw = TrainedPolicy(result.policy_file, SCENARIO)(torch.as_tensor(transitions.observation), 0)
    split = continuous_size(SCENARIO)
    assert (raw[:, :split] - fixed[:split]).abs().mean() < 0.1
    clear = fixed[split:].abs() > 0.2
    wanted = torch.where(fixed[split:] > 0, 1.0, -1.0)
    assert (raw[:, split:] == wanted)[:, clear].float().mean() > 0.95


def flown_by_sight(seed: int, count: int = 800) -> Transitions:
    """Transitions of actions that follow from what is seen, one hidden layer's worth, with some noise on them."""
    size = sizes(SCENARIO)
    weights = torch.randn(size.state, size.action, generator=torch.Generator().manual_seed(99)) / size.state**0.5
    generator = torch.Generator().manual_seed(seed)
    environment = Environment(SCENARIO, batch=count // 8, seed=seed)
    observation = environment.reset()
    columns: list[list[np.ndarray]] = [[], [], [], []]
    for _ in range(8):
        noise = 0.05 * torch.randn(count // 8, size.action, generator=generator)
        action = 0.7 * torch.tanh(observation @ weights) + noise
        step = environment.step(action)
        for column, value in zip(columns, (observation, action, step.reward, step.observation), strict=True):
            column.append(value.numpy())
        observation = step.observation
    return Transitions(*(np.concatenate(column) for column in columns), np.zeros(count, bool))


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    """Results of cloning, of updates held to the data and of updates that are not; and what they were shown."""
    transitions, seen = flown_by_sight(seed=0), []
    folder = tmp_path_factory.mktemp("offline")
    results = {
        name: train_offline(SCENARIO, CONFIG.model_copy(update=changes), transitions, folder / name, report=seen.append)
        for name, changes in (("cloned", {"offline_updates": 0}), ("held", {}), ("free", {"cloning": 0.0}))
    }
    return results, transitions, seen


def held_out(result, transitions: Transitions) -> tuple[float, float, float, float]:
    """On another flight: squared error of the policy and of the mean action, share of signs of the policy and of the
    commoner sign."""
    other, split = flown_by_sight(seed=100), continuous_size(SCENARIO)
    raw = TrainedPolicy(result.policy_file, SCENARIO)(torch.as_tensor(other.observation), 0).numpy()
    wanted, signs = other.action[:, :split], other.action[:, split:] > 0
    error = np.mean((raw[:, :split] - wanted) ** 2)
    of_mean = np.mean((transitions.action[:, :split].mean(0) - wanted) ** 2)
    commoner = (transitions.action[:, split:] > 0).mean(0) > 0.5
    return error, of_mean, np.mean((raw[:, split:] > 0) == signs), np.mean(commoner == signs)


def test_cloning_learns_to_act_by_what_is_seen(learned):
    results, transitions, _ = learned
    error, of_mean, right, of_commoner = held_out(results["cloned"], transitions)
    assert error < of_mean
    assert right > of_commoner


def test_updates_stay_nearer_to_what_was_flown_than_its_mean_action_and_only_if_held(learned):
    results, transitions, _ = learned
    error, of_mean, right, of_commoner = held_out(results["held"], transitions)
    assert error < of_mean
    assert right > of_commoner
    error, of_mean, _, _ = held_out(results["free"], transitions)
    assert error > of_mean


def test_updates_improve_on_the_clone(learned):
    """In the same worlds, beyond the 95 % interval of the mean difference."""
    results, _, _ = learned
    gained = Evaluation(results["held"].trained.rewards - results["cloned"].trained.rewards)
    assert gained.mean > gained.half_width


def test_progress_is_reported_and_the_result_is_judged_as_anybody_would(learned):
    results, _, seen = learned
    assert [(p.updates, p.cloning) for p in seen if p.updates in (400, 500, 600)][1:4] == [
        (400, True),
        (500, False),
        (600, False),
    ]
    again = evaluate(
        TrainedPolicy(results["held"].policy_file, SCENARIO),
        SCENARIO,
        CONFIG.evaluation_episodes,
        CONFIG.evaluation_seed + 1,
    )
    assert again.mean == pytest.approx(results["held"].trained.mean)


@pytest.mark.parametrize("count", [2, 30])
def test_a_flight_shorter_than_a_batch_is_enough(tmp_path, count):
    transitions, _ = flown(noise=0.1)
    few = Transitions(**{name: column[:count] for name, column in vars(transitions).items()})
    config = CONFIG.model_copy(update={"clone_updates": 20, "offline_updates": 20})
    assert config.batch_size > count
    result = train_offline(SCENARIO, config, few, tmp_path)
    raw = TrainedPolicy(result.policy_file, SCENARIO)(torch.as_tensor(few.observation), 0)
    assert torch.isfinite(raw).all()


def test_beyond_an_end_that_terminates_nothing_counts(tmp_path):
    """When every slot is an episode's last, discount 1 is as good as 0, unless values go on beyond the time limit."""
    scenario = SCENARIO.model_copy(update={"slots": 1, "state_extra": ("time",)})
    size, generator = sizes(scenario), torch.Generator().manual_seed(0)
    observation, following = torch.randn(2, 64, size.state, generator=generator)
    observation[:, -1], following[:, -1] = 0, 1
    action = torch.rand(64, size.action, generator=generator) * 2 - 1
    rows = Transitions(*(part.numpy() for part in (observation, action, action[:, 0], following)), np.zeros(64, bool))

    def learned(discount: float, time_limit: str) -> list[float]:
        changes = {"discount": discount, "time_limit": time_limit, "clone_updates": 0, "offline_updates": 20}
        folder = tmp_path / f"{time_limit} {discount}"
        result = train_offline(scenario, CONFIG.model_copy(update=changes), rows, folder)
        return TrainedPolicy(result.policy_file, scenario)(observation[0], 0)[:3].tolist()

    assert learned(1.0, "terminates") == learned(0.0, "truncates") != learned(1.0, "truncates")
    with pytest.raises(TrainingError, match="time_limit"):
        train_offline(SCENARIO, CONFIG.model_copy(update={"time_limit": "terminates"}), rows, tmp_path / "none")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda t: {"observation": t.observation[:, :-1]}, r"observation is \(800, \d+\), the scenario's sizes want"),
        (lambda t: {"action": t.action[:-1]}, r"action is \(799, \d+\)"),
        (lambda t: {"reward": np.full_like(t.reward, np.nan)}, "reward holds numbers that are not finite"),
        (lambda t: {name: column[:1] for name, column in vars(t).items()}, "1 transitions are too few; at least 2"),
    ],
)
def test_unusable_transitions_are_refused_by_name(tmp_path, change, text):
    transitions, _ = flown(noise=0.1)
    broken = Transitions(**(vars(transitions) | change(transitions)))
    with pytest.raises(TrainingError, match=text):
        train_offline(SCENARIO, CONFIG, broken, tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_folder_with_a_run_is_left_alone(tmp_path):
    transitions, _ = flown(noise=0.1)
    (tmp_path / "policy.safetensors").write_text("mine")
    with pytest.raises(TrainingError, match="holds a training run already"):
        train_offline(SCENARIO, CONFIG, transitions, tmp_path)
