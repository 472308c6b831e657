"""The policies that a mission file may name, and how they are made."""

from pathlib import Path

import torch
from torch import Tensor

from agent import checkpoint
from agent.daddpg import Sizes, signs
from agent.decoding import action_size, continuous_size, discrete_size
from agent.networks import Actor
from agent.observation import state_size
from agent.policy import Policy, PolicyConfig
from rf_model.scenario import Scenario
from rf_model.seeding import seed_of


def sizes(scenario: Scenario) -> Sizes:
    """Sizes of state and action in `scenario`."""
    return Sizes(state=state_size(scenario), continuous=continuous_size(scenario), discrete=discrete_size(scenario))


def make_policy(config: PolicyConfig, scenario: Scenario, seed: int) -> Policy:
    """Build what `config` names. Raises CheckpointError when its checkpoint is missing or does not fit."""
    if config.checkpoint_path is not None:
        return TrainedPolicy(config.checkpoint_path, scenario)
    if config.kind == "random":
        return RandomPolicy(scenario, seed)
    return HoverPolicy(scenario)


class TrainedPolicy:
    """The actor pair of a checkpoint, without exploration."""

    def __init__(self, path: Path, scenario: Scenario) -> None:
        loaded = checkpoint.load(path)
        checkpoint.require_fit(path, loaded.metadata, scenario)
        self.name = path.stem
        size, hidden = sizes(scenario), loaded.metadata.hidden
        self._continuous = _actor(path, loaded, "continuous_actor.", Actor(size.state, size.continuous, hidden))
        self._discrete = _actor(path, loaded, "discrete_actor.", Actor(size.state, size.discrete, hidden))

    def __call__(self, observation: Tensor, slot: int) -> Tensor:
        rows = observation.reshape(-1, observation.shape[-1])
        with torch.inference_mode():
            raw = torch.cat([self._continuous(rows), signs(self._discrete(rows))], dim=-1)
        return raw.reshape(*observation.shape[:-1], -1)


class RandomPolicy:
    """Uniform raw actions, drawn from a generator seeded by (seed, slot)."""

    name = "random"

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self._size = action_size(scenario)
        self._seed = seed

    def __call__(self, observation: Tensor, slot: int) -> Tensor:
        generator = torch.Generator().manual_seed(seed_of(self._seed, slot))
        shape = (*observation.shape[:-1], self._size)
        return torch.rand(shape, generator=generator, dtype=observation.dtype) * 2 - 1


class HoverPolicy:
    """No motion and the rf node's neutral configuration: theta_R = 0, equal split, sign +1, W on identity columns."""

    name = "hover"

    def __init__(self, scenario: Scenario) -> None:
        raw = torch.zeros(action_size(scenario))
        if scenario.motion == "spherical":
            raw[0] = -1  # distance 0
        beams = torch.zeros(scenario.antennas, scenario.users, 2)
        for user in range(scenario.users):
            beams[user % scenario.antennas, user, 0] = 1
        continuous = continuous_size(scenario)
        raw[continuous - beams.numel() : continuous] = beams.flatten()
        raw[continuous:] = 1
        self._raw = raw

    def __call__(self, observation: Tensor, slot: int) -> Tensor:
        return self._raw.to(observation.dtype).expand(*observation.shape[:-1], -1)


def _actor(path: Path, loaded: checkpoint.Checkpoint, prefix: str, actor: Actor) -> Actor:
    """Fill `actor` with a checkpoint's arrays, ready to act."""
    arrays = {
        name.removeprefix(prefix): torch.from_numpy(array)
        for name, array in loaded.arrays.items()
        if name.startswith(prefix)
    }
    try:
        actor.load_state_dict(arrays)
    except RuntimeError as error:
        why = " ".join(str(error).split())
        raise checkpoint.CheckpointError(f"checkpoint {path}: weights do not match its metadata ({why})") from error
    return actor.eval()
