"""A mission of several vehicles: each gets a mission of its own, and every mistake is told in one line."""

import io
import queue
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.console import Console

from bus import topics
from bus.messages import MissionEvent
from bus.session import free_endpoint, open_session
from mission import flight_log, run_folder
from mission.embedded import command, free_udp_ports, simulators
from mission.fleet import check, load, missions, one_of, served
from mission.mission_file import Mission, MissionError, dump
from mission.mission_file import load as load_one
from mission.progress import FlightView
from mission.recorder import Recorder
from rf_model.seeding import vehicle_seeds
from sitl.origin import Origin


def test_each_vehicle_flies_what_the_mission_says_but_for_its_own(mission):
    path = mission(
        "seed: 7\nslots: 9\nspeed: 3\nat_end: land\npolicy: {kind: hover}\n"
        "vehicles: [{}, {start_enu: [4, 5, 60], parameters: {A: 1}}, {name: c, policy: {kind: random}}]"
    )
    fleet = load(path)
    check(fleet)
    first, second, third = missions(fleet)
    assert [one.vehicle.name for one in missions(fleet)] == ["star1", "star2", "c"]
    assert [one.vehicle.system_id for one in missions(fleet)] == [1, 2, 3]
    assert {(one.slots, one.clock, one.speed, one.at_end) for one in missions(fleet)} == {(9, "paced", 3.0, "land")}
    assert (first.scenario.start_enu, second.scenario.start_enu) == ((0, 0, 60), (4, 5, 60))
    assert second.scenario.model_copy(update={"start_enu": (0, 0, 60)}) == first.scenario
    assert second.vehicle.parameters == {"A": 1}
    assert (second.policy.kind, third.policy.kind) == ("hover", "random")
    assert {one.vehicle.name: one.seed for one in missions(fleet)} == vehicle_seeds(7, ["star1", "star2", "c"])


def test_a_file_of_one_vehicle_is_a_mission_as_ever(mission):
    path = mission("vehicle: {name: a}\nclock: lockstep")
    assert load(path) == load_one(path)
    assert missions(load(path)) == (load_one(path),)
    assert one_of(path, None) == (load_one(path), ())


@given(
    st.lists(
        st.fixed_dictionaries(
            {},
            optional={
                "start_enu": st.just([1, 2, 60.5]),
                "policy": st.just({"kind": "random"}),
                "sitl": st.just({"personality": "arducopter"}),
                "parameters": st.just({"B": 2}),
            },
        ),
        min_size=2,
        max_size=5,
    ),
    st.sampled_from([{}, {"speed": 4, "vehicles_spacing_m": 30, "limits": {"separation_m": 3}}]),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=10)
def test_the_resolved_mission_reads_back_as_the_same_one(mission, vehicles, more):
    fleet = load(mission(yaml.safe_dump({"vehicles": vehicles, "policy": {"kind": "hover"}} | more)))
    assert load(mission(dump(fleet))) == fleet
    for one in missions(fleet):
        assert load(mission(dump(one))) == one


