import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from autopilot_bridge.config import Limits
from autopilot_bridge.transit import Transit

LIMITS = Limits(horizontal_mps=10, up_mps=3, down_mps=1.5, acceleration_mps2=3)
points = arrays(float, 3, elements=st.floats(-100, 100))


@given(points, points)
def test_straight_from_rest_to_rest_within_the_limits(start, goal):
    way = Transit(start, goal, LIMITS)
    times = np.linspace(0, way.duration_s, 500)
    track = [way.at(t) for t in times]
    positions = np.array([r.position for r in track])
    velocities = np.array([r.velocity for r in track])
    assert np.allclose(positions[0], start)
    assert np.allclose(positions[-1], goal)
    assert np.allclose(velocities[0], 0)
    assert np.allclose(way.at(way.duration_s + 1).velocity, 0)
    assert np.all(np.hypot(velocities[:, 0], velocities[:, 1]) <= LIMITS.horizontal_mps + 1e-6)
    assert np.all((velocities[:, 2] <= LIMITS.up_mps + 1e-6) & (velocities[:, 2] >= -LIMITS.down_mps - 1e-6))
    assert all(np.linalg.norm(r.acceleration) <= LIMITS.acceleration_mps2 + 1e-6 for r in track)
    step = times[1]
    if step > 0:
        assert np.allclose(np.diff(positions, axis=0), (velocities[1:] + velocities[:-1]) / 2 * step, atol=0.02)


def test_known_case():
    way = Transit(np.zeros(3), np.array([0, 0, 60.0]), LIMITS)
    assert way.duration_s == pytest.approx(60 / 3 + 1)  # 1 s to 3 m/s at 3 m/s2, the same to stop
    assert way.at(11.0).velocity == pytest.approx([0, 0, 3])
    assert way.at(10.5).position == pytest.approx([0, 0, 30])
