"""What readers of a per-slot topic get, over a real session."""

import msgspec
import pytest

from bus import topics
from bus.messages import RisConfiguration
from bus.session import open_session
from rf_model import history
from rf_model.history import History
from rf_model.scenario import preset
from rf_model.slot_radio import SlotRadio
from tests.rf_model.test_slot_radio import opened


@pytest.fixture
def session():
    with open_session(listen="tcp/127.0.0.1:0") as opened_session:
        yield opened_session


def configurations(seed, slots):
    radio = SlotRadio(preset("physical_small"), seed)
    out = [message for slot in range(slots + 1) for message in radio.open(opened(slot, closing=slot == slots))]
    return [message for message in out if isinstance(message, RisConfiguration)]


def ask(session, topic, parameters=""):
    (reply,) = session.get(topics.key("star1", topic.name) + parameters)
    return reply.ok.payload.to_bytes() if reply.ok else reply.err.payload.to_string()


@pytest.mark.parametrize("asked", ["first", "-1", "", "1.0", "\u0663", "9" * 5000], ids=lambda asked: repr(asked[:8]))
def test_what_is_no_slot_number_is_answered_with_a_short_error(session, asked):
    kept = History(session, "star1", topics.LINK)
    answer = ask(session, topics.LINK, f"?slot={asked}")
    assert answer.endswith("is not a slot number")
    assert len(answer) < 80
    kept.undeclare()


def test_the_oldest_messages_go_first(session, monkeypatch):
    monkeypatch.setattr(history, "KEPT_SLOTS", 3)
    kept = History(session, "star1", topics.CONFIGURATION)
    for message in configurations(1, 5):
        kept.keep(message)
    slots = [isinstance(ask(session, topics.CONFIGURATION, f"?slot={slot}"), bytes) for slot in range(6)]
    assert slots == [False, False, True, True, True, False]
    kept.undeclare()


@pytest.mark.parametrize("flown", [1, 3])
def test_slots_of_the_flight_before_are_not_answered_in_a_new_one(session, flown):
    """Until then they are, and a slot that was lost on the way begins none."""
    kept = History(session, "star1", topics.CONFIGURATION)
    first = configurations(1, 4)[: flown + 1]
    for message in first:
        kept.keep(message)
    assert ask(session, topics.CONFIGURATION, f"?slot={flown}") == topics.encode(first[-1])
    following = [message for message in configurations(2, 4) if message.slot in (0, 2)]
    for message in following:
        message = msgspec.structs.replace(message, time_s=message.time_s + 100)
        kept.keep(message)
        newest = topics.encode(message)
    answers = [ask(session, topics.CONFIGURATION, f"?slot={slot}") for slot in range(4)]
    assert [isinstance(answer, bytes) for answer in answers] == [True, False, True, False]
    assert answers[2] == ask(session, topics.CONFIGURATION) == newest
    assert answers[1] == "slot: nothing kept for 1"
    kept.undeclare()
