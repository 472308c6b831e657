"""What happens when a part dies in flight, or somebody interrupts."""

import os
import signal
import time

import pytest

from bus import topics
from mission.transitions import transitions


def outcomes(flight):
    return [slot.flown.outcome for slot in flight.log.messages(topics.SLOT) if slot.flown]


def test_without_restart_a_dead_agent_sends_the_vehicle_home(launch, short):
    flight = launch(short | {"slots": 200, "restart": "never"})
    flight.await_slot(2)
    flight.kill("agent")
    assert flight.wait() == 3, flight.text
    assert not flight.processes()
    log = flight.log
    done = outcomes(flight)
    lost = done.index("missing")
    assert set(done[lost:]) == {"missing"}, "nothing was flown after the agent died"
    opened = log.by_slot(topics.SLOT)
    waited_s = log.messages(topics.SLOT)[-1].time_s - opened[lost - 1].time_s
    assert 13.9 < waited_s < 15.1, "it held for the grace of 15 s after the last action, then came home"
    held = [slot.flown for slot in log.messages(topics.SLOT) if slot.flown and slot.flown.outcome == "missing"]
    assert all(abs(component) < 0.5 for flown in held[3:] for component in flown.flown_enu), "it holds its place"
    links = log.by_slot(topics.LINK)
    assert links[max(links)].configuration == "held"
    assert log.messages(topics.STATE)[-1].landed
    for transition in transitions(flight.run):
        assert transition.reward == pytest.approx(links[transition.slot].reward, rel=1e-12), "held slots included"
    assert "no good action" in flight.text
    assert flight.report["exit_code"] == 3


@pytest.mark.parametrize("node", ["agent", "rf"])
def test_a_node_that_dies_is_started_again_and_the_flight_goes_on(launch, short, node):
    flight = launch(short | {"slots": 60})
    flight.await_slot(2)
    flight.kill(node)
    assert flight.wait() == 0, flight.text
    assert not flight.processes()
    assert f"{node}: killed by SIGKILL, starting it again" in flight.text
    assert flight.report["restarts"] == 1
    assert len(outcomes(flight)) == 60
    assert outcomes(flight)[-1] in ("flown", "clipped")
    lost = set(range(60)) - set(flight.log.by_slot(topics.CONFIGURATION))
    assert len(lost) <= 1, "only what the node had in hand when it died may be lost"


def test_without_its_bridge_the_autopilot_saves_the_vehicle(launch, short):
    flight = launch(short | {"slots": 200})
    flight.await_slot(2)
    flight.kill("bridge")
    assert flight.wait() == 3, flight.text
    assert not flight.processes()
    assert "bridge: killed by SIGKILL; the autopilot's failsafe brings the vehicle down" in flight.text
    assert flight.log.complete
    assert flight.report["slots"] >= 1


def test_the_loop_outlives_its_mission_and_the_recording_is_whole_to_the_last_second(launch, short):
    flight = launch(short | {"slots": 120})
    flight.await_slot(3)
    time.sleep(1.0)  # what is older than that must be on disk
    killed_at = time.time()
    flight.process.kill()
    flight.process.wait()
    flight.await_end()
    log = flight.log
    assert not log.complete
    assert killed_at - log.entries[-1].wall_s < 1.0
    assert len(log.messages(topics.SLOT)) >= 4
    assert len(log.messages(topics.SLOT)) < 120, "killed before the end"
    words = (flight.run / "logs" / "bridge.log").read_text()
    assert "phase: landing" in words
    assert words.rstrip().endswith("ended: exit 0"), words


def test_ctrl_c_lands_and_closes_the_logs(launch, short):
    flight = launch(short | {"slots": 500})
    flight.await_slot(2)
    os.kill(flight.process.pid, signal.SIGINT)
    assert flight.wait() == 3, flight.text
    assert not flight.processes()
    assert flight.log.complete
    assert not flight.log.messages(topics.STATE)[-1].armed
    assert "land was commanded" in flight.text
    assert [entry.payload for entry in flight.log.entries if entry.topic == "command"][-1] == b'{"name":"land"}'
    assert flight.report["slots"] < 500


def test_a_second_ctrl_c_leaves_the_vehicle_to_its_failsafe(launch, short):
    flight = launch(short | {"slots": 500, "clock": "paced", "speed": 5})
    flight.await_slot(0)
    os.kill(flight.process.pid, signal.SIGINT)
    deadline = time.monotonic() + 60
    while "Ctrl-C: landing" not in flight.text:
        assert time.monotonic() < deadline, flight.text
        time.sleep(0.02)
    os.kill(flight.process.pid, signal.SIGINT)
    assert flight.wait() == 1, flight.text
    left = list(flight.processes().values())
    assert all("sitl" in command for command in left), "only the vehicle itself may still be there"
    flight.await_end()
    assert flight.log.complete


def test_a_mission_killed_before_there_was_a_flight_leaves_nothing(launch, short):
    flight = launch(short)
    flight.node("rf")
    flight.process.kill()
    flight.await_end()
