"""The mission protocol's state machine: what any sequence of events may and may not do to it."""

import math
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sitl.plan import (
    CIRCLE_INCLUSION,
    DO_JUMP,
    FRAME_MISSION,
    POLYGON_INCLUSION,
    TAKEOFF,
    WAYPOINT,
    Item,
    Kind,
    Verdict,
    judge,
    judge_whole,
)
from sitl.transfer import (
    IDLE,
    Ack,
    Ask,
    Client,
    Count,
    Download,
    Give,
    Idle,
    Rules,
    Say,
    Store,
    Upload,
    on_ack,
    on_clear,
    on_count,
    on_item,
    on_list,
    on_request,
    on_time,
)

RULES = Rules(capacity=(20, 8), retry_ms=250, timeout_ms=5000, busy=Verdict.ERROR)
ALICE, BOB = Client("gcs", 255, 190), Client("companion", 240, 191)
NAN = math.nan


def waypoint(x=473977430, y=85455940, z=10.0, frame=6, command=WAYPOINT, p=(0.0, 0.0, 0.0, NAN)):
    return Item(frame, command, p, x, y, z)


# Any events in any order

items = st.builds(
    Item,
    frame=st.sampled_from([0, 2, 3, 6, 10]),
    command=st.sampled_from([16, 20, 21, 22, 34, 177, 178, 5001, 5003]),
    p=st.tuples(*[st.floats(width=32)] * 4),
    x=st.integers(-(2**31), 2**31 - 1),
    y=st.integers(-(2**31), 2**31 - 1),
    z=st.floats(width=32),
)
clients = st.sampled_from([ALICE, BOB])
kinds = st.integers(0, 255)
few = st.integers(0, 30)
events = st.one_of(
    st.tuples(st.just("count"), clients, st.one_of(st.integers(0, 2), kinds), few),
    st.tuples(st.just("item"), clients, st.integers(0, 2), few, st.one_of(items, st.just(waypoint())), st.booleans()),
    st.tuples(st.just("next"), clients, st.one_of(items, st.just(waypoint())), st.booleans()),
    st.tuples(st.just("list"), clients, kinds),
    st.tuples(st.just("request"), clients, st.integers(0, 2), few, st.booleans()),
    st.tuples(st.just("ack"), clients),
    st.tuples(st.just("clear"), clients, kinds),
    st.tuples(st.just("wait"), st.integers(1, 6000)),
)


def happen(state, event, plans, now):
    """The machine's step for an event."""
    match event:
        case ("count", client, kind, count):
            return on_count(state, client, kind, count, now, RULES)
        case ("item", client, kind, seq, item, integer):
            return on_item(state, client, kind, seq, item, integer, now, RULES)
        case ("next", client, item, integer):  # a client that goes on properly
            kind, seq = (state.kind, len(state.items)) if isinstance(state, Upload) else (0, 0)
            return on_item(state, client, kind, seq, item, integer, now, RULES)
        case ("list", client, kind):
            return on_list(state, client, kind, plans.get(kind, ()), now, RULES)
        case ("request", client, kind, seq, integer):
            return on_request(state, client, kind, seq, integer, now)
        case ("ack", client):
            return on_ack(state, client)
        case ("clear", client, kind):
            return on_clear(state, client, kind, RULES)
        case _:
            return on_time(state, now, RULES)


