"""The start of a flight with a bridge that cannot take it yet: a stand-in process on the real bus."""

import os
import sys

import pytest
from rich.console import Console

from mission import flight_log
from mission.fleet import load as load_any
from mission.fly import FlightError, fly
from mission.mission_file import load

BRIDGE = """
import sys, threading
from collections import Counter
from bus import topics
from bus.messages import CommandReply, MissionEvent
from bus.session import open_session

reasons = sys.argv[2].split(",")
started = threading.Event()

def answer(command):
    reason = reasons.pop(0)
    if not reason:
        started.set()
    return CommandReply(accepted=not reason, reason=reason)

with open_session(connect=[sys.argv[1]]) as session:
    event = topics.Publisher(session, "star1", topics.EVENT)
    kept = [topics.answer_commands(session, "star1", answer, Counter())]
    kept += [topics.declare_alive(session, "star1", node) for node in ("rf", "agent", "bridge")]
    if reasons == ["frozen"]:
        topics.Publisher(session, "star1", topics.HEALTH).send(topics.health("bridge", {}, {}))
        threading.Event().wait(60)
    started.wait(60)
    event.send(MissionEvent(time_s=0.0, source="bridge", kind="ended", text="exit 0", exit_code=0))
"""


@pytest.fixture
def refusing(tmp_path, monkeypatch):
    """A mission, and how to make its bridge refuse `start` for the given reasons first."""
    path = tmp_path / "m.yaml"
    path.write_text("clock: paced\nvehicle: {autopilot: 'udpin://127.0.0.1:14540'}\npolicy: {kind: hover}")

    def make(*reasons):
        def stand_in(_module, node, *options):
            if node != "bridge":
                return [sys.executable, "-c", "import time; time.sleep(600)"]
            endpoint = options[options.index("--connect") + 1]
            says = ["frozen"] if reasons == ("frozen",) else [*reasons, ""]
            return [sys.executable, "-c", BRIDGE, endpoint, ",".join(says)]

        monkeypatch.setattr("mission.fly.python", stand_in)
        monkeypatch.setattr("mission.fly.GATHER_S", 0.0)  # the others never end by themselves
        return load(path, output=tmp_path / "runs")

    return make


def test_a_start_that_is_refused_is_asked_for_again(refusing, tmp_path):
    console = Console(record=True, width=120)
    assert fly(refusing("not yet", "not yet", "nearly"), console) == 0
    text = console.export_text()
    assert text.count("start was refused: not yet") == 1, "told once"
    assert text.count("start was refused: nearly") == 1
    (run,) = (tmp_path / "runs").iterdir()
    replies = [entry for entry in flight_log.read(run).entries if entry.topic == "command/reply"]
    assert b'"accepted":true' in replies[-1].payload
    assert [b'"accepted":true' in reply.payload for reply in replies] == [False, False, False, True]


def test_a_bridge_that_says_nothing_any_more_is_ended(refusing, monkeypatch):
    monkeypatch.setattr("mission.vehicle_flight.BRIDGE_SILENT_S", 1.0)
    console = Console(record=True, width=120)
    with pytest.raises(FlightError, match="killed by SIGKILL"):
        fly(refusing("frozen"), console)
    assert "bridge: does not answer: it is ended" in console.export_text()


ONE_OF_TWO = """
import os, signal, sys, threading
from collections import Counter
from bus import topics
from bus.messages import CommandReply, MissionEvent
from bus.session import open_session

endpoint, name, parent = sys.argv[1], sys.argv[2], int(sys.argv[3])
asked, landing, again = threading.Event(), threading.Event(), threading.Event()

def answer(command):
    asked.set()
    if command.name == "land":
        landing.set()
        return CommandReply(accepted=name == "star1", reason="" if name == "star1" else "not now")
    if landing.is_set():
        again.set()
    if name == "star1":
        os.kill(parent, signal.SIGINT)
        return CommandReply(accepted=True, reason="")
    return CommandReply(accepted=landing.is_set(), reason="" if landing.is_set() else "not yet")

with open_session(connect=[endpoint]) as session:
    event = topics.Publisher(session, name, topics.EVENT)
    kept = [topics.answer_commands(session, name, answer, Counter())]
    kept += [topics.declare_alive(session, name, node) for node in ("rf", "agent", "bridge")]
    while not asked.wait(0.1):
        event.send(MissionEvent(time_s=0.0, source="bridge", kind="phase", text="ready"))
    landing.wait(60)
    again.wait(1.0)
    text = "started after Ctrl-C" if again.is_set() else "landed"
    event.send(MissionEvent(time_s=0.0, source="bridge", kind="failsafe", text=text))
    event.send(MissionEvent(time_s=0.0, source="bridge", kind="ended", text="exit 3", exit_code=3))
"""


def test_after_ctrl_c_nobody_is_started_any_more(tmp_path, monkeypatch):
    """The second vehicle refuses the start, then the landing too, and would take the next start."""

    def stand_in(_module, node, *options):
        if node != "bridge":
            return [sys.executable, "-c", "import time; time.sleep(600)"]
        endpoint, name = (options[options.index(option) + 1] for option in ("--connect", "--vehicle"))
        return [sys.executable, "-c", ONE_OF_TWO, endpoint, name, str(os.getpid())]

    monkeypatch.setattr("mission.fly.python", stand_in)
    monkeypatch.setattr("mission.fly.GATHER_S", 0.0)
    path = tmp_path / "m.yaml"
    path.write_text(
        "policy: {kind: hover}\n"
        "vehicles: [{autopilot: 'udpin://127.0.0.1:14540'}, {autopilot: 'udpin://127.0.0.1:14541'}]"
    )
    console = Console(record=True, width=120)
    assert fly(load_any(path, output=tmp_path / "runs"), console) == 3
    text = console.export_text()
    assert "star2: land was refused: not now" in text
    assert "star2: failsafe: landed" in text or "star2: ended safely, not as planned: landed" in text, text
    assert "started after Ctrl-C" not in text


def test_output_that_cannot_be_written_ends_no_flight(refusing):
    class Full:
        def write(self, text):
            raise OSError(28, "No space left on device")

        def flush(self):
            raise OSError(28, "No space left on device")

    assert fly(refusing("not yet"), Console(file=Full())) == 0