FLEET = Path(__file__).parents[2] / "missions" / "fleet.yaml"
FOREIGN = "{autopilot: 'udpin://127.0.0.1:1'}"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("vehicles: []", ["vehicles: 0 given", "2 to 100", "`vehicle`"]),
        ("vehicles: [{}]", ["vehicles: 1 given", "2 to 100"]),
        ("vehicles: 3", ["vehicles: 3", "should be a list"]),
        ("vehicles: [{}, 3]", ["vehicles.1: 3"]),
        ("vehicle: {}\nvehicles: [{}, {}]", ["vehicles: in place of vehicle"]),
        ("clock: lockstep\nvehicles: [{}, {}]", ["clock: 'lockstep'", "one vehicle", "'paced'"]),
        ("clock: fast\nvehicles: [{}, {}]", ["clock: 'fast'", "'paced'"]),
        ("vehicles: [{name: a}, {name: a}]", ["vehicles.1.name: 'a'", "each needs its own"]),
        ("vehicles: [{name: star2}, {}]", ["vehicles.1.name: 'star2'"]),
        ("vehicles: [{name: a b}, {}]", ["vehicles.0.name: 'a b'", "letters"]),
        ("vehicles: [{name: logs}, {}]", ["vehicles.0.name: 'logs'"]),
        ("vehicles: [{system_id: 2}, {}]", ["vehicles.1.system_id: 2 is that of 'star1'"]),
        (f"vehicles: [{FOREIGN}, {FOREIGN}]", ["vehicles.1.autopilot: 'udpin://127.0.0.1:1' is that of 'star1'"]),
        (f"speed: 2\nvehicles: [{{}}, {FOREIGN}]", ["speed: 2", "vehicles.1.autopilot", "allows 1 at most"]),
        ("speed: 2\nvehicles: [{}, {backend: mavsdk}]", ["vehicles.1.backend: 'mavsdk'", "at speed 1 at most"]),
        ("vehicles: [{}, {strat_enu: [0, 0, 60]}]", ["vehicles.1.strat_enu: unknown key, did you mean start_enu?"]),
        ("vehicles: [{}, {start_enu: [0, 0, 600]}]", ["vehicles.1.start_enu: z = 600", "30 to 120"]),
        ("vehicles: [{}, {start_enu: [0, 60]}]", ["vehicles.1.start_enu"]),
        ("vehicles: [{}, {policy: {kind: genius}}]", ["vehicles.1.policy.kind: 'genius'"]),
        (
            "vehicles: [{}, {policy: {checkpoint: physical_small}}]\npolicy: {kind: hover}\n"
            "scenario: {preset: physical_small, users: 6}",
            ["vehicles.1.policy.checkpoint", "users"],
        ),
        ("vehicles: [{}, {signing_key: /none}]", ["vehicles.1.signing_key: /none"]),
        ("vehicles: [{}, {signing_key: /my_vehicle.key}]", ["vehicles.1.signing_key: /my_vehicle.key:"]),
        (
            "vehicles: [{}, {policy: {checkpoint: /my_policy.safetensors}}]",
            ["vehicles.1.policy.checkpoint: ", " /my_policy.safetensors:"],
        ),
        (
            "speed: 2\nvehicles: [{}, {autopilot: 'tcp://vehicle.local:1'}]",
            ["needs vehicles.1.autopilot", "'tcp://vehicle.local:1'"],
        ),
        ("vehicles: [{}, {sitl: {personality: inav}}]", ["vehicles.1.sitl.personality: 'inav'"]),
        ("vehicles: [{}, {}]\nvehicles_spacing: 3", ["vehicles_spacing: unknown key, did you mean vehicles_spacing_m"]),
        ("vehicles: [{}, {}]\nvehicles_spacing_m: 0", ["vehicles_spacing_m: 0", "greater than 0"]),
        ("vehicles_spacing_m: 3", ["vehicles_spacing_m: unknown key"]),
        (
            "vehicles: [{}, {}]\nvehicles_spacing_m: 7\nlimits: {separation_m: 6, horizontal_mps: 5}",
            ["vehicles.1:", "within 7.0 m", "'star1'", "limits.separation_m 6", "(vehicles_spacing_m is 7)"],
        ),
        (
            "vehicles: [{start_enu: [30, 0, 60]}, {start_enu: [-30, 0, 60]}]\nlimits: {separation_m: 3}",
            ["vehicles.1:", "within 0.0 m", "from home to start"],
        ),
    ],
)
def test_every_mistake_is_one_line_naming_field_value_and_what_is_allowed(mission, text, parts):
    with pytest.raises(MissionError) as caught:
        check(load(mission(text)))
    line = str(caught.value)
    assert "\n" not in line
    for part in parts:
        assert part in line


def test_who_reads_a_mission_of_one_is_told_that_several_fly(mission):
    with pytest.raises(MissionError, match="vehicles: several fly"):
        load_one(mission("vehicles: [{}, {}]"))


