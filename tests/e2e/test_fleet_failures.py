"""Several vehicles at the same time: what becomes of the others when one fails, and of all at Ctrl-C."""

import os
import signal

from bus import topics
from tests.e2e.fleets import await_slot, bridge, fleet, logs


def test_when_a_bridge_dies_the_others_fly_on(launch):
    flight = launch(fleet(3, slots=15))
    await_slot(flight, "b", 2)
    os.kill(bridge(flight, "b"), signal.SIGKILL)
    assert flight.wait() == 3, flight.text
    assert not flight.processes()
    assert "b: bridge: killed by SIGKILL; the autopilot's failsafe brings the vehicle down" in flight.text
    recorded = logs(flight, "abc")
    for name in "ac":
        log = recorded[name]
        assert sorted(log.by_slot(topics.LINK)) == list(range(15)), name
        events = log.messages(topics.EVENT)
        assert (events[-1].kind, events[-1].exit_code) == ("ended", 0)
        assert "b is silent: kept away from its way home" in [event.text for event in events]
    assert 2 <= len(recorded["b"].messages(topics.LINK)) < 15


def test_ctrl_c_lands_all(launch):
    flight = launch(fleet(2, slots=500))
    await_slot(flight, "a", 1)
    os.kill(flight.process.pid, signal.SIGINT)
    assert flight.wait() == 3, flight.text
    assert not flight.processes()
    for log in logs(flight, "ab").values():
        assert log.complete
        assert not log.messages(topics.STATE)[-1].armed
        assert [entry.payload for entry in log.entries if entry.topic == "command"][-1] == b'{"name":"land"}'


def test_none_starts_when_one_cannot(launch):
    """The other autopilot is not there: nobody arms, and it is told why."""
    mission = fleet(2)
    mission["vehicles"][1] |= {"autopilot": "udpin://127.0.0.1:1"}
    flight = launch(mission | {"speed": 1})
    assert flight.wait() == 1, flight.text
    assert not flight.processes()
    assert "error: b: " in flight.text
    assert "arming" not in flight.text
    assert not any(state.armed for state in logs(flight, "a")["a"].messages(topics.STATE))