@settings(max_examples=300, deadline=None)
@given(st.lists(events, max_size=60))
def test_any_sequence_of_events_keeps_the_invariants(sequence):
    state, now = IDLE, 0
    plans: dict[int, tuple[Item, ...]] = {}
    given_out: tuple[Item, ...] = ()
    for event in sequence:
        now += event[1] if event[0] == "wait" else 10
        before = state
        state, deeds = happen(state, event, plans, now)
        assert len(deeds) <= 4
        for deed in deeds:
            if isinstance(deed, Store):
                assert len(deed.items) <= RULES.capacity[deed.kind]
                assert all(judge(item, deed.kind) is Verdict.ACCEPTED for item in deed.items)
                assert judge_whole(deed.items, deed.kind) is Verdict.ACCEPTED
                assert any(isinstance(d, Ack) and d.verdict is Verdict.ACCEPTED for d in deeds)
                if deed.items:  # only a whole upload is ever stored
                    assert isinstance(before, Upload)
                    assert len(deed.items) == before.count
                plans[deed.kind] = deed.items
            elif isinstance(deed, Give):
                assert deed.item is given_out[deed.seq]
            elif isinstance(deed, Ask):
                assert isinstance(state, Upload)
                assert (deed.client, deed.kind, deed.seq) == (state.client, state.kind, len(state.items))
        if isinstance(state, Upload):
            assert len(state.items) < state.count <= RULES.capacity[state.kind]
        if isinstance(state, Download) and not (isinstance(before, Download) and state.items is before.items):
            given_out = plans[state.kind]  # a download shows the plan as it was when it began
            assert state.items is given_out
        # A transfer in progress is nobody else's to end.
        if not isinstance(before, Idle) and event[0] != "wait" and event[1] != before.client:
            assert isinstance(state, type(before))
            assert state.client == before.client
    state, _ = on_time(state, now + RULES.timeout_ms, RULES)
    assert isinstance(state, Idle)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 20), st.integers(0, 2**32), st.booleans())
def test_an_upload_survives_lost_frames(count, seed, integer):
    """0.5 s client timeouts, items and requests lost at random one time in three: the plan arrives whole."""
    random = Random(seed)
    plan = tuple(waypoint(x=i) for i in range(count))
    state, deeds = on_count(IDLE, ALICE, 0, count, 0, RULES)
    stored = None
    for now in range(10, 60_000, 10):
        for deed in deeds:
            if isinstance(deed, Store):
                stored = deed.items
        asked = [d.seq for d in deeds if isinstance(d, Ask) and random.random() > 1 / 3]
        if asked and random.random() > 1 / 3:
            state, deeds = on_item(state, ALICE, 0, asked[0], plan[asked[0]], integer, now, RULES)
        else:
            state, deeds = on_time(state, now, RULES)
        if stored is not None:
            break
    assert stored == plan


# Single cases


def test_upload_asks_item_by_item_and_stores_at_the_end():
    """AUTOPILOT.md 1: mission COUNT -> REQUEST_INT xn -> ACK."""
    state, deeds = on_count(IDLE, ALICE, 0, 2, 0, RULES)
    assert deeds == (Ask(ALICE, Kind.MISSION, 0, True),)
    state, deeds = on_item(state, ALICE, 0, 0, waypoint(command=TAKEOFF), True, 10, RULES)
    assert deeds == (Ask(ALICE, Kind.MISSION, 1, True),)
    state, deeds = on_item(state, ALICE, 0, 1, waypoint(), True, 20, RULES)
    assert state is IDLE
    assert deeds == (
        Store(Kind.MISSION, (waypoint(command=TAKEOFF), waypoint())),
        Ack(ALICE, Kind.MISSION, Verdict.ACCEPTED),
    )


def test_a_client_of_floats_is_asked_for_floats():
    state, _ = on_count(IDLE, ALICE, 0, 2, 0, RULES)
    _, deeds = on_item(state, ALICE, 0, 0, waypoint(), False, 10, RULES)
    assert deeds == (Ask(ALICE, Kind.MISSION, 1, False),)