def test_nodes_take_the_vehicles_they_are_told(mission):
    path = mission("seed: 3\nvehicles: [{name: a}, {name: b}, {name: c}]")
    fleet = load(path)
    assert served(path) == missions(fleet)
    assert served(path, ["c", "a"]) == (missions(fleet)[2], missions(fleet)[0])
    with pytest.raises(MissionError, match="no vehicle 'd'; allowed are a, b, c"):
        served(path, ["a", "d"])
    assert one_of(path, "b") == (missions(fleet)[1], ("a", "c"))
    with pytest.raises(MissionError, match="give --vehicle, one of a, b, c"):
        one_of(path, None)
    several = served(mission("seed: 3"), ["x", "y"])
    assert {one.vehicle.name: one.seed for one in several} == vehicle_seeds(3, ["x", "y"])
    assert one_of(mission("seed: 3"), "x") == (several[0], ())


# Simulators.


def groups(mission, text):
    return [[one.vehicle.name for one in simulator.missions] for simulator in simulators(missions(load(mission(text))))]


def test_one_simulator_plays_all_that_it_can(mission):
    arducopter = "{sitl: {personality: arducopter}}"
    assert groups(mission, "vehicles: [{}, {}, {}]") == [["star1", "star2", "star3"]]
    assert groups(mission, f"vehicles: [{{}}, {arducopter}, {arducopter}]") == [["star1"], ["star2", "star3"]]
    assert groups(mission, "vehicles: [{}, {system_id: 7}, {system_id: 8}]") == [["star1"], ["star2", "star3"]]
    assert groups(mission, "vehicles: [{}, {sitl: {parameters: {SIH_KDV: 2}}}]") == [["star1"], ["star2"]]
    assert groups(mission, f"vehicles: [{{}}, {FOREIGN}, {{system_id: 2}}]") == [["star1", "star3"]]
    twelve = groups(mission, f"vehicles: [{', '.join(['{}'] * 12)}]")
    assert [len(group) for group in twelve] == [10, 2], "only ten have ports of their own"
    assert groups(mission, "vehicle: {}") == [["star1"]]


def test_every_vehicle_stands_where_its_place_in_the_list_says(mission):
    fleet = load(mission(f"seed: 5\nvehicles_spacing_m: 12\nvehicles: [{', '.join(['{}'] * 12)}]"))
    first, second = simulators(missions(fleet))

    def option(line, name):
        return line[line.index(name) + 1]

    line = command(second, 20000, fleet.seed, fleet.vehicles_spacing_m)
    latitude, longitude, altitude = map(float, option(line, "--home").split(","))
    assert Origin().local(latitude, longitude) == pytest.approx((0.0, 120.0), abs=1e-6)
    assert altitude == Origin().altitude
    assert [option(line, name) for name in ("--system-id", "--vehicles", "--spacing", "--seed")] == [
        *("11", "2", "12.0", "15")
    ]
    assert option(command(first, 20000, 5, 12.0), "--seed") == "5"
    alone = command(simulators((missions(load(mission("{}"))),)[0])[0], 20000, 5, 0.0)
    assert not {"--vehicles", "--home", "--spacing"} & set(alone)


def test_the_fleet_mission_is_sound():
    check(load(FLEET))
    assert len(simulators(missions(load(FLEET)))) == 1


def test_ports_in_a_row_are_free_ones():
    import socket

    first = free_udp_ports(4)
    held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
    try:
        for port, one in enumerate(held, start=first):
            one.bind(("127.0.0.1", port))
        assert not set(range(first, first + 4)) & {free_udp_ports(2), free_udp_ports(4)}
    finally:
        for one in held:
            one.close()


# Folders and recordings.


def test_the_run_folder_has_one_for_each_vehicle(mission, tmp_path):
    fleet = load(mission("vehicles: [{name: a}, {name: b}]"), output=tmp_path / "runs")
    run = run_folder.make(fleet)
    assert {path.name for path in run.iterdir()} == {"mission.yaml", "versions.json", "logs", "a", "b"}
    assert load(run / "mission.yaml") == fleet
    for one in missions(fleet):
        folder = run_folder.vehicle_folder(run, fleet, one)
        assert folder == run / one.vehicle.name
        assert load_one(folder / "mission.yaml") == one
    single = Mission.model_validate({"output": tmp_path / "runs"})
    assert run_folder.vehicle_folder(run, single, single) == run


