import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from airframe.slot_profile import SpeedLimits, brake, reach

LIMITS = SpeedLimits(horizontal=10.0, up=3.0, down=1.5)
accelerations = st.floats(0.5, 8)
slots = st.floats(0.2, 3)
displacements = arrays(float, 3, elements=st.floats(-20, 20))
times = np.linspace(0, 1, 41)


@st.composite
def velocities(draw):
    speed, heading = draw(st.floats(0, LIMITS.horizontal)), draw(st.floats(0, 6.3))
    return np.array([speed * np.cos(heading), speed * np.sin(heading), draw(st.floats(-LIMITS.down, LIMITS.up))])


@given(velocities(), displacements, slots, accelerations)
def test_every_velocity_and_acceleration_is_within_the_limits(velocity, displacement, slot_s, acceleration):
    track = reach(np.zeros(3), velocity, displacement, slot_s, acceleration, LIMITS).at(times * slot_s)
    assert np.all(np.hypot(track.velocity[:, 0], track.velocity[:, 1]) <= LIMITS.horizontal + 1e-6)
    assert np.all(track.velocity[:, 2] <= LIMITS.up + 1e-6)
    assert np.all(track.velocity[:, 2] >= -LIMITS.down - 1e-6)
    assert np.all(np.linalg.norm(track.acceleration, axis=-1) <= acceleration + 1e-9)


@given(velocities(), displacements, slots, accelerations)
def test_position_velocity_and_acceleration_belong_together(velocity, displacement, slot_s, acceleration):
    profile = reach(np.ones(3), velocity, displacement, slot_s, acceleration, LIMITS)
    fine = np.linspace(0, slot_s, 2001)
    track = profile.at(fine)
    step = fine[1]
    midway = (track.velocity[1:] + track.velocity[:-1]) / 2
    assert np.allclose(1.0 + np.cumsum(midway * step, axis=0), track.position[1:], atol=1e-5)
    assert np.all(np.linalg.norm(np.diff(track.velocity, axis=0), axis=-1) <= acceleration * step + 1e-9)


@given(velocities(), displacements, st.floats(0.5, 2), accelerations)
@example(np.zeros(3), np.array([1e-300, 0, 0]), 0.75, 1.0)  # rounding is no limit
def test_reaches_the_displacement_when_nothing_limits(velocity, displacement, slot_s, acceleration):
    profile = reach(np.zeros(3), velocity, displacement, slot_s, acceleration, LIMITS)
    if not profile.limited_by:
        assert profile.displacement(slot_s) == pytest.approx(displacement, abs=1e-6)
    else:
        # told, and true: at least one limit is really in the way
        gap = np.linalg.norm(displacement - velocity * slot_s)
        end = profile.at(slot_s).velocity
        at_speed = np.hypot(*end[:2]) > LIMITS.horizontal - 1e-6 or not -1.5 + 1e-6 < end[2] < 3 - 1e-6
        too_fast = np.hypot(*displacement[:2]) > LIMITS.horizontal * slot_s
        too_fast |= not -LIMITS.down * slot_s <= displacement[2] <= LIMITS.up * slot_s
        assert too_fast or at_speed or gap > acceleration * slot_s**2 / 2


@given(arrays(float, 3, elements=st.floats(-0.8, 0.8)))
def test_from_rest_the_classic_ramp(displacement):
    distance = np.linalg.norm(displacement)
    assume(distance > 0.01)
    profile = reach(np.zeros(3), np.zeros(3), displacement, 1.0, 3.0, SpeedLimits(10, 10, 10))
    # s T - s^2 / (2 a) = d, the smaller root
    speed = min(r.real for r in np.roots([-1 / 6, 1.0, -distance]))
    assert np.linalg.norm(profile.at(1.0).velocity) == pytest.approx(speed, rel=1e-6)


@given(velocities(), displacements, slots, accelerations)
def test_never_moves_away_from_the_wanted_mean_velocity(velocity, displacement, slot_s, acceleration):
    """Speed limits shorten the ramp but never stall it: the gap to the displacement shrinks against coasting."""
    profile = reach(np.zeros(3), velocity, displacement, slot_s, acceleration, LIMITS)
    mean = displacement / slot_s
    assume(np.hypot(*mean[:2]) <= LIMITS.horizontal and -LIMITS.down <= mean[2] <= LIMITS.up)
    coasting = np.linalg.norm(displacement - velocity * slot_s)
    missed = np.linalg.norm(displacement - profile.displacement(slot_s))
    assert missed <= coasting + 1e-6
    if coasting > 1e-3:
        assert missed < coasting


@given(st.lists(displacements, min_size=2, max_size=6))
def test_slots_join_without_a_jump(moves):
    position, velocity = np.zeros(3), np.zeros(3)
    for move in moves:
        profile = reach(position, velocity, move, 1.0, 3.0, LIMITS)
        start = profile.at(0.0)
        assert np.array_equal(start.position, position)
        assert np.array_equal(start.velocity, velocity)
        position, velocity, _ = profile.at(1.0)


@given(velocities(), accelerations)
def test_braking_ends_at_rest_after_the_stop_distance(velocity, acceleration):
    speed = np.linalg.norm(velocity)
    profile = brake(np.zeros(3), velocity, acceleration)
    for later in (speed / acceleration, 60.0):
        end = profile.at(later)
        assert np.linalg.norm(end.velocity) == pytest.approx(0.0, abs=1e-6)
        assert np.linalg.norm(end.position) == pytest.approx(speed**2 / (2 * acceleration), abs=1e-6)
