"""The order in which a recording is fed to a fresh rf node is the flight's, whatever the recorder's was."""

import random
from pathlib import Path

import pytest

from bus import topics
from bus.messages import Action, SlotOpened, VehicleState
from mission.flight_log import Entry, FlightLog
from mission.replay import script

IN_TIME = ("flown", "clipped", "rejected")


def flight_log(messages):
    entries = tuple(Entry(name, 0.0, topics.encode(message)) for name, message in messages)
    return FlightLog(Path("flight.mcap"), "t", entries, complete=True, lost_bytes=0)


@pytest.mark.parametrize("seed", range(20))
def test_actions_that_came_in_time_follow_their_slot_in_whatever_order_they_were_recorded(flight, seed):
    """Messages of different senders may overtake each other on the way to the recorder."""
    streams = {}
    for name, message in flight:
        sender = "agent" if name == "agent/action" else "bridge"
        if name in ("slot", "state", "agent/action"):
            streams.setdefault(sender, []).append((name, message))
    chance = random.Random(seed)
    mixed = []
    while any(streams.values()):
        mixed.append(streams[chance.choice([sender for sender, left in streams.items() if left])].pop(0))

    sent = [message for message, _ in script(flight_log(mixed), deadline_s=0.25)]
    outcome = {m.flown.slot: m.flown.outcome for m in sent if isinstance(m, SlotOpened) and m.flown}
    order = [("action" if isinstance(m, Action) else "slot", m.slot) for m in sent if not isinstance(m, VehicleState)]
    assert [slot for kind, slot in order if kind == "slot"] == [0, 1, 2, 3, 4, 5]
    assert sorted(slot for kind, slot in order if kind == "action") == [0, 1, 2, 3, 4]
    for slot, became in outcome.items():
        if became in IN_TIME:
            assert order.index(("action", slot)) == order.index(("slot", slot)) + 1
