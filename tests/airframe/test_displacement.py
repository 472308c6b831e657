import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from airframe.displacement import spherical

distance = st.floats(0, 20)
elevation = st.floats(-math.pi / 2, math.pi / 2)
azimuth = st.floats(0, 2 * math.pi)


@pytest.mark.parametrize(
    ("move", "expected"),
    [
        ((10.0, 0.0, 0.0), (10.0, 0.0, 0.0)),
        ((10.0, 0.0, math.pi / 2), (0.0, 10.0, 0.0)),
        ((10.0, 0.0, math.pi), (-10.0, 0.0, 0.0)),
        ((10.0, math.pi / 2, 1.0), (0.0, 0.0, 10.0)),
        ((10.0, -math.pi / 6, 2 * math.pi), (10.0 * math.sqrt(3) / 2, 0.0, -5.0)),
    ],
)
def test_azimuth_is_counter_clockwise_from_east_and_elevation_is_upward(move, expected):
    assert spherical(*move) == pytest.approx(expected, abs=1e-12)


@given(distance, elevation, azimuth)
def test_a_spherical_move_is_as_long_as_its_distance(d, el, az):
    assert math.hypot(*spherical(d, el, az)) == pytest.approx(d, abs=1e-12)


@given(st.lists(st.tuples(distance, elevation, azimuth), min_size=1, max_size=5))
def test_tensors_with_batch_dimensions_decode_as_floats_do(moves):
    columns = torch.tensor(moves, dtype=torch.float64).T.reshape(3, 1, len(moves))
    decoded = spherical(*columns)
    for i, move in enumerate(moves):
        assert [part[0, i].item() for part in decoded] == pytest.approx(spherical(*move), abs=1e-12)
