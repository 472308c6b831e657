import json

import pytest
import torch
from pydantic import ValidationError

from agent import checkpoint
from agent.evaluation import evaluate
from agent.policies import RandomPolicy, TrainedPolicy
from agent.training import Learner, Progress, TrainingError, train
from agent.training_config import TrainingConfig
from rf_model.scenario import preset

TINY = preset("physical_small", slots=4, rows=2, columns=2, users=2, antennas=2)
TIMED = TINY.model_copy(update={"state_extra": ("time",)})
QUICK = TrainingConfig(
    environments=8,
    episodes=48,
    warmup=64,
    batch_size=16,
    updates_per_step=2,
    replay_capacity=150,  # wraps around
    hidden=(16, 16),
    evaluate_every=16,
    evaluation_episodes=8,
    save_every=16,
)


def weights(learner: Learner) -> list[torch.Tensor]:
    return [value for module in learner.agent.modules().values() for value in module.state_dict().values()]


def test_a_run_leaves_a_policy_its_metrics_and_a_judgement(tmp_path):
    seen: list[Progress] = []
    result = train(TINY, QUICK, tmp_path / "run", report=seen.append)
    lines = [json.loads(line) for line in (tmp_path / "run/metrics.jsonl").read_text().splitlines()]
    assert [line["episodes"] for line in lines] == [8, 16, 24, 32, 40, 48]
    assert [line["evaluation"] is not None for line in lines] == [False, True] * 3
    assert [progress.episodes for progress in seen] == [8, 16, 24, 32, 40, 48]
    training = checkpoint.read_metadata(result.policy_file).training
    assert training["trained"]["mean"] == pytest.approx(result.trained.mean)
    assert set(training) == {"episodes", "seed", "trained", "random", "hover"}
    again = evaluate(TrainedPolicy(result.policy_file, TINY), TINY, 8, QUICK.evaluation_seed + 1)
    assert torch.equal(again.rewards, result.trained.rewards)


def test_the_kept_policy_is_the_best_evaluated(tmp_path):
    seen: list[Progress] = []
    result = train(TINY, QUICK, tmp_path, report=seen.append)
    best = max(p.evaluation.mean for p in seen if p.evaluation is not None)
    again = evaluate(TrainedPolicy(result.policy_file, TINY), TINY, 8, QUICK.evaluation_seed)
    assert again.mean == pytest.approx(best, rel=1e-6)


def test_a_resumed_run_ends_as_an_uninterrupted_one_bit_for_bit(tmp_path):
    whole = Learner(TINY, QUICK)
    while not whole.finished:
        whole.play()

    first = Learner(TINY, QUICK)
    for _ in range(3):
        first.play()
    first.save(tmp_path / "state.safetensors")
    first.play()  # lost in the crash
    second = Learner(TINY, QUICK)
    second.load(tmp_path / "state.safetensors")
    while not second.finished:
        second.play()
    assert all(torch.equal(a, b) for a, b in zip(weights(whole), weights(second), strict=True))
    assert all(torch.equal(value, second.replay.state()[name]) for name, value in whole.replay.state().items())


def test_a_crashed_run_resumes_with_metrics_of_each_round_once(tmp_path):
    class CrashError(Exception):
        pass

    def crash(progress: Progress) -> None:
        if progress.episodes == 40:
            raise CrashError

    with pytest.raises(CrashError):
        train(TINY, QUICK, tmp_path / "a", report=crash)
    resumed = train(TINY, QUICK, tmp_path / "a", resume=True)
    whole = train(TINY, QUICK, tmp_path / "b")
    assert (tmp_path / "a/metrics.jsonl").read_text() == (tmp_path / "b/metrics.jsonl").read_text()
    assert torch.equal(resumed.trained.rewards, whole.trained.rewards)


def test_what_cannot_be_resumed_or_started_is_said_in_one_line(tmp_path):
    with pytest.raises(TrainingError, match="does not exist"):
        train(TINY, QUICK, tmp_path / "empty", resume=True)
    train(TINY, QUICK, tmp_path / "run")
    with pytest.raises(TrainingError, match="holds a training run already"):
        train(TINY, QUICK, tmp_path / "run")
    with pytest.raises(TrainingError, match=r"trained with config discount = 0.9, not 0.5"):
        train(TINY, QUICK.model_copy(update={"discount": 0.5}), tmp_path / "run", resume=True)
    with pytest.raises(TrainingError, match="trained with scenario users = 2, not 3"):
        train(TINY.model_copy(update={"users": 3}), QUICK, tmp_path / "run", resume=True)
    (tmp_path / "run/state.safetensors").write_text("rubbish")
    with pytest.raises(TrainingError, match="not a safetensors file"):
        train(TINY, QUICK, tmp_path / "run", resume=True)


@pytest.mark.parametrize(("time_limit", "ended"), [("truncates", 0.0), ("terminates", 1.0)])
def test_the_last_slot_ends_the_value_only_if_asked(time_limit, ended):
    """With discount 1 as in the paper, an episode's value is then its reward to come."""
    learner = Learner(TIMED, QUICK.model_copy(update={"discount": 1.0, "time_limit": time_limit}))
    for _ in range(4):
        learner.play()
    kept = learner.replay.state()
    last = kept["next_observation"][:, -1] == 1
    assert last.float().mean() == pytest.approx(1 / TIMED.slots, abs=0.02)
    assert kept["terminated"].tolist() == (last * ended).tolist()


def test_a_value_that_ends_needs_the_time_in_the_state(tmp_path):
    with pytest.raises(TrainingError, match=r"^time_limit: 'terminates' needs .*state_extra: \[time\]"):
        train(TINY, QUICK.model_copy(update={"time_limit": "terminates"}), tmp_path / "run")


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"time_limit": "never"}, "time_limit"),
        ({"discount": 1.1}, "discount"),
        ({"actor_lr": float("nan")}, "actor_lr"),
        ({"learning_rate": 1e-3}, "learning_rate"),
        ({"replay_capacity": 100}, "replay_capacity: 100 is less than environments"),
        ({"actor_update": "both"}, "actor_update"),
    ],
)
def test_bad_hyper_parameters_name_the_field(fields, text):
    with pytest.raises(ValidationError, match=text):
        TrainingConfig.model_validate(fields)


def test_it_learns_beamforming_for_one_user_in_seconds():
    """One user over a nearly fixed line of sight: good beams and phases need no long training.

    The bar: the two 95 % intervals lie apart by at least the span of random play's own.
    """
    scenario = preset("prototype_s4", slots=5, rows=1, columns=1, users=1, antennas=4, reflection_users=1, kappa=1e3)
    config = TrainingConfig(
        environments=16, episodes=960, warmup=320, hidden=(32, 32), actor_lr=1e-3, updates_per_step=4,
        discount=0.0, noise_start=0.4,
    )  # fmt: skip
    learner = Learner(scenario, config)
    random = evaluate(RandomPolicy(scenario, 0), scenario, 64, 5)
    while not learner.finished:
        learner.play()
    trained = evaluate(learner, scenario, 64, 5)
    assert trained.mean - trained.half_width > random.mean + 3 * random.half_width
