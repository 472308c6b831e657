"""Online training of DA-DDPG on the batched environment: resumable, and the same bit for bit however often resumed."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from agent import checkpoint
from agent.daddpg import DualActorDdpg
from agent.environment import Environment
from agent.evaluation import Evaluation, baselines, evaluate
from agent.exploration import OrnsteinUhlenbeck, decayed, epsilon_greedy, random_actions
from agent.observation import ends
from agent.policies import TrainedPolicy, sizes
from agent.replay_buffer import Batch, ReplayBuffer
from agent.training_config import TrainingConfig
from rf_model.scenario import Scenario

POLICY_FILE = "policy.safetensors"
STATE_FILE = "state.safetensors"
METRICS_FILE = "metrics.jsonl"


class TrainingError(ValueError):
    """Training cannot start or go on; the text says why, in one line."""


@dataclass(frozen=True)
class Progress:
    """One line of the metrics, and what a progress bar shows."""

    episodes: int
    of: int
    reward: float
    """Mean reward of the newest episodes, exploration included."""
    critic_loss: float
    q: float
    noise: float
    epsilon: float
    evaluation: Evaluation | None
    """Set when the policy was just evaluated."""


@dataclass(frozen=True)
class Result:
    """What training came to, in worlds that it never saw."""

    policy_file: Path
    trained: Evaluation
    baselines: dict[str, Evaluation]


class Learner:
    """Environment, learner and replay, advanced one round (one episode in every environment) at a time."""

    def __init__(self, scenario: Scenario, config: TrainingConfig) -> None:
        require_time(scenario, config)
        self.scenario = scenario
        self.config = config
        self.episodes = 0
        self.best = -float("inf")
        """Best evaluation so far; its policy is the one kept."""
        size = sizes(scenario)
        self.agent = DualActorDdpg(size, config)
        self.environment = Environment(scenario, config.environments, config.seed, config.acceleration_mps2)
        self.replay = ReplayBuffer(config.replay_capacity, size.state, size.action)
        self.generator = torch.Generator().manual_seed(config.seed)
        """Exploration and replay draws."""

    def play(self) -> Progress:
        """Play one round, learning on the way (Alg. 1's loop over t)."""
        config, size = self.config, self.agent.sizes
        done = self.episodes / config.episodes
        scale = decayed(config.noise_start, config.noise_end, done, config.decay_fraction)
        epsilon = decayed(config.epsilon_start, config.epsilon_end, done, config.decay_fraction)
        noise = OrnsteinUhlenbeck((config.environments, size.continuous), config.noise_theta)
        total = torch.zeros(config.environments)
        critic_loss, q, updates = torch.zeros(()), torch.zeros(()), 0

        observation = self.environment.reset()
        for _ in range(self.scenario.slots):
            if self.replay.added < config.warmup:
                action = random_actions((config.environments, size.action), size.continuous, self.generator)
            else:
                action = self.agent.act(observation)
                action[:, : size.continuous] += scale * noise.step(self.generator)
                action[:, : size.continuous].clip_(-1, 1)
                action[:, size.continuous :] = epsilon_greedy(action[:, size.continuous :], epsilon, self.generator)
            step = self.environment.step(action)
            terminated = torch.zeros_like(step.reward)
            if config.time_limit == "terminates":
                terminated = ends(step.observation).to(step.reward.dtype)
            self.replay.add(Batch(observation, action, step.reward, step.observation, terminated))
            if self.replay.added >= config.warmup:
                for _ in range(config.updates_per_step):
                    losses = self.agent.update(self.replay.sample(config.batch_size, self.generator))
                    critic_loss, q, updates = critic_loss + losses.critic, q + losses.q, updates + 1
            observation = step.observation
            total += step.reward

        before = self.episodes
        self.episodes += config.environments
        evaluated = None
        if self.finished or self.episodes // config.evaluate_every > before // config.evaluate_every:
            evaluated = evaluate(
                self, self.scenario, config.evaluation_episodes, config.evaluation_seed, config.acceleration_mps2
            )
        return Progress(
            episodes=self.episodes,
            of=config.episodes,
            reward=float(total.mean()),
            critic_loss=float(critic_loss) / max(updates, 1),
            q=float(q) / max(updates, 1),
            noise=scale,
            epsilon=epsilon,
            evaluation=evaluated,
        )

    @property
    def finished(self) -> bool:
        return self.episodes >= self.config.episodes

    name = "learner"

    def __call__(self, observation: Tensor, slot: int) -> Tensor:
        """The current actors as a `Policy`."""
        return self.agent.act(observation)

    def save(self, path: Path) -> None:
        """Write everything that `load` needs to go on as if nothing had happened."""
        tensors = {
            "episodes": torch.tensor(self.episodes),
            "best": torch.tensor(self.best, dtype=torch.float64),
            "generator": self.generator.get_state(),
            "environment": self.environment.generator.get_state(),
        }
        tensors |= {f"replay.{name}": value for name, value in self.replay.state().items()}
        for name, module in self.agent.modules().items():
            tensors |= {f"network.{name}.{key}": value for key, value in module.state_dict().items()}
        for name, optimiser in self.agent.optimisers().items():
            for index, moments in optimiser.state_dict()["state"].items():
                tensors |= {f"optimiser.{name}.{index}.{key}": value for key, value in moments.items()}
        part = path.with_name(path.name + ".part")
        save_file(tensors, part, metadata={"aerialstar": self._identity()})
        part.replace(path)

    def load(self, path: Path) -> None:
        """Take up a saved state. Raises TrainingError when there is none, or it is of another run."""
        if not path.is_file():
            raise TrainingError(f"resume: {path} does not exist")
        try:
            with safe_open(path, framework="pt") as file:
                identity = (file.metadata() or {}).get("aerialstar", "{}")
                tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        except SafetensorError as error:
            raise TrainingError(f"resume: {path} is not a safetensors file ({error})") from error
        self._require_same_run(path, json.loads(identity))
        self.episodes = int(tensors["episodes"])
        self.best = float(tensors["best"])
        self.generator.set_state(tensors["generator"])
        self.environment.generator.set_state(tensors["environment"])
        self.replay.load(_under(tensors, "replay."))
        for name, module in self.agent.modules().items():
            module.load_state_dict(_under(tensors, f"network.{name}."))
        for name, optimiser in self.agent.optimisers().items():
            state: dict[int, dict[str, Tensor]] = {}
            for key, value in _under(tensors, f"optimiser.{name}.").items():
                index, moment = key.split(".", 1)
                state.setdefault(int(index), {})[moment] = value
            optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})

    def _identity(self) -> str:
        return json.dumps(
            {"config": self.config.model_dump(mode="json"), "scenario": self.scenario.model_dump(mode="json")}
        )

    def _require_same_run(self, path: Path, saved: dict[str, dict[str, object]]) -> None:
        for part, ours in json.loads(self._identity()).items():
            for name, value in ours.items():
                theirs = saved.get(part, {}).get(name)
                if theirs != value:
                    raise TrainingError(f"resume: {path} was trained with {part} {name} = {theirs}, not {value}")


