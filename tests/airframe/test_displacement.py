import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from airframe.displacement import clip_norm, limit_climb, spherical

distance = st.floats(0, 20)
elevation = st.floats(-math.pi / 2, math.pi / 2)
azimuth = st.floats(0, 2 * math.pi)
component = st.floats(-1e3, 1e3)


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


@given(component, component, component, st.floats(0.1, 20))
def test_clipping_bounds_the_length_and_keeps_the_direction(dx, dy, dz, limit):
    clipped = clip_norm(dx, dy, dz, limit)
    length = math.hypot(dx, dy, dz)
    assert math.hypot(*clipped) == pytest.approx(min(length, limit), rel=1e-12, abs=1e-12)
    assert sum(a * b for a, b in zip(clipped, (dx, dy, dz), strict=True)) == pytest.approx(
        min(length, limit) * length, rel=1e-9, abs=1e-12
    )


@given(st.floats(-50, 50))
def test_climb_stays_within_the_rates(dz):
    assert limit_climb(dz, 2.0, up=3.0, down=1.5) == max(-3.0, min(6.0, dz))


@given(st.lists(st.tuples(distance, elevation, azimuth), min_size=1, max_size=5))
def test_tensors_with_batch_dimensions_decode_as_floats_do(moves):
    columns = torch.tensor(moves, dtype=torch.float64).T.reshape(3, 1, len(moves))
    decoded = clip_norm(*spherical(*columns), 7.0)
    climb = limit_climb(decoded[2], 1.0, 3.0, 1.5)
    for i, move in enumerate(moves):
        dx, dy, dz = clip_norm(*spherical(*move), 7.0)
        assert (decoded[0][0, i].item(), decoded[1][0, i].item()) == pytest.approx((dx, dy), abs=1e-12)
        assert climb[0, i].item() == pytest.approx(limit_climb(dz, 1.0, 3.0, 1.5), abs=1e-12)


def test_gradients_are_finite_at_rest():
    move = torch.zeros(3, requires_grad=True)
    sum(clip_norm(move[0], move[1], move[2], 10.0)).backward()
    assert torch.equal(move.grad, torch.ones(3))