@pytest.mark.parametrize(
    ("item", "verdict"),
    [
        (waypoint(command=34), Verdict.UNSUPPORTED),  # AUTOPILOT.md 1: unsupported item: ACK 3
        (waypoint(frame=10), Verdict.UNSUPPORTED_FRAME),
        (waypoint(frame=FRAME_MISSION), Verdict.UNSUPPORTED_FRAME),
        (waypoint(x=90 * 10**7 + 1), Verdict.INVALID_PARAM5_X),
        (waypoint(y=-(2**31)), Verdict.INVALID_PARAM6_Y),
        (waypoint(z=NAN), Verdict.INVALID_PARAM7),
        (waypoint(z=math.inf), Verdict.INVALID_PARAM7),
        (waypoint(p=(math.inf, 0.0, 0.0, 0.0)), Verdict.INVALID),
        (waypoint(command=178, p=(1.0, NAN, 0.0, 0.0)), Verdict.INVALID_PARAM2),
        (waypoint(command=DO_JUMP, frame=2, p=(5.0, 1.0, 0.0, 0.0)), Verdict.INVALID_PARAM1),
        (waypoint(command=DO_JUMP, frame=2, p=(NAN, 1.0, 0.0, 0.0)), Verdict.INVALID_PARAM1),
    ],
)
def test_a_bad_item_ends_the_upload_and_keeps_the_old_plan(item, verdict):
    state, _ = on_count(IDLE, ALICE, 0, 1, 0, RULES)
    state, deeds = on_item(state, ALICE, 0, 0, item, True, 10, RULES)
    assert state is IDLE
    assert deeds == (Ack(ALICE, Kind.MISSION, verdict),)


@pytest.mark.parametrize(
    ("fence", "verdict"),
    [
        ([(POLYGON_INCLUSION, 3.0)] * 3, Verdict.ACCEPTED),
        ([(CIRCLE_INCLUSION, 50.0)], Verdict.ACCEPTED),
        ([(POLYGON_INCLUSION, 3.0)] * 3 + [(CIRCLE_INCLUSION, 5.0)], Verdict.ACCEPTED),
        ([(POLYGON_INCLUSION, 4.0)] * 3, Verdict.INVALID),
        ([(POLYGON_INCLUSION, 3.0)] * 2 + [(POLYGON_INCLUSION, 4.0)], Verdict.INVALID),
        ([(POLYGON_INCLUSION, 3.0)] * 2 + [(CIRCLE_INCLUSION, 5.0)], Verdict.INVALID),
        ([(POLYGON_INCLUSION, 2.0)] * 2, Verdict.INVALID_PARAM1),
        ([(POLYGON_INCLUSION, NAN)] * 3, Verdict.INVALID_PARAM1),
        ([(CIRCLE_INCLUSION, 0.0)], Verdict.INVALID_PARAM1),
        ([(WAYPOINT, 0.0)], Verdict.UNSUPPORTED),
    ],
)
def test_fences_are_judged(fence, verdict):
    state, deeds = on_count(IDLE, ALICE, 1, len(fence), 0, RULES)
    for seq, (command, p1) in enumerate(fence):
        if isinstance(state, Upload):
            item = waypoint(command=command, p=(p1, 0.0, 0.0, 0.0), frame=0)
            state, deeds = on_item(state, ALICE, 1, seq, item, True, 10, RULES)
    assert deeds[-1] == Ack(ALICE, Kind.FENCE, verdict)


def test_second_upload_meanwhile_is_busy():
    """AUTOPILOT.md 1: a second upload meanwhile: ACK 1 and "Busy"; the first goes on."""
    state, _ = on_count(IDLE, ALICE, 0, 2, 0, RULES)
    assert on_count(state, BOB, 0, 3, 5, RULES) == (
        state,
        (Say("WPM: REJ. CMD: Busy"), Ack(BOB, 0, Verdict.ERROR)),
    )
    state, _ = on_item(state, ALICE, 0, 0, waypoint(), True, 10, RULES)
    after, deeds = on_count(state, ALICE, 0, 2, 20, RULES)  # PX4: also from the same client
    assert (after, deeds[-1]) == (state, Ack(ALICE, 0, Verdict.ERROR))
    state, deeds = on_item(state, ALICE, 0, 1, waypoint(), True, 30, RULES)
    assert deeds[-1] == Ack(ALICE, 0, Verdict.ACCEPTED)


