import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linprog

from airframe.slot_profile import Agility, Reference, SpeedLimits, brake, reach

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


# With a jerk limit.

agilities = st.builds(Agility, st.floats(1, 6), st.floats(2, 40), st.sampled_from([1.0, 0.4]))
chains = st.lists(displacements, min_size=1, max_size=6)


def fly(moves, agility, slot_s):
    """Profiles of a whole flight, slot after slot."""
    here = Reference(np.zeros(3), np.zeros(3), np.zeros(3))
    for move in moves:
        profile = reach(here.position, here.velocity, move, slot_s, agility, LIMITS, here.acceleration)
        yield profile
        here = profile.at(slot_s)


@given(chains, agilities, slots)
def test_a_flight_of_slots_keeps_every_limit(moves, agility, slot_s):
    axes = np.array([1, 1, agility.vertical_share])
    before = np.zeros(3)
    for profile in fly(moves, agility, slot_s):
        track = profile.at(np.linspace(0, slot_s, 201))
        assert np.all(np.hypot(track.velocity[:, 0], track.velocity[:, 1]) <= LIMITS.horizontal + 1e-6)
        assert np.all(track.velocity[:, 2] <= LIMITS.up + 1e-6)
        assert np.all(track.velocity[:, 2] >= -LIMITS.down - 1e-6)
        assert np.all(np.linalg.norm(track.acceleration / axes, axis=-1) <= agility.acceleration + 1e-6)
        jerk = np.diff(track.acceleration, axis=0) / axes / (slot_s / 200)
        assert np.all(np.linalg.norm(jerk, axis=-1) <= agility.jerk * (1 + 1e-6))
        assert np.allclose(track.acceleration[0], before, atol=1e-6)  # no jump between slots
        before = track.acceleration[-1]


@given(chains, agilities, slots)
def test_with_a_jerk_limit_too_position_velocity_and_acceleration_belong_together(moves, agility, slot_s):
    for profile in fly(moves, agility, slot_s):
        fine = np.linspace(0, slot_s, 2001)
        track = profile.at(fine)
        for rate, integral in ((track.velocity, track.position), (track.acceleration, track.velocity)):
            steps = (rate[1:] + rate[:-1]) / 2 * fine[1]
            assert np.allclose(integral[0] + np.cumsum(steps, axis=0), integral[1:], atol=1e-4)


@given(chains, agilities, slots)
def test_with_a_jerk_limit_too_it_gets_there_unless_it_tells(moves, agility, slot_s):
    for move, profile in zip(moves, fly(moves, agility, slot_s), strict=True):
        if not profile.limited_by:
            assert profile.displacement(slot_s) == pytest.approx(move, abs=1e-5)


@settings(max_examples=15)
@given(st.floats(-3, 3), st.floats(-1, 1), agilities, st.floats(0.4, 2))
def test_no_way_inside_the_limits_gets_further(velocity, share, agility, slot_s):
    """Along a line, against a linear program over jerks."""
    acceleration = share * agility.acceleration
    speeds = SpeedLimits(1e3, 1e3, 1e3)
    start = (np.zeros(3), np.array([velocity, 0, 0]))
    profile = reach(*start, np.array([900.0 * slot_s, 0, 0]), slot_s, agility, speeds, np.array([acceleration, 0, 0]))
    assert "acceleration" in profile.limited_by
    count = 200
    dt = slot_s / count
    whole = np.tril(np.ones((count, count))) * dt  # jerks -> accelerations at the steps' ends
    times = slot_s - (np.arange(count) + 0.5) * dt
    gain = times**2 / 2 * dt  # jerks -> displacement
    limits = np.repeat([agility.acceleration - acceleration, agility.acceleration + acceleration], count)
    best = linprog(-gain, A_ub=np.vstack([whole, -whole]), b_ub=limits, bounds=(-agility.jerk, agility.jerk))
    furthest = velocity * slot_s + acceleration * slot_s**2 / 2 - best.fun
    assert profile.displacement(slot_s)[0] == pytest.approx(furthest, abs=0.02 * agility.acceleration * slot_s**2)


@given(st.floats(0, 10), st.floats(1, 6), st.floats(2, 40))
def test_the_classic_stop_under_a_jerk_limit(speed, acceleration, jerk):
    """From no acceleration: v/2 (v/a + a/j), or v sqrt(v/j) when the deceleration never reaches a."""
    long = speed >= acceleration**2 / jerk
    distance = speed / 2 * (speed / acceleration + acceleration / jerk) if long else speed * (speed / jerk) ** 0.5
    stop = brake(np.zeros(3), np.array([0.6 * speed, 0.8 * speed, 0]), Agility(acceleration, jerk)).at(100.0)
    assert np.linalg.norm(stop.position) == pytest.approx(distance, abs=1e-6)
    assert np.linalg.norm(stop.velocity) == pytest.approx(0, abs=1e-6)


@given(chains, agilities, slots, st.floats(0, 1))
def test_brakes_from_any_instant_of_a_flight(moves, agility, slot_s, share):
    *_, profile = fly(moves, agility, slot_s)
    now = profile.at(share * slot_s)
    hold = brake(now.position, now.velocity, agility, now.acceleration)
    assert hold.at(0.0).acceleration == pytest.approx(now.acceleration, abs=1e-6)
    end = hold.at(100.0)
    assert end.velocity == pytest.approx(np.zeros(3), abs=1e-6)
    assert end.acceleration == pytest.approx(np.zeros(3), abs=1e-9)
    times = np.linspace(0, 20, 4001)
    jerk = np.diff(hold.at(times).acceleration, axis=0) / times[1] / np.array([1, 1, agility.vertical_share])
    assert np.all(np.linalg.norm(jerk, axis=-1) <= agility.jerk * (1 + 1e-6))


@given(chains, agilities | st.floats(1, 6).map(Agility), slots, st.floats(0, 2))
def test_the_extent_is_that_of_the_way(moves, agility, slot_s, share):
    """Against a thousand instants."""
    for profile in fly(moves, agility, slot_s):
        way = profile.at(np.linspace(0, share * slot_s, 1001)).position
        low, high = profile.extent(share * slot_s)
        assert np.all(way >= np.array(low) - 1e-9)
        assert np.all(way <= np.array(high) + 1e-9)
        assert way.min(axis=0) == pytest.approx(low, abs=1e-3)
        assert way.max(axis=0) == pytest.approx(high, abs=1e-3)


@given(chains, agilities, slots, st.floats(0, 2))
def test_one_instant_is_the_same_as_among_many(moves, agility, slot_s, share):
    for profile in fly(moves, agility, slot_s):
        one, many = profile.at(share * slot_s), profile.at(np.array([0.0, share * slot_s]))
        for alone, among in zip(one, many, strict=True):
            assert np.array_equal(alone, among[1])
