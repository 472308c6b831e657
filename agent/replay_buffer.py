"""Experience replay, preallocated."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Batch:
    """Transitions. Observations [B, S], actions [B, A] raw as executed (signs as -1 or +1), the others [B]."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor
    """1 where the episode really ended; a time limit (truncation) leaves 0, so that the target bootstraps."""


class ReplayBuffer:
    """The newest `capacity` transitions, sampled uniformly with replacement."""

    def __init__(self, capacity: int, state_size: int, action_size: int) -> None:
        self.capacity = capacity
        self.added = 0
        self._store = Batch(
            observation=torch.zeros(capacity, state_size),
            action=torch.zeros(capacity, action_size),
            reward=torch.zeros(capacity),
            next_observation=torch.zeros(capacity, state_size),
            terminated=torch.zeros(capacity),
        )

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(self, batch: Batch) -> None:
        """Append a batch, overwriting the oldest. Raises ValueError when it is larger than the buffer."""
        count = batch.reward.shape[0]
        if count > self.capacity:
            raise ValueError(f"replay capacity {self.capacity} is smaller than one batch of {count}")
        slots = (self.added + torch.arange(count)) % self.capacity
        for name, column in vars(self._store).items():
            column[slots] = getattr(batch, name)
        self.added += count

    def sample(self, count: int, generator: torch.Generator) -> Batch:
        """Draw `count` transitions. Raises ValueError when the buffer is empty."""
        if len(self) == 0:
            raise ValueError("replay buffer is empty")
        rows = torch.randint(len(self), (count,), generator=generator)
        return Batch(**{name: column[rows] for name, column in vars(self._store).items()})

    def state(self) -> dict[str, Tensor]:
        """Everything needed to go on later, as tensors."""
        filled = {name: column[: len(self)] for name, column in vars(self._store).items()}
        return {**filled, "added": torch.tensor(self.added)}

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over what `state` gave."""
        self.added = int(state["added"])
        for name, column in vars(self._store).items():
            column[: len(self)] = state[name]