def test_a_client_that_vanishes_is_asked_again_and_then_given_up():
    state, _ = on_count(IDLE, ALICE, 0, 2, 0, RULES)
    asked = 0
    for now in range(10, 5000, 10):
        state, deeds = on_time(state, now, RULES)
        asked += len(deeds)
    assert asked == 19
    state, deeds = on_time(state, 5000, RULES)
    assert state is IDLE
    assert deeds[0] == Say("Operation timeout")


def test_zero_items_clear_and_ten_thousand_do_not_fit():
    """Issue 4, bad input: mission of 0 and of 10 thousand items."""
    assert on_count(IDLE, ALICE, 0, 0, 0, RULES) == (
        IDLE,
        (Store(Kind.MISSION, ()), Ack(ALICE, 0, Verdict.ACCEPTED)),
    )
    assert on_count(IDLE, ALICE, 0, 10_000, 0, RULES) == (IDLE, (Ack(ALICE, 0, Verdict.NO_SPACE),))


def test_rally_points_are_refused_at_once():
    """AUTOPILOT.md 1, types: 2 rally; not kept, so UNSUPPORTED at once. There are none to download."""
    assert on_count(IDLE, ALICE, 2, 3, 0, RULES) == (IDLE, (Ack(ALICE, 2, Verdict.UNSUPPORTED),))
    assert on_list(IDLE, ALICE, 2, (), 0, RULES) == (IDLE, (Count(ALICE, 2, 0),))


def test_wrong_sequence_numbers():
    state, _ = on_count(IDLE, ALICE, 0, 3, 0, RULES)
    ahead, deeds = on_item(state, ALICE, 0, 2, waypoint(), True, 10, RULES)
    assert deeds == (Ask(ALICE, Kind.MISSION, 0, True),)
    assert ahead.items == ()
    _, deeds = on_item(state, ALICE, 0, 3, waypoint(), True, 10, RULES)
    assert deeds == (Ack(ALICE, 0, Verdict.INVALID_SEQUENCE),)


def test_download():
    plan = (waypoint(), waypoint(z=20.0))
    state, deeds = on_list(IDLE, ALICE, 0, plan, 0, RULES)
    assert deeds == (Count(ALICE, 0, 2),)
    state, deeds = on_request(state, ALICE, 0, 1, True, 10)
    assert deeds == (Give(ALICE, Kind.MISSION, 1, plan[1], True),)
    state, deeds = on_request(state, ALICE, 0, 1, False, 20)  # again, since it was lost
    assert deeds == (Give(ALICE, Kind.MISSION, 1, plan[1], False),)
    assert on_request(state, BOB, 0, 0, True, 30) == (state, ())
    assert on_count(state, BOB, 0, 1, 30, RULES)[1][-1] == Ack(BOB, 0, Verdict.ERROR)
    assert on_ack(state, BOB) == (state, ())
    assert on_ack(state, ALICE) == (IDLE, ())
    assert on_request(state, ALICE, 0, 2, True, 30) == (IDLE, (Ack(ALICE, 0, Verdict.INVALID_SEQUENCE),))


def test_an_upload_can_be_cancelled():
    state, _ = on_count(IDLE, ALICE, 0, 2, 0, RULES)
    assert on_ack(state, ALICE) == (IDLE, ())


def test_clear():
    assert on_clear(IDLE, ALICE, 255, RULES) == (
        IDLE,
        (Store(Kind.MISSION, ()), Store(Kind.FENCE, ()), Ack(ALICE, 255, Verdict.ACCEPTED)),
    )
    state, _ = on_count(IDLE, BOB, 0, 2, 0, RULES)
    assert on_clear(state, ALICE, 0, RULES)[1][-1] == Ack(ALICE, 0, Verdict.ERROR)
