"""Several vehicles at the same time, each flown by its own bridge: nobody comes too near."""

import itertools

import pytest
import yaml

from bus import topics
from mission import flight_log
from mission.mission_file import load
from mission.replay import replay
from tests.e2e.fleets import SEPARATION_M, fleet, gaps, logs, paths


@pytest.fixture(scope="module")
def towards_each_other(launch):
    """Three at random in corridors that overlap: their policies would fly them through each other."""
    flight = launch(fleet(3))
    assert flight.wait() == 0, flight.text
    return flight


def test_a_fleet_flies_all_slots_and_leaves_nothing_behind(towards_each_other):
    flight = towards_each_other
    assert not flight.processes()
    assert {path.name for path in flight.run.iterdir()} == {"mission.yaml", "versions.json", "logs", "a", "b", "c"}
    assert {path.name for path in (flight.run / "logs").iterdir()} == {
        *("sitl.log", "rf.log", "agent.log", "bridge_a.log", "bridge_b.log", "bridge_c.log")
    }
    for name, log in logs(flight, "abc").items():
        assert log.complete
        assert sorted(log.by_slot(topics.LINK)) == list(range(12)), name
        states = log.messages(topics.STATE)
        assert states[-1].landed
        assert not states[-1].armed
        assert {path.name for path in (flight.run / name).iterdir()} == {
            *("mission.yaml", "flight.mcap", "flight.tlog", "report.json", "report.png")
        }
        assert load(flight.run / name / "mission.yaml").vehicle.name == name
    assert "12 of 12" in flight.text


def test_vehicles_that_would_fly_into_each_other_stay_apart(towards_each_other):
    recorded = logs(towards_each_other, "abc")
    found = {
        (first, second): min(gaps(one, other))
        for (first, one), (second, other) in itertools.combinations(paths(recorded).items(), 2)
    }
    assert min(found.values()) >= SEPARATION_M, found
    assert min(found.values()) < 2 * SEPARATION_M, "they have met"
    clipped = [
        reason
        for log in recorded.values()
        for slot in log.messages(topics.SLOT)
        if slot.flown
        for reason in slot.flown.reasons
    ]
    assert "envelope: separation" in clipped, "without it they would have come nearer"


def test_the_recording_of_one_of_several_replays_bit_for_bit(towards_each_other):
    """But for what the radio node took and the bridge had too late, on a busy machine: see `mission.replay`."""
    run = towards_each_other.run / "b"
    slots = flight_log.read(run).messages(topics.SLOT)
    late = {slot.flown.slot for slot in slots if slot.flown and slot.flown.outcome == "late"}
    result = replay(run)
    assert result.compared == 3 * 12
    assert [told for told in result.differences if int(told.rsplit(" ", 1)[-1]) not in late] == []


def test_the_resolved_mission_flies_the_fleet_again(towards_each_other):
    fields = yaml.safe_load((towards_each_other.run / "mission.yaml").read_text())
    assert [vehicle["name"] for vehicle in fields["vehicles"]] == ["a", "b", "c"]
