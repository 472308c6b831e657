import pytest
from hypothesis import given
from hypothesis import strategies as st

from airframe.stopping import stop_distance

positive = st.floats(0.1, 20)


def test_known_case():
    assert stop_distance(6.0, 3.0) == 6.0
    assert stop_distance(6.0, 3.0, reaction_s=0.5) == 9.0


@given(st.floats(0, 20), positive, st.floats(0, 3))
def test_stop_distance_by_integration(speed, deceleration, reaction_s):
    dt, travelled, v, t = 1e-3, 0.0, speed, 0.0
    while v > 0 and t < 300:
        slower = v if t < reaction_s else max(0.0, v - deceleration * dt)
        travelled += (v + slower) / 2 * dt
        v, t = slower, t + dt
        if v > 0 and t > reaction_s + 1:  # the rest in closed form: half of v times the time left
            travelled += v * (v / deceleration) / 2
            break
    assert stop_distance(speed, deceleration, reaction_s) == pytest.approx(travelled, abs=0.05)
