"""What the setpoints of a flight say of themselves, against what else was recorded."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from bus import messages as m
from bus import topics
from mission.flight_log import Entry, FlightLog
from mission.proof_log import setpoints

TAKEN_S = 0.05
"""How long after its slot's opening an action comes."""


def setpoint(time_s, slot, action_slot, **changes):
    told = {
        "time_s": time_s,
        "slot": slot,
        "source": "hold" if action_slot is None else "test",
        "action_slot": action_slot,
        "action_age_s": None if action_slot is None else time_s - action_slot - TAKEN_S,
        "state_age_s": 0.02,
        "wanted_enu": (1.0, 0.0, 0.5),
        "velocity_enu": (1.0, 0.0, 0.5),
        "yaw_rad": 0.0,
        "reasons": [],
    }
    return m.Setpoint(**(told | changes))


def log_of(messages, *, complete=True, more=()):
    entries = [Entry(name, 0.0, topics.encode(message)) for name, message in messages]
    return FlightLog(Path("flight.mcap"), "t", (*entries, *more), complete=complete, lost_bytes=0)


@pytest.fixture
def flight(flight):
    """Without its own setpoints."""
    return [(name, message) for name, message in flight if name != "setpoint"]


@pytest.fixture
def sent():
    """Of the five-slot flight: slots 0 (flown), 1 (clipped) and 4 (rejected) at 10 Hz, with an action in the first two.

    Each action is flown from when it comes until the next slot's comes, or the hold begins.
    """
    times = [(k, k + i / 10) for k in (0, 1, 4) for i in range(10)]
    flown = {0: (0, None), 1: (1, 0), 4: (None, None)}
    return [
        ("setpoint", setpoint(time_s, k, flown[k][0] if time_s - k >= TAKEN_S else flown[k][1])) for k, time_s in times
    ]


def test_a_log_that_holds_together(flight, sent):
    sent[5] = ("setpoint", replace(sent[5][1], velocity_enu=(0.5, 0.0, 0.5), reasons=["speed", "fence"]))
    sent[6] = ("setpoint", replace(sent[6][1], wanted_enu=None, velocity_enu=(0.0, 0.0, 0.0), reasons=["not finite"]))
    sent[7] = ("setpoint", replace(sent[7][1], state_age_s=0.3))
    got = setpoints(log_of([*flight, *sent]))
    assert got.contradictions == []
    assert (got.number, got.by_source) == (30, {"hold": 11, "test": 19})
    assert got.clipped == {"speed": 1, "fence": 1, "not finite": 1}
    assert got.max_state_age_s == 0.3
    assert got.max_action_age_s == pytest.approx(1.0 - TAKEN_S), "action 0 until slot 1 opens, and one more"
    assert got.longest_interval_s == pytest.approx(2.1), "slots 2 and 3"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"velocity_enu": (1.0, 0.0, 0.4)}, "it is not what was wanted, without a reason"),
        ({"wanted_enu": None}, "it is not what was wanted, without a reason"),
        ({"reasons": ["fence"]}, "it is just what was wanted, and clipped"),
        ({"time_s": 0.45, "action_age_s": 0.4}, "it was sent before the one before it"),
        ({"slot": 9}, "slot 9 never opened"),
        ({"slot": 2}, "it came before slot 2 opened"),
        ({"action_age_s": None}, "it has an action without an age, or an age without an action"),
        ({"action_slot": None}, "it has an action without an age, or an age without an action"),
        ({"action_slot": 7}, "there was no action of slot 7"),
        ({"source": "another"}, "the action of slot 0 came from test, not another"),
        ({"action_age_s": 0.6}, "the action of slot 0 came at 0.050 s and at 0.000 s"),
        ({"action_age_s": 0.7}, "its action came before slot 0 opened"),
        ({"slot": 4, "time_s": 4.0, "action_age_s": 3.95}, "the action of slot 0 is flown in slot 4"),
        (
            {"slot": 4, "time_s": 4.9, "action_slot": 4, "action_age_s": 0.85},
            "the action of slot 4 is flown, and rejected",
        ),
    ],
)
def test_what_contradicts_the_rest_is_told(flight, sent, changes, told):
    sent[6] = ("setpoint", replace(sent[6][1], **changes))
    got = setpoints(log_of([*flight, *sent]))
    lines = [line for line in got.contradictions if line.endswith(told)]
    assert lines == [f"setpoint at {changes.get('time_s', 0.6):.2f} s: {told}"]


def test_a_contradiction_is_told_once_however_often(flight, sent):
    wrong = [("setpoint", replace(message, source="nobody") if message.slot == 0 else message) for _, message in sent]
    (line,) = setpoints(log_of([*flight, *wrong])).contradictions[:1]
    assert "not nobody" in line
    assert line.endswith("(so are 8 more)")


def test_what_a_cut_recording_lacks_is_no_contradiction(flight, sent):
    without = [(name, message) for name, message in flight if name not in ("slot", "agent/action")]
    assert setpoints(log_of([*without, *sent])).contradictions
    assert setpoints(log_of([*without, *sent], complete=False)).contradictions == []


def test_setpoints_that_cannot_be_read_are_told(flight, sent):
    broken = Entry("setpoint", 0.0, topics.encode(replace(sent[0][1], yaw_rad=float("nan"))))
    got = setpoints(log_of([*flight, *sent], more=[broken]))
    assert got.contradictions == ["setpoints that cannot be read: 1"]
    assert got.number == 31


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("phase", "yielded"),
        ("phase", "returning"),
        ("mode", "POSCTL was chosen by autopilot or pilot: obeyed"),
        ("ladder", "HOLD -> HOLD_MODE: no action for 5 s"),
        ("failsafe", "no good action for 15 s"),
    ],
)
def test_no_setpoints_are_missed_where_none_are_meant_to_come(flight, sent, kind, text):
    event = m.MissionEvent(time_s=2.0, source="bridge", kind=kind, text=text)
    assert setpoints(log_of([*flight, *sent, ("event", event)])).longest_interval_s == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("kind", "text"),
    [("phase", "holding"), ("ladder", "FLY -> HOLD: late"), ("ladder", "HOLD_MODE -> FLY"), ("stall", "")],
)
def test_setpoints_are_missed_in_a_hold_and_a_stall(flight, sent, kind, text):
    event = m.MissionEvent(time_s=2.0, source="bridge", kind=kind, text=text)
    assert setpoints(log_of([*flight, *sent, ("event", event)])).longest_interval_s == pytest.approx(2.1)


def test_a_recording_from_before_there_were_setpoints(flight):
    assert setpoints(log_of(flight)) is None
