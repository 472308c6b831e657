import numpy as np
import pytest
import torch

from agent.decoding import continuous_size
from agent.environment import Environment
from agent.evaluation import evaluate
from agent.offline import OfflineProgress, Transitions, train_offline
from agent.policies import TrainedPolicy, sizes
from agent.training import TrainingError
from agent.training_config import TrainingConfig
from rf_model.scenario import preset

SCENARIO = preset("prototype_s4", slots=8, rows=2, columns=2, users=2, antennas=2)
CONFIG = TrainingConfig(hidden=(64, 64), actor_lr=1e-3, clone_updates=400, offline_updates=200, evaluation_episodes=32)


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


def test_updates_stay_near_the_data_and_the_result_is_judged(tmp_path):
    transitions, fixed = flown(noise=0.1)
    seen: list[OfflineProgress] = []
    result = train_offline(SCENARIO, CONFIG, transitions, tmp_path / "held", report=seen.append)
    free = train_offline(SCENARIO, CONFIG.model_copy(update={"cloning": 0.0}), transitions, tmp_path / "free")
    split = continuous_size(SCENARIO)

    def strayed(policy_file) -> torch.Tensor:
        raw = TrainedPolicy(policy_file, SCENARIO)(torch.as_tensor(transitions.observation), 0)
        return (raw[:, :split] - fixed[:split]).abs().mean()

    assert strayed(result.policy_file) < 0.67 * strayed(free.policy_file)  # 0.22 to 0.55 with other worlds
    assert [(p.updates, p.cloning) for p in seen if p.updates in (400, 500, 600)] == [
        (400, True),
        (500, False),
        (600, False),
    ]
    again = evaluate(TrainedPolicy(result.policy_file, SCENARIO), SCENARIO, 32, CONFIG.evaluation_seed + 1)
    assert again.mean == pytest.approx(result.trained.mean)


@pytest.mark.parametrize("count", [2, 30])
def test_a_flight_shorter_than_a_batch_is_enough(tmp_path, count):
    transitions, _ = flown(noise=0.1)
    few = Transitions(**{name: column[:count] for name, column in vars(transitions).items()})
    config = CONFIG.model_copy(update={"clone_updates": 20, "offline_updates": 20})
    assert config.batch_size > count
    result = train_offline(SCENARIO, config, few, tmp_path)
    raw = TrainedPolicy(result.policy_file, SCENARIO)(torch.as_tensor(few.observation), 0)
    assert torch.isfinite(raw).all()


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