def train(
    scenario: Scenario,
    config: TrainingConfig,
    folder: Path,
    *,
    resume: bool = False,
    report: Callable[[Progress], None] = lambda progress: None,
) -> Result:
    """Train online and keep, in `folder`, the policy that did best at the evaluations.

    Writes `policy.safetensors`, `metrics.jsonl` (one line per round) and `state.safetensors` (for `resume`). `report`
    is called after every round. The result is judged on seeds of its own, since the kept policy was chosen on the
    evaluation's. Raises TrainingError, or OSError when the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    state_file, policy_file, metrics_file = folder / STATE_FILE, folder / POLICY_FILE, folder / METRICS_FILE
    learner = Learner(scenario, config)
    if resume:
        learner.load(state_file)
    elif state_file.exists() or policy_file.exists():
        raise TrainingError(f"{folder} holds a training run already: resume it, or name another folder")
    lines = metrics_file.read_text().splitlines() if resume else []
    metrics_file.write_text("".join(f"{line}\n" for line in lines if json.loads(line)["episodes"] <= learner.episodes))

    while not learner.finished:
        before = learner.episodes
        progress = learner.play()
        if progress.evaluation is not None and progress.evaluation.mean > learner.best:
            learner.best = progress.evaluation.mean
            save_policy(policy_file, learner.agent, scenario, config, {"episodes": progress.episodes})
        with metrics_file.open("a") as metrics:
            metrics.write(json.dumps(_metrics(progress)) + "\n")
        if learner.finished or learner.episodes // config.save_every > before // config.save_every:
            learner.save(state_file)
        report(progress)
    return judge(policy_file, scenario, config)


def require_time(scenario: Scenario, config: TrainingConfig) -> None:
    """Raise TrainingError when episodes are to end at a time that no state tells."""
    if config.time_limit == "terminates" and "time" not in scenario.state_extra:
        raise TrainingError("time_limit: 'terminates' needs the time in the state (the scenario's state_extra: [time])")


def save_policy(
    path: Path, agent: DualActorDdpg, scenario: Scenario, config: TrainingConfig, training: dict[str, object]
) -> None:
    """Write the actors as a checkpoint."""
    arrays = {
        f"{name}.{key}": value.numpy()
        for name, module in agent.modules().items()
        if name in ("continuous_actor", "discrete_actor")
        for key, value in module.state_dict().items()
    }
    checkpoint.save(path, checkpoint.Checkpoint(checkpoint.describe(scenario, config, training), arrays))


def judge(policy_file: Path, scenario: Scenario, config: TrainingConfig) -> Result:
    """Evaluate a policy file beside the baselines on seeds of its own, and note the outcome in the file."""
    seed, episodes, acceleration = config.evaluation_seed + 1, config.evaluation_episodes, config.acceleration_mps2
    trained = evaluate(TrainedPolicy(policy_file, scenario), scenario, episodes, seed, acceleration)
    others = baselines(scenario, episodes, seed, acceleration)
    kept = checkpoint.load(policy_file)
    outcome = {name: one.summary() for name, one in {"trained": trained, **others}.items()}
    metadata = kept.metadata.model_copy(update={"training": kept.metadata.training | {"seed": seed, **outcome}})
    checkpoint.save(policy_file, checkpoint.Checkpoint(metadata, kept.arrays))
    return Result(policy_file, trained, others)


def _metrics(progress: Progress) -> dict[str, object]:
    evaluation = progress.evaluation and progress.evaluation.summary()
    return {**vars(progress), "evaluation": evaluation}


def _under(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