def test_the_recordings_of_a_run_are_its_own_or_its_vehicles(tmp_path):
    assert run_folder.recorded(tmp_path) == [tmp_path]
    for name in ("b", "a"):
        (tmp_path / name).mkdir()
        (tmp_path / name / flight_log.FILE_NAME).touch()
    (tmp_path / "logs").mkdir()
    assert run_folder.recorded(tmp_path) == [tmp_path / "a", tmp_path / "b"]
    (tmp_path / flight_log.FILE_NAME).touch()
    assert run_folder.recorded(tmp_path) == [tmp_path]


def test_in_a_terminal_each_vehicle_is_a_row(flight):
    console = Console(record=True, force_terminal=True, width=160, file=io.StringIO())
    view = FlightView(console)
    vehicles = {name: view.vehicle(name, f"{name}: ") for name in ("a", "b")}
    handlers = {"event": "event", "state": "state", "slot": "slot", "rf/link": "link"}
    for topic, message in flight:
        if topic in handlers:
            getattr(vehicles["a"], handlers[topic])(message)
    vehicles["b"].note("not heard")
    console.print(view.panel())
    rows = {line.split()[0]: line for line in console.export_text().splitlines() if line.strip()}
    assert "b: not heard" in rows["b:"]
    assert "5 of 5" in rows["a"]
    assert "OFFBOARD" in rows["a"]
    assert "90%" in rows["a"]
    assert "1000" in rows["a"]
    assert rows["b"].split() == ["b", "starting"]


def test_several_recordings_in_one_process_do_not_wait_for_each_other(tmp_path):
    endpoint, names, each = free_endpoint(), ["a", "b", "c", "d"], 300
    for name in names:
        (tmp_path / name).mkdir()

    def recorded(name):
        return [event.time_s for event in flight_log.read(tmp_path / name).messages(topics.EVENT)]

    with open_session(listen=endpoint) as session:
        recorders = [Recorder(session, name, tmp_path / name / flight_log.FILE_NAME) for name in names]
        with open_session(connect=[endpoint]) as sender:
            seen = queue.SimpleQueue()
            kept = topics.watch_alive(sender, "a", lambda *heard: seen.put(heard))
            token = topics.declare_alive(session, "a", "mission")
            seen.get(timeout=20)  # the sender knows this token, so it knows the recorders declared before

            def send(name):
                event = topics.Publisher(sender, name, topics.EVENT)
                for number in range(each):
                    event.send(MissionEvent(time_s=float(number), source="t", kind="t", text="x" * 500))

            threads = [threading.Thread(target=send, args=(name,)) for name in names]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            deadline = time.monotonic() + 20
            while any(len(recorded(name)) < each - 1 for name in names):  # the last one is written at the end
                assert time.monotonic() < deadline
                time.sleep(0.02)
            kept.undeclare()
            token.undeclare()
        for recorder in recorders:
            recorder.close()
    for name in names:
        assert flight_log.read(tmp_path / name).complete
        assert recorded(name)[: each - 1] == list(range(each - 1))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["bridge", "--mission", "{file}"], "give --vehicle, one of a, b"),
        (["bridge", "--mission", "{file}", "--vehicle", "a", "--other", "b/c"], "'b/c' must be"),
        (["agent", "--mission", "{file}", "--vehicle", "c"], "no vehicle 'c'; allowed are a, b"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_2(mission, arguments, named):
    file = mission("vehicles: [{name: a}, {name: b}]")
    line = [sys.executable, "-m", "mission", *(part.format(file=file) for part in arguments)]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    (error,) = done.stderr.strip().splitlines()
    assert error.startswith("error: ")
    assert named in error
