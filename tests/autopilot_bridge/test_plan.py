import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from airframe.slot_profile import brake
from autopilot_bridge.config import Limits
from autopilot_bridge.fence import Box
from autopilot_bridge.plan import plan_slot

BOX = Box(x=(-100, 100), y=(-100, 100), z=(30, 120))
LIMITS = Limits(horizontal_mps=10, up_mps=3, down_mps=1.5, acceleration_mps2=3)
JERKY = Limits(
    horizontal_mps=10,
    up_mps=2.5,
    down_mps=1.5,
    acceleration_mps2=2.5,
    vertical_acceleration_mps2=1.0,
    jerk_mps3=5.0,
)
"""ArduCopter's."""
moves = arrays(float, 3, elements=st.floats(-6, 6))


def fly(start, sequence, slot_s=1.0, reaction_s=0.25, limits=LIMITS):
    """References of a whole flight, 50 per slot, and the plans."""
    position, velocity, acceleration = np.array(start, float), np.zeros(3), np.zeros(3)
    track, plans = [], []
    for move in sequence:
        planned = plan_slot(position, velocity, move, slot_s, limits, BOX, reaction_s, acceleration)
        track.append(planned.profile.at(np.linspace(0, slot_s, 51)))
        plans.append(planned)
        position, velocity, acceleration = planned.profile.at(slot_s)
    return track, plans


def beyond(points):
    spans = np.array(BOX.spans)
    return np.maximum(spans[:, 0] - points, points - spans[:, 1]).max()


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from([(0, 0, 60), (100, 100, 120), (-100, 30, 30), (99, -99, 31)]),
    st.lists(moves | moves.map(lambda move: 2 * np.abs(move)), min_size=1, max_size=10),
    st.sampled_from([LIMITS, JERKY]),
    st.sampled_from([0.4, 1.0]),
)
def test_no_action_sequence_takes_the_plan_or_a_hold_out_of_the_box(start, sequence, limits, slot_s):
    """A hold that begins at any time up to the next action's deadline."""
    track, plans = fly(start, sequence, slot_s, 0.25 * slot_s, limits)
    assert beyond(np.concatenate([slot.position for slot in track])) <= 1e-3
    for planned in plans:
        for begin_s in np.linspace(slot_s, 1.25 * slot_s, 8):
            now = planned.profile.at(begin_s)
            hold = brake(now.position, now.velocity, limits.agility, now.acceleration)
            assert beyond(hold.at(np.linspace(0, hold.duration_s, 40)).position) <= 0.01


def test_pushing_against_a_wall_ends_at_rest_close_to_it():
    track, plans = fly((80, 0, 60), [np.array([10.0, 0, 0])] * 20)
    last = track[-1]
    assert 98 < last.position[-1][0] <= 100.001
    assert np.linalg.norm(last.velocity[-1]) < 0.3
    assert "box" in plans[-1].reasons


def test_slides_along_a_wall():
    track, _ = fly((100, 0, 60), [np.array([5.0, 1.0, 0])] * 10)
    assert track[-1].position[-1][1] > 5.0


def test_a_small_move_in_the_middle_is_planned_as_commanded():
    planned = plan_slot(np.array([0, 0, 60.0]), np.zeros(3), np.array([1.0, -0.5, 0.2]), 1.0, LIMITS, BOX, 0.25)
    assert planned.reasons == ()
    assert planned.profile.displacement(1.0) == pytest.approx([1.0, -0.5, 0.2])


def test_a_vehicle_found_outside_may_come_back_but_not_go_further():
    outside = np.array([110.0, 0, 60])
    back = plan_slot(outside, np.zeros(3), np.array([-1.0, 0, 0]), 1.0, LIMITS, BOX, 0.25)
    further = plan_slot(outside, np.zeros(3), np.array([1.0, 0, 0]), 1.0, LIMITS, BOX, 0.25)
    assert back.profile.displacement(1.0)[0] == pytest.approx(-1.0)
    assert further.profile.displacement(1.0)[0] == pytest.approx(0.0, abs=1e-3)
