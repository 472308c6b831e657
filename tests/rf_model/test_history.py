"""What readers of a per-slot topic get, over a real session."""

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


def test_the_oldest_messages_go_first_also_when_slots_are_flown_again(session, monkeypatch):
    monkeypatch.setattr(history, "KEPT_SLOTS", 3)
    kept = History(session, "star1", topics.CONFIGURATION)
    for message in (*configurations(1, 3), *configurations(2, 1), *configurations(3, 4)[3:]):
        kept.keep(message)
    slots = [isinstance(ask(session, topics.CONFIGURATION, f"?slot={slot}"), bytes) for slot in range(4)]
    assert slots == [True, False, True, True]
    kept.undeclare()
