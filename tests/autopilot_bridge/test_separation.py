"""Vehicles that each keep to their own side never come nearer than the separation."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from autopilot_bridge.config import Limits
from autopilot_bridge.envelope import Envelope
from autopilot_bridge.fence import Box
from autopilot_bridge.separation import Track, nearest_points

LIMITS = Limits(horizontal_mps=10, up_mps=3, down_mps=1.5, acceleration_mps2=3)
FENCE = Box(x=(-60, 60), y=(-60, 60), z=(5, 60))
STEP_S, REACTION_S, APART_M = 0.05, 0.5, 5.0

commands = arrays(float, 3, elements=st.floats(-12, 12))
places = arrays(float, 3, elements=st.floats(-15, 15)).map(lambda place: place + np.array([0, 0, 25.0]))
velocities = arrays(float, 3, elements=st.floats(-5, 5))


def envelope():
    return Envelope(LIMITS, FENCE, REACTION_S, STEP_S, lambda velocity, yaw: None, separation_m=APART_M)


def fly(position, velocity, command):
    """Straight to the command at the acceleration limit; the end of one step."""
    change = command - velocity
    ramp_s = min(STEP_S, np.linalg.norm(change) / 3)
    new = velocity + change / max(1e-9, np.linalg.norm(change)) * 3 * ramp_s
    return position + (velocity + new) / 2 * ramp_s + new * (STEP_S - ramp_s), new


def ways_to_rest(position, velocity):
    """Points of reaction and braking, in plan."""
    stop = position + velocity * (REACTION_S + np.linalg.norm(velocity) / 6)
    return (position + np.linspace(0, 1, 60)[:, None] * (stop - position))[:, :2]


def apart(first, second):
    return np.hypot(*(first[:, None] - second[None]).transpose(2, 0, 1)).min()


@settings(max_examples=80, deadline=None)
@given(
    st.lists(st.tuples(places, velocities), min_size=2, max_size=3),
    st.lists(st.tuples(st.lists(commands, min_size=3, max_size=3), st.integers(1, 50)), min_size=1, max_size=4),
)
def test_vehicles_that_can_stop_apart_stay_apart(states, sequence):
    for index, (position, velocity) in enumerate(states):
        for other in states[:index]:
            assume(apart(ways_to_rest(position, velocity), ways_to_rest(*other)) > APART_M + 0.2)
    gate = envelope()
    for wanted, steps in sequence:
        for _ in range(steps):
            tracks = [Track(*state) for state in states]
            sent = [
                gate.clip(command, *state, [track for other, track in enumerate(tracks) if other != own]).velocity
                for own, (command, state) in enumerate(zip(wanted, states, strict=False))
            ]
            states = [fly(*state, command) for state, command in zip(states, sent, strict=True)]
            for index, (position, _) in enumerate(states):
                for other, _ in states[:index]:
                    assert math.dist(position[:2], other[:2]) >= APART_M - 1e-3


def test_two_that_fly_at_each_other_stop_and_say_why():
    gate, states = envelope(), [(np.array([-20.0, 0, 20]), np.zeros(3)), (np.array([20.0, 0, 40]), np.zeros(3))]
    wanted = [np.array([8.0, 0, 0]), np.array([-8.0, 0, 0])]
    for _ in range(400):
        tracks = [Track(*state) for state in states]
        sent = [gate.clip(wanted[i], *states[i], [tracks[1 - i]]) for i in range(2)]
        states = [fly(*state, each.velocity) for state, each in zip(states, sent, strict=True)]
    assert {each.reasons[-1] for each in sent} == {"separation"}
    assert math.dist(states[0][0][:2], states[1][0][:2]) == pytest.approx(APART_M, abs=0.3)


def test_what_is_old_is_kept_farther_from():
    gate, here = envelope(), np.array([0.0, 0, 20])
    other = np.array([7.0, 0, 20])
    command = np.array([0.3, 0, 0])
    assert gate.clip(command, here, np.zeros(3), [Track(other, np.zeros(3))]).reasons == ()
    old = Track(other, np.zeros(3), age_s=0.5)
    assert gate.clip(command, here, np.zeros(3), [old]).reasons == ("separation",)
    assert gate.clip(-command, here, np.zeros(3), [old]).reasons == ()  # away is always open


def test_the_whole_way_of_one_that_is_nobodys_is_kept_from():
    """Its bridge is gone; it flies from 40 m east to 40 m west of us, somewhere north of here."""
    other = Track(np.array([40.0, 6, 20]), np.zeros(3), stop=np.array([-40.0, 6, 20]))
    here, north = np.array([0.0, 0, 20]), np.array([0.0, 1, 0])
    assert envelope().clip(north, here, np.zeros(3), [other]).reasons == ("separation",)
    assert envelope().clip(-north, here, np.zeros(3), [other]).reasons == ()
    assert envelope().clip(north, here, np.zeros(3), [Track(other.position, other.velocity)]).reasons == ()


@given(arrays(float, (2, 2, 2), elements=st.floats(-20, 20)))
def test_the_nearest_points_of_two_segments(segments):
    ours, theirs = nearest_points(*segments.tolist())
    shares = np.linspace(0, 1, 150)[:, None]
    first, second = (segment[0] + shares * (segment[1] - segment[0]) for segment in segments)
    assert math.dist(ours, theirs) == pytest.approx(apart(first, second), abs=0.4)
    assert math.dist(ours, theirs) <= apart(first, second) + 1e-9
