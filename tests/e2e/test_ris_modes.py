"""The rf node sets the surface by itself: in a flight, and for several vehicles with nobody but who opens the slots."""

import queue
from collections import Counter

import pytest
import yaml

from bus import topics
from bus.messages import MissionEvent, SlotOpened
from bus.session import free_endpoint, open_session
from mission.replay import replay
from mission.supervisor import Node, python
from mission.transitions import transitions
from rf_model.ris_control import RisControl
from rf_model.scenario import preset
from rf_model.seeding import vehicle_seeds
from rf_model.slot_radio import SlotRadio

PATIENCE_S = 120.0  # only a failing test waits that long; the reference may have to compile


def test_a_flight_whose_surface_is_optimised_repeats_bit_for_bit_in_its_own_mode_only(launch, short):
    flight = launch(short | {"ris": {"mode": "optimised", "iterations": 5}, "slots": 3})
    assert flight.wait() == 0, flight.text
    configurations = flight.log.by_slot(topics.CONFIGURATION)
    assert [configurations[slot].source for slot in sorted(configurations)] == ["optimised"] * 3
    actions = flight.log.by_slot(topics.ACTION)
    assert all(actions[slot].theta_reflection != configurations[slot].theta_reflection for slot in actions)
    assert flight.report["configurations"] == {"optimised": 3}
    assert flight.report["actions"].keys() <= {"flown", "clipped"}
    assert flight.report["ris"] == "optimised"
    assert "optimised: optimised 3" in flight.text

    links = flight.log.by_slot(topics.LINK)
    rebuilt = transitions(flight.run)
    assert rebuilt  # a slot whose beams use less than full power is left out
    assert [row.reward for row in rebuilt] == pytest.approx([links[row.slot].reward for row in rebuilt])

    again = replay(flight.run)
    assert again.same, str(again)
    path = flight.run / "mission.yaml"
    fields = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(fields | {"ris": "closed_form"}))
    other = replay(flight.run)
    assert len(other.differences) == 6, str(other)


def opened(slot):
    return SlotOpened(
        slot=slot,
        slots=9,
        time_s=float(slot),
        position_enu=(0.0, 0.0, 60.0),
        velocity_enu=(1.0, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.0),
        closing=False,
        flown=None,
    )


def test_one_process_serves_several_vehicles_until_all_have_ended(tmp_path):
    (tmp_path / "m.yaml").write_text("seed: 3\nris: closed_form")
    names = ["left", "right"]
    seeds = vehicle_seeds(3, names)
    radios = {name: SlotRadio(preset("physical_small"), seeds[name], RisControl(mode="closed_form")) for name in names}
    endpoint = free_endpoint()
    with open_session(listen=endpoint) as session:
        heard, gone = {name: queue.SimpleQueue() for name in names}, queue.SimpleQueue()
        slots, events, kept = {}, {}, []
        for name in names:
            for topic in (topics.CONFIGURATION, topics.CSI):
                kept.append(topics.subscribe(session, name, topic, heard[name].put, Counter()))
            kept.append(topics.watch_alive(session, name, lambda _, alive, name=name: gone.put((name, alive))))
            slots[name] = topics.Publisher(session, name, topics.SLOT)
            events[name] = topics.Publisher(session, name, topics.EVENT)
        command = python("mission", "rf", "--mission", str(tmp_path / "m.yaml"), "--connect", endpoint, "--until-ended")
        node = Node("rf", [*command, "--vehicle", names[0], "--vehicle", names[1]], tmp_path)
        try:
            assert {gone.get(timeout=PATIENCE_S) for _ in names} == {(name, True) for name in names}
            for slot, flying in enumerate([names, ["right"]]):
                for name in flying:
                    slots[name].send(opened(slot))
                for name in flying:
                    expected = [
                        m for m in radios[name].open(opened(slot)) if hasattr(m, "source") or hasattr(m, "bs_ris")
                    ]
                    got = [heard[name].get(timeout=PATIENCE_S) for _ in expected]
                    # Two topics may overtake each other.
                    assert sorted(map(topics.encode, got)) == sorted(map(topics.encode, expected))
                ending = flying[0]
                events[ending].send(MissionEvent(time_s=1.0, source="bridge", kind="ended", text="", exit_code=0))
                assert gone.get(timeout=PATIENCE_S) == (ending, False)
            assert node.wait(PATIENCE_S)
            assert node.exit_code == 0
            assert f"right has seed {seeds['right']}" in node.log.read_text()
        finally:
            node.end()
