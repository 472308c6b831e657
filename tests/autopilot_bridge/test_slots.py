import numpy as np
import pytest

from autopilot_bridge.config import BridgeConfig, Limits
from autopilot_bridge.slots import Slots

T0 = 50.0
CONFIG = BridgeConfig(
    clock={"kind": "paced"},
    slots=3,
    start_position_enu=(0, 0, 60),
    box={"x": (-100, 100), "y": (-100, 100), "z": (30, 120)},
)
START = np.array([0.0, 0.0, 60.0])
STILL = np.zeros(3)


@pytest.fixture
def slots():
    slots = Slots(CONFIG, Limits(), T0, START)
    slots.open(START, STILL, (0.0, 0.0, 0.0))
    return slots


def run_slot(slots, position=START):
    """Sample at 20 Hz to the next opening, and open it."""
    for tick in range(20):
        slots.sample(slots.opening_s + tick * 0.05, position, STILL)
    return slots.open(position, STILL, (0.0, 0.0, 0.0))


def test_openings_lie_on_the_grid_and_the_last_one_closes():
    slots = Slots(CONFIG, Limits(), T0, START)
    assert slots.due(T0)
    opened = [slots.open(START, STILL, (0.0, 0.0, 0.0))] + [run_slot(slots) for _ in range(3)]
    assert [o.slot for o in opened] == [0, 1, 2, 3]
    assert [o.time_s for o in opened] == [50.0, 51.0, 52.0, 53.0]
    assert [o.closing for o in opened] == [False, False, False, True]
    assert opened[0].flown is None
    assert [o.flown.slot for o in opened[1:]] == [0, 1, 2]
    assert slots.closed
    assert not slots.due(1e9)


def test_an_action_is_flown_as_planned(slots, make_action):
    slots.act(make_action(0, (1.0, 0.5, -0.2)), T0)
    assert slots.reference(T0 + 1).position == pytest.approx([1.0, 0.5, 59.8])
    flown = run_slot(slots, position=np.array([0.9, 0.4, 59.9])).flown
    assert flown.outcome == "flown"
    assert flown.reasons == []
    assert flown.commanded_enu == (1.0, 0.5, -0.2)
    assert flown.planned_enu == pytest.approx((1.0, 0.5, -0.2))
    assert flown.flown_enu == pytest.approx((0.9, 0.4, -0.1))


def test_track_and_plan_are_sampled_at_10_hz_from_the_opening_on(slots, make_action):
    slots.act(make_action(0, (1.0, 0.0, 0.0)), T0)
    flown = run_slot(slots).flown
    assert [s.time_s for s in flown.track] == pytest.approx([T0 + 0.1 * i for i in range(10)])
    assert [s.time_s for s in flown.plan] == [s.time_s for s in flown.track]
    assert flown.plan[0].position_enu == (0.0, 0.0, 60.0)
    assert 0 < flown.plan[5].position_enu[0] < 1


@pytest.mark.parametrize(
    ("displacement", "outcome", "reasons"),
    [((10.0, 0.0, 0.0), "flown", ["acceleration"]), ((0.5, 0.0, 5.0), "clipped", ["climb", "acceleration"])],
)
def test_what_the_limits_take_is_told_but_reach_alone_is_no_clipping(
    slots, make_action, displacement, outcome, reasons
):
    slots.act(make_action(0, displacement), T0)
    flown = run_slot(slots).flown
    assert (flown.outcome, flown.reasons) == (outcome, reasons)
    assert np.linalg.norm(flown.planned_enu) == pytest.approx(1.5)


def test_the_next_slot_starts_where_the_profile_ended(slots, make_action):
    slots.act(make_action(0, (1.0, 0.0, 0.0)), T0)
    before = slots.reference(T0 + 1 - 1e-9)
    run_slot(slots)
    slots.act(make_action(1, (-1.0, 0.0, 0.0)), T0 + 1.02)
    after = slots.reference(T0 + 1)
    assert after.position == pytest.approx(before.position, abs=1e-6)
    assert after.velocity == pytest.approx(before.velocity, abs=1e-6)


def test_no_action_brakes_to_a_hold(slots, make_action):
    slots.act(make_action(0, (1.5, 0.0, 0.0)), T0)  # ends at 3 m/s
    run_slot(slots)
    assert slots.reference(T0 + 1.25).velocity == pytest.approx([3.0, 0, 0])
    slots.hold(T0 + 1.25, "missing", "no action by the deadline")
    assert slots.reference(T0 + 2.25).velocity == pytest.approx([0, 0, 0])
    flown = run_slot(slots).flown
    assert flown.outcome == "missing"
    assert flown.commanded_enu == (0.0, 0.0, 0.0)
    assert flown.planned_enu == pytest.approx((0.75 + 3 * 0.75 - 1.5 * 0.75**2, 0, 0))


