"""Offline training: behaviour cloning, then DA-DDPG updates held near the data, from transitions that were flown."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from agent.daddpg import DualActorDdpg, signs
from agent.observation import ends
from agent.policies import sizes
from agent.replay_buffer import Batch, ReplayBuffer
from agent.training import POLICY_FILE, Result, TrainingError, judge, require_time, save_policy
from agent.training_config import TrainingConfig
from rf_model.scenario import Scenario

BATCH_MIN = 2
"""Batch norm needs a spread."""


@dataclass(frozen=True)
class Transitions:
    """What was flown, slot by slot. Arrays of float32 with one row per transition."""

    observation: NDArray[np.float32]
    """[T, S], as `agent.observation.observe` gives."""
    action: NDArray[np.float32]
    """[T, A] raw action as executed."""
    reward: NDArray[np.float32]
    """[T]"""
    next_observation: NDArray[np.float32]
    """[T, S]"""
    terminated: NDArray[np.bool_]
    """[T]; a time limit does not terminate, unless `TrainingConfig.time_limit` says so."""


@dataclass(frozen=True)
class OfflineProgress:
    """How far offline training is."""

    updates: int
    of: int
    cloning: bool
    """Whether still cloning, or already improving by DA-DDPG."""
    loss: float
    """Cloning loss, or the critic's."""


def train_offline(
    scenario: Scenario,
    config: TrainingConfig,
    transitions: Transitions,
    folder: Path,
    *,
    report: Callable[[OfflineProgress], None] = lambda progress: None,
) -> Result:
    """Learn from flown transitions alone and write `policy.safetensors` into `folder`.

    First both actors imitate what was executed, then `config.offline_updates` DA-DDPG updates improve on it while the
    cloning loss keeps them near the data, where the critic knows what it says. The result is judged in simulated
    worlds of the same scenario. Fewer transitions than `config.batch_size` are sampled in batches of that many. Raises
    TrainingError when there are fewer than two, when they are not finite or of another scenario's sizes, when the
    folder holds a run already, or when `config.time_limit` needs a time that is not in the state.
    """
    require_time(scenario, config)
    agent = DualActorDdpg(sizes(scenario), config)
    replay = _replay(transitions, agent)
    batch_size = min(config.batch_size, len(replay))
    folder.mkdir(parents=True, exist_ok=True)
    policy_file = folder / POLICY_FILE
    if policy_file.exists():
        raise TrainingError(f"{folder} holds a training run already: name another folder")

    generator = torch.Generator().manual_seed(config.seed)
    total = config.clone_updates + config.offline_updates
    for count in range(1, total + 1):
        batch = replay.sample(batch_size, generator)
        cloning = count <= config.clone_updates
        loss = agent.clone(batch) if cloning else agent.update(batch, cloning=config.cloning).critic
        if count % 100 == 0 or count == total:
            report(OfflineProgress(updates=count, of=total, cloning=cloning, loss=float(loss)))
    save_policy(policy_file, agent, scenario, config, {"transitions": len(replay), "offline_updates": total})
    return judge(policy_file, scenario, config)


def _replay(transitions: Transitions, agent: DualActorDdpg) -> ReplayBuffer:
    """All transitions as a replay buffer, actions clipped and signs as -1 or +1, as decoding reads them."""
    count, size = len(transitions.reward), agent.sizes
    if count < BATCH_MIN:
        raise TrainingError(f"offline: {count} transitions are too few; at least {BATCH_MIN} are needed")
    for name, width in (("observation", size.state), ("next_observation", size.state), ("action", size.action)):
        shape = getattr(transitions, name).shape
        if shape != (count, width):
            raise TrainingError(f"offline: {name} is {shape}, the scenario's sizes want {(count, width)}")
    tensors = {name: torch.as_tensor(array, dtype=torch.float32) for name, array in vars(transitions).items()}
    for name, tensor in tensors.items():
        if not torch.isfinite(tensor).all():
            raise TrainingError(f"offline: {name} holds numbers that are not finite")
    if agent.config.time_limit == "terminates":
        tensors["terminated"] = tensors["terminated"].maximum(ends(tensors["next_observation"]).to(torch.float32))
    action = tensors["action"].clip(-1, 1)
    action[:, size.continuous :] = signs(action[:, size.continuous :])
    replay = ReplayBuffer(count, size.state, size.action)
    replay.add(Batch(**(tensors | {"action": action})))
    return replay
