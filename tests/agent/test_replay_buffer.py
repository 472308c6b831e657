import pytest
import torch

from agent.replay_buffer import Batch, ReplayBuffer


def numbered(first: int, count: int) -> Batch:
    """Transitions that carry their number in every field."""
    number = torch.arange(first, first + count, dtype=torch.float32)
    return Batch(
        observation=number[:, None].repeat(1, 3),
        action=-number[:, None].repeat(1, 2),
        reward=number,
        next_observation=number[:, None].repeat(1, 3) + 0.5,
        terminated=number % 2,
    )


def test_keeps_the_newest_when_it_wraps_around():
    buffer = ReplayBuffer(capacity=10, state_size=3, action_size=2)
    for first in range(0, 28, 4):
        buffer.add(numbered(first, 4))
    assert len(buffer) == 10
    seen = buffer.sample(2000, torch.Generator().manual_seed(0))
    assert set(seen.reward.tolist()) == set(map(float, range(18, 28)))


def test_fields_of_a_transition_stay_together():
    buffer = ReplayBuffer(capacity=7, state_size=3, action_size=2)
    for first in range(0, 15, 5):
        buffer.add(numbered(first, 5))
    seen = buffer.sample(500, torch.Generator().manual_seed(0))
    number = seen.reward
    assert torch.equal(seen.observation, number[:, None].expand(-1, 3))
    assert torch.equal(seen.action, -number[:, None].expand(-1, 2))
    assert torch.equal(seen.next_observation, number[:, None].expand(-1, 3) + 0.5)
    assert torch.equal(seen.terminated, number % 2)


def test_samples_uniformly_and_only_what_was_added():
    buffer = ReplayBuffer(capacity=1000, state_size=3, action_size=2)
    buffer.add(numbered(0, 8))
    counts = torch.bincount(buffer.sample(80_000, torch.Generator().manual_seed(1)).reward.long(), minlength=8)
    assert counts.shape == (8,)
    sigma = (80_000 * (1 / 8) * (7 / 8)) ** 0.5
    assert (counts - 10_000).abs().max() < 5 * sigma


def test_same_generator_state_gives_the_same_sample():
    buffer = ReplayBuffer(capacity=100, state_size=3, action_size=2)
    buffer.add(numbered(0, 50))
    first = buffer.sample(16, torch.Generator().manual_seed(3))
    assert torch.equal(first.reward, buffer.sample(16, torch.Generator().manual_seed(3)).reward)


def test_state_goes_on_where_it_was():
    buffer = ReplayBuffer(capacity=10, state_size=3, action_size=2)
    buffer.add(numbered(0, 7))
    other = ReplayBuffer(capacity=10, state_size=3, action_size=2)
    other.load(buffer.state())
    for replay in (buffer, other):
        replay.add(numbered(7, 6))
    assert all(torch.equal(value, other.state()[name]) for name, value in buffer.state().items())


def test_refuses_what_it_cannot_hold_or_give():
    buffer = ReplayBuffer(capacity=4, state_size=3, action_size=2)
    with pytest.raises(ValueError, match="empty"):
        buffer.sample(1, torch.Generator())
    with pytest.raises(ValueError, match="capacity 4 is smaller than one batch of 5"):
        buffer.add(numbered(0, 5))
