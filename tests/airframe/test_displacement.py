import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from airframe.displacement import spherical

distance = st.floats(0, 20)
elevation = st.floats(-math.pi / 2, math.pi / 2)
azimuth = st.floats(0, 2 * math.pi)
COMPASS = [
    ((10.0, 0.0, 0.0), (10.0, 0.0, 0.0)),
    ((10.0, 0.0, math.pi / 2), (0.0, 10.0, 0.0)),
    ((10.0, 0.0, math.pi), (-10.0, 0.0, 0.0)),
    ((10.0, math.pi / 2, 1.0), (0.0, 0.0, 10.0)),
    ((10.0, -math.pi / 6, 2 * math.pi), (10.0 * math.sqrt(3) / 2, 0.0, -5.0)),
]


def displacements(moves):
    """[B, 3] of B moves."""
    return torch.stack(spherical(*torch.tensor(moves, dtype=torch.float64).unbind(-1)), dim=-1)


def test_azimuth_is_counter_clockwise_from_east_and_elevation_is_upward():
    moves, expected = zip(*COMPASS, strict=True)
    assert displacements(moves).flatten().tolist() == pytest.approx(
        [part for row in expected for part in row], abs=1e-12
    )


@given(st.lists(st.tuples(distance, elevation, azimuth), min_size=1, max_size=5))
def test_a_spherical_move_is_as_long_as_its_distance(moves):
    lengths = [move[0] for move in moves]
    assert displacements(moves).norm(dim=-1).tolist() == pytest.approx(lengths, abs=1e-12)


def test_shapes_broadcast():
    distances, azimuths = torch.tensor([[1.0], [2.0]]), torch.tensor([0.0, 1.0, 2.0])
    east, north, up = spherical(distances, torch.tensor(0.5), azimuths)
    assert east.shape == north.shape == (2, 3)
    torch.testing.assert_close(east[1, 2], 2 * torch.tensor(0.5).cos() * torch.tensor(2.0).cos())
    torch.testing.assert_close(up, distances * torch.tensor(0.5).sin())
