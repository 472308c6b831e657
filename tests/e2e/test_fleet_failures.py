"""Several vehicles at the same time: what becomes of the others when one fails, and of all at Ctrl-C."""

import os
import signal
import subprocess
import sys
import time

from bus import topics
from mission.embedded import bindable
from tests.e2e.fleets import PATIENCE_S, await_slot, bridge, fleet, logs


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


def test_ctrl_c_before_the_start_leaves_no_parameter_changed(launch, tmp_path):
    """One autopilot is somebody else's, and ready, the other is awaited still: what was set is put back."""
    port, silent = bindable(0), bindable(0)
    mission = fleet(2) | {"speed": 1}
    mission["vehicles"] = [
        {"name": "a", "autopilot": f"udpin://127.0.0.1:{port}", "allow_without": ["battery_failsafe"]},
        {"name": "b", "autopilot": f"udpin://127.0.0.1:{silent}"},
    ]
    options = ("--companion-port", str(port), "--companion-bind", "0", "--gcs-bind", "0")
    foreign = subprocess.Popen([sys.executable, "-m", "sitl", *options], stdout=subprocess.DEVNULL)
    try:
        flight = launch(mission, XDG_STATE_HOME=str(tmp_path))
        deadline = time.monotonic() + PATIENCE_S
        while "a: ready" not in flight.text:
            assert time.monotonic() < deadline, flight.text
            assert flight.process.poll() is None, flight.text
            time.sleep(0.05)
        (journal,) = tmp_path.rglob("*.jsonl")
        assert "COM_OBL_RC_ACT" in journal.read_text()
        os.kill(flight.process.pid, signal.SIGINT)
        assert flight.wait() == 1, flight.text
    finally:
        foreign.kill()
        foreign.wait()
    assert "interrupted before the start" in flight.text
    assert not flight.processes()
    assert journal.read_text() == "", "what was put back is settled"