def test_an_action_after_the_hold_is_late_and_not_flown(slots, make_action):
    slots.hold(T0 + 0.25, "missing", "no action by the deadline")
    slots.act(make_action(0, (1.0, 0.0, 0.0)), T0 + 0.5)
    flown = run_slot(slots).flown
    assert flown.outcome == "late"
    assert flown.planned_enu == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("displacement", "outcome"),
    [((10.0001, 0, 0), "clipped"), ((10.001, 0, 0), "rejected"), ((6, 6, 6), "rejected")],
)
def test_a_displacement_beyond_v_max_is_rejected(slots, make_action, displacement, outcome):
    slots.act(make_action(0, displacement), T0)
    flown = run_slot(slots).flown
    assert flown.outcome == outcome
    if outcome == "rejected":
        assert "at most 10 m" in flown.reasons[0]
        assert flown.commanded_enu == (0.0, 0.0, 0.0)


def test_actions_for_other_slots_and_second_ones_change_nothing(slots, make_action):
    slots.act(make_action(1, (1.0, 0.0, 0.0)), T0)
    assert slots.awaiting
    slots.act(make_action(0, (1.0, 0.0, 0.0)), T0)
    slots.act(make_action(0, (-1.0, 0.0, 0.0)), T0)
    assert run_slot(slots).flown.commanded_enu == (1.0, 0.0, 0.0)


def test_a_held_action_is_rejected_but_a_sign_of_life(slots, make_action):
    assert slots.act(make_action(0, (1.0, 0.0, 0.0)), T0 + 0.1, held_because="held by command")
    flown = run_slot(slots).flown
    assert (flown.outcome, flown.reasons) == ("rejected", ["held by command"])


def test_only_the_first_good_action_for_the_open_slot_is_a_sign_of_life(slots, make_action):
    assert not slots.act(make_action(1, (1.0, 0.0, 0.0)), T0)
    assert slots.act(make_action(0, (1.0, 0.0, 0.0)), T0)
    assert not slots.act(make_action(0, (1.0, 0.0, 0.0)), T0)
    run_slot(slots)
    assert not slots.act(make_action(1, (11.0, 0.0, 0.0)), T0 + 1)
    run_slot(slots)
    slots.hold(T0 + 2.25, "missing", "no action by the deadline")
    assert not slots.act(make_action(2, (1.0, 0.0, 0.0)), T0 + 2.5)


def test_what_the_envelope_changed_is_told(slots, make_action):
    slots.act(make_action(0, (1.0, 0.0, 0.0)), T0)
    slots.clipped("envelope: fence")
    slots.clipped("envelope: fence")
    flown = run_slot(slots).flown
    assert (flown.outcome, flown.reasons) == ("clipped", ["envelope: fence"])


def test_nothing_said_at_all_is_missing(slots):
    assert run_slot(slots).flown.outcome == "missing"


def test_a_plan_does_not_run_away_from_a_vehicle_that_the_envelope_holds_back(slots, make_action):
    began = START
    for number in range(2):
        slots.act(make_action(number, (8.0, 0.0, 0.0)), slots.opening_s)
        slots.clipped("envelope: separation")
        ahead = slots.reference(slots.opening_s + 1.0).position
        place = ahead - np.array([2.5, 0.0, 0.0])
        flown = run_slot(slots, position=place).flown
        assert flown.planned_enu == pytest.approx(ahead - began), "what was planned is told as it was"
        assert slots.reference(slots.opening_s).position == pytest.approx(place), "the next plan begins where it is"
        assert slots.order is None
        began = place


def test_what_tracking_loses_does_not_leak_into_the_plan(slots, make_action):
    slots.act(make_action(0, (8.0, 0.0, 0.0)), T0)
    ahead = slots.reference(T0 + 1.0).position
    run_slot(slots, position=ahead - np.array([5.0, 0.0, 0.0]))
    assert slots.reference(slots.opening_s).position == pytest.approx(ahead), "nobody held it back"


def test_a_touch_of_the_envelope_leaves_the_plan_whole(slots, make_action):
    slots.act(make_action(0, (1.0, 0.0, 0.0)), T0)
    slots.clipped("envelope: fence")
    run_slot(slots, position=np.array([0.2, 0.0, 60.0]))
    assert slots.reference(slots.opening_s).position == pytest.approx([1.0, 0.0, 60.0])
