"""The order in which a recording is fed to a fresh rf node is the flight's, whatever the recorder's was."""

import random
from pathlib import Path

import pytest
from msgspec.structs import replace

from bus import topics
from bus.messages import Action
from mission.flight_log import Entry, FlightLog
from mission.replay import script

IN_TIME = ("flown", "clipped", "rejected")


def flight_log(messages):
    entries = tuple(Entry(name, 0.0, topics.encode(message)) for name, message in messages)
    return FlightLog(Path("flight.mcap"), "t", entries, complete=True, lost_bytes=0)


def sent_for(messages):
    """(kind, slot) of what is sent, in order."""
    return [("action" if isinstance(m, Action) else "slot", m.slot) for m, _ in script(flight_log(messages))]


def held_in(messages, slots):
    """The same flight, with what had been set kept in these slots."""
    return [
        (name, replace(message, source="held") if name == "ris/configuration" and message.slot in slots else message)
        for name, message in messages
    ]


@pytest.mark.parametrize("seed", range(20))
def test_actions_that_came_in_time_follow_their_slot_in_whatever_order_they_were_recorded(flight, seed):
    """Messages of different senders may overtake each other on the way to the recorder."""
    streams = {}
    for name, message in held_in(flight, (2, 3)):
        sender = {"slot": "bridge", "state": "bridge", "agent/action": "agent", "ris/configuration": "rf"}.get(name)
        if sender:
            streams.setdefault(sender, []).append((name, message))
    chance = random.Random(seed)
    mixed = []
    while any(streams.values()):
        mixed.append(streams[chance.choice([sender for sender, left in streams.items() if left])].pop(0))

    order = sent_for(mixed)
    outcome = {m.flown.slot: m.flown.outcome for name, m in flight if name == "slot" and m.flown}
    assert [slot for kind, slot in order if kind == "slot"] == [0, 1, 2, 3, 4, 5]
    assert sorted(slot for kind, slot in order if kind == "action") == [0, 1, 2, 3, 4]
    for slot, became in outcome.items():
        if became in IN_TIME:
            assert order.index(("action", slot)) == order.index(("slot", slot)) + 1
        else:
            assert order.index(("action", slot)) > order.index(("slot", slot + 1)), "when it changes nothing any more"


def test_an_action_that_only_the_node_got_in_time_is_sent_in_time(flight):
    """For the bridge those of slots 2 and 3 were late and missing."""
    order = sent_for(held_in(flight, (3,)))
    assert order.index(("action", 2)) == order.index(("slot", 2)) + 1
    assert order.index(("action", 3)) > order.index(("slot", 4))


def test_the_answers_to_each_message_are_waited_for(flight):
    expected = [answers for _, answers in script(flight_log(flight))]
    assert expected[0] == [("rf/csi", 0)]
    assert expected[1] == [("ris/configuration", 0)]
    assert expected[2] == [("ris/configuration", 0), ("rf/link", 0), ("rf/csi", 1)]
    assert expected[-1] == [("ris/configuration", 4), ("rf/link", 4)], "nobody answers the closing one"
