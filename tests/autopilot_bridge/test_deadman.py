"""The ladder: rungs against a model that looks at the whole history, and what must hold whatever happens."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.deadman import (
    BLIND_S,
    DARK_S,
    MODE_OLD_S,
    SILENCE_WALL_S,
    STALE_S,
    STALL_S,
    Attention,
    Deadman,
    Moment,
    Rung,
    Silence,
)


def at(seconds, wall=None):
    """On both clocks."""
    return Moment(seconds, 1000.0 + (seconds if wall is None else wall))


class Ladder:
    """A deadman whose position never fails, unless told to."""

    def __init__(self, hold_mode_s=5.0, grace_s=15.0, return_s=300.0):
        self.deadman = Deadman(0.25, hold_mode_s, grace_s, return_s)
        self.seen = True

    def rung(self, moment):
        if self.seen:
            self.deadman.placed(moment)
            self.deadman.told_mode(moment)
        return self.deadman.rung(moment)


@pytest.fixture
def ladder():
    """Slot 0 opened at 10 s and was answered at 10.125 s."""
    ladder = Ladder()
    ladder.deadman.opened(at(10.0))
    ladder.deadman.acted(at(10.125))
    return ladder


def test_from_rung_to_rung(ladder):
    rungs = []
    for eighth in range(82, 320):
        now = at(eighth / 8)
        if eighth % 8 == 0:  # slots go on opening
            ladder.deadman.opened(now)
        rung = ladder.rung(now)
        if not rungs or rungs[-1][0] is not rung:
            rungs.append((rung, now.vehicle_s, ladder.deadman.why))
    assert rungs == [
        (Rung.FLY, 10.25, "a good action in time"),
        (Rung.HOLD, 11.375, "no good action by the deadline"),
        (Rung.HOLD_MODE, 15.25, "no good action for 5 s"),
        (Rung.RETURN, 25.25, "no good action for 15 s"),
    ]


@pytest.mark.parametrize("seconds", [0.4, 4.0, 14.0])
def test_a_good_action_within_the_grace_leads_back(ladder, seconds):
    ladder.deadman.opened(at(11.0))
    assert ladder.rung(at(11.0 + seconds)) in (Rung.HOLD, Rung.HOLD_MODE)
    ladder.deadman.opened(at(11.0 + seconds))
    ladder.deadman.acted(at(11.1 + seconds))
    assert ladder.rung(at(11.1 + seconds)) is Rung.FLY


def test_a_slot_that_opens_is_no_action(ladder):
    ladder.deadman.opened(at(11.0))
    assert ladder.rung(at(11.9)) is Rung.HOLD
    ladder.deadman.opened(at(12.0))
    assert ladder.rung(at(12.0)) is Rung.HOLD
    assert not ladder.deadman.late(at(12.2)), "but its action may still come in time"
    assert ladder.deadman.late(at(12.3))


def test_return_is_latched_and_land_above_it(ladder):
    ladder.deadman.opened(at(11.0))
    assert ladder.rung(at(25.2)) is Rung.RETURN
    ladder.deadman.acted(at(25.3))
    assert ladder.rung(at(25.3)) is Rung.RETURN
    ladder.deadman.sent_home(at(25.3), "no good action for 15 s")
    assert ladder.rung(at(325.2)) is Rung.RETURN
    assert ladder.rung(at(325.4)) is Rung.LAND
    assert ladder.deadman.why == "not on the ground 300 s after it was sent home"
    ladder.deadman.acted(at(325.5))
    assert ladder.rung(at(325.5)) is Rung.LAND


def test_what_cannot_return_lands(ladder):
    ladder.deadman.sent_home(at(11.0), "return was commanded")
    assert (ladder.rung(at(11.0)), ladder.deadman.why) == (Rung.RETURN, "return was commanded")
    ladder.deadman.land("it cannot return")
    assert (ladder.rung(at(11.1)), ladder.deadman.why) == (Rung.LAND, "it cannot return")


def test_before_the_slots_no_action_is_missed():
    ladder = Ladder()
    assert {ladder.rung(at(float(second))) for second in range(100)} == {Rung.FLY}


def test_without_positions(ladder):
    deadman = ladder.deadman
    ladder.rung(at(10.0))
    ladder.seen = False
    deadman.told_mode(at(100.0))
    rungs = {}
    for eighth in range(81, 240):
        now = at(eighth / 8)
        if eighth % 8 == 0:
            deadman.opened(now)
            deadman.acted(now)
        assert deadman.stale(now) == (now.vehicle_s - 10.0 > STALE_S)
        rungs.setdefault(ladder.rung(now), now.vehicle_s)
    assert rungs == {Rung.FLY: 10.125, Rung.HOLD_MODE: 10.125 + BLIND_S, Rung.RETURN: 25.125}
    assert deadman.why == "no position for 15 s"


def test_no_setpoint_on_the_word_of_an_old_heartbeat(ladder):
    deadman = ladder.deadman
    deadman.told_mode(at(10.0))
    for eighth in range(81, 120):
        now = at(eighth / 8)
        deadman.placed(now)
        assert deadman.stale(now) == (now.vehicle_s - 10.0 > MODE_OLD_S)


def test_in_the_dark_nothing_is_to_be_asked_for():
    deadman = Deadman(0.25, 5.0, 15.0, 300.0)
    assert deadman.dark(at(10.0))
    deadman.told_mode(at(10.0))
    for eighth in range(80, 120):
        now = at(eighth / 8)
        deadman.heard(now)
        assert deadman.dark(now) == (now.vehicle_s - 10.0 > MODE_OLD_S)
    deadman.told_mode(at(15.0))
    deadman.heard(at(15.0))
    assert not deadman.dark(at(14.9 + DARK_S))
    assert deadman.dark(at(15.1 + DARK_S, wall=15.0))
    assert deadman.dark(at(15.0, wall=15.1 + DARK_S))


def test_the_position_comes_back(ladder):
    ladder.rung(at(10.0))
    assert ladder.deadman.rung(at(11.1)) is Rung.HOLD_MODE
    assert ladder.deadman.why == "no position for 1 s"
    ladder.deadman.placed(at(11.15))
    assert ladder.deadman.rung(at(11.2)) is Rung.FLY


@pytest.mark.parametrize("clock", [lambda s: at(10.1 + s, wall=10.1), lambda s: at(10.1, wall=10.1 + s)])
def test_either_clock_is_enough(ladder, clock):
    """Vehicle time that stands still, or is not told; a wall clock that was not running."""
    ladder.deadman.opened(at(10.1))
    assert [ladder.rung(clock(seconds)) for seconds in (0.2, 0.3, 5.1, 15.1)] == [
        Rung.FLY,
        Rung.HOLD,
        Rung.HOLD_MODE,
        Rung.RETURN,
    ]
    ladder.deadman.sent_home(clock(15.1), "")
    assert ladder.rung(clock(315.2)) is Rung.LAND


EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["opened", "acted", "placed", "judge", "judge", "sent_home"]),
        st.floats(0.0, 4.0),
        st.floats(0.0, 4.0),
    ),
    max_size=60,
)


@given(EVENTS)
def test_rungs_only_climb_without_a_sign_of_life_and_the_last_two_are_final(events):
    deadman, now = Deadman(0.25, 5.0, 15.0, 30.0), at(0.0)
    deadman.placed(now)
    deadman.opened(now)
    last, relieved = Rung.FLY, False
    for what, vehicle_s, wall_s in events:
        now = Moment(now.vehicle_s + vehicle_s, now.wall_s + wall_s)
        if what == "judge":
            rung = deadman.rung(now)
            assert rung >= last or (relieved and last < Rung.RETURN)
            last, relieved = rung, False
        elif what == "sent_home":
            deadman.sent_home(now, "")
        else:
            getattr(deadman, what)(now)
            relieved = relieved or what in ("acted", "placed")


@given(EVENTS)
def test_the_rung_is_what_the_history_says(events):
    """Against a second implementation that keeps every event and looks back."""
    deadman, now = Deadman(0.25, 5.0, 15.0, 30.0), at(0.0)
    history = [("placed", now), ("opened", now), ("acted", now)]
    for what, moment in history:
        getattr(deadman, what)(moment)
    expired, late_since = False, -1
    for what, vehicle_s, wall_s in events:
        now = Moment(now.vehicle_s + vehicle_s, now.wall_s + wall_s)
        if what == "sent_home":
            continue
        if what != "judge":
            getattr(deadman, what)(now)
            history.append((what, now))
            continue
        ages = {name: max(now[i] - moment[i] for i in (0, 1)) for name, moment in history}  # of the last of each
        names = [name for name, _ in history]
        last_act = len(names) - 1 - names[::-1].index("acted")
        unanswered = [moment for name, moment in history[last_act:] if name == "opened"]
        if len(unanswered) > 1 or (unanswered and ages["opened"] > 0.25):
            late_since = last_act
        expired = expired or max(ages["acted"], ages["placed"]) > 15.0
        expected = (
            Rung.RETURN
            if expired
            else Rung.HOLD_MODE
            if ages["placed"] > BLIND_S or ages["acted"] > 5.0
            else Rung.HOLD
            if late_since == last_act
            else Rung.FLY
        )
        assert deadman.rung(now) is expected


def test_long_slots_have_the_patience_they_need():
    base = {
        "clock": {"kind": "paced"},
        "slots": 1,
        "start_position_enu": (0, 0, 60),
        "box": {"x": (-100, 100), "y": (-100, 100), "z": (30, 120)},
    }
    short, long = BridgeConfig(**base).deadman, BridgeConfig(**base, slot_s=20.0).deadman
    assert (short.deadline_s, short.hold_mode_s, short.grace_s, short.return_s) == (0.25, 5.0, 15.0, 300.0)
    assert (long.deadline_s, long.hold_mode_s, long.grace_s, long.return_s) == (5.0, 40.0, 60.0, 300.0)


def test_who_has_not_listened_by_the_wall_clock_has_stalled():
    attention = Attention(at(10.0))
    assert not attention.stalled(at(10.0 + STALL_S))
    assert not attention.stalled(at(20.0, wall=10.0)), "a clock that leaps, or was not told for a while"
    assert attention.stalled(at(10.0, wall=10.1 + STALL_S))
    attention.listened = at(20.0)
    assert not attention.stalled(at(20.1))


def test_silence_runs_on_the_wall_and_can_be_excused():
    silence = Silence(wall_s=100.0)
    assert not silence.over(heard=5, wall_s=101.0)
    assert not silence.over(heard=5, wall_s=101.0 + SILENCE_WALL_S)
    assert silence.over(heard=5, wall_s=101.1 + SILENCE_WALL_S)
    assert not Silence(100.0, limit_s=10.0).over(heard=0, wall_s=109.0)
    assert Silence(100.0, limit_s=10.0).over(heard=0, wall_s=110.5)
    silence.excuse(110.0)
    assert not silence.over(heard=5, wall_s=112.0)
    assert not silence.over(heard=6, wall_s=114.0)
