"""Bad input and bad circumstances: one clear line, the right exit code, nothing left running."""

import math
import re
import socket
import subprocess
import sys

import pytest
import yaml
from pymavlink import mavutil

from agent.checkpoint import Checkpoint, describe, save
from agent.training_config import TrainingConfig
from bus.session import free_endpoint
from rf_model.scenario import preset

mavlink = mavutil.mavlink


def aerialstar(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "mission", *map(str, arguments)], capture_output=True, text=True, check=False
    )


def the_error(stderr):
    """The one line on stderr."""
    lines = stderr.strip().splitlines()
    assert len(lines) == 1, stderr
    assert lines[0].startswith("error: ")
    return lines[0]


@pytest.fixture
def foreign(short):
    """A mission for an autopilot that somebody else runs, at a port that was free a moment ago."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    vehicle = {"autopilot": f"udpin://127.0.0.1:{port}", "allow_without": ["battery_failsafe"]}
    return port, short | {"clock": "paced", "vehicle": vehicle}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"slot": 3}, ["slot", "unknown key", "slots"]),
        ({"vehicle": {"nam": "x"}}, ["vehicle.nam", "unknown key", "name"]),
        ({"slots": "many"}, ["slots", "'many'", "integer"]),
        ({"slots": 0}, ["slots", "0", "greater than or equal to 1"]),
        ({"limits": {"up_mps": -1}}, ["limits.up_mps", "-1", "greater than 0"]),
        ({"scenario": "physical_big"}, ["scenario", "'physical_big'", "physical_small"]),
        ({"scenario": {"preset": "physical_small", "p_max_dbm": 900}}, ["scenario", "p_max_dbm", "900", "100"]),
        ({"policy": {"kind": "da_ddpg", "checkpoint": "gone.safetensors"}}, ["gone.safetensors", "no such file"]),
        ({"vehicle": {"autopilot": "udpin://127.0.0.1:14540"}}, ["clock", "lockstep", "sitl", "paced"]),
        ({"speed": 3}, ["speed", "3", "paced"]),
        ({"vehicle": {"backend": "mavsdk"}}, ["vehicle.backend", "mavsdk", "paced"]),
    ],
)
def test_a_mission_that_cannot_be_flown_is_refused_before_anything_starts(tmp_path, short, change, named):
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(short | change))
    done = aerialstar("fly", path, "--output", tmp_path / "runs")
    assert done.returncode == 2
    line = the_error(done.stderr)
    for part in [str(path), *named]:
        assert part in line
    assert not (tmp_path / "runs").exists()


def test_a_checkpoint_of_other_dimensions_is_refused_before_anything_starts(tmp_path, short):
    scenario = preset("physical_small", users=2)
    save(tmp_path / "two.safetensors", Checkpoint(describe(scenario, TrainingConfig(), {}), {}))
    path = tmp_path / "misfit.yaml"
    policy = {"kind": "da_ddpg", "checkpoint": str(tmp_path / "two.safetensors")}
    path.write_text(yaml.safe_dump(short | {"policy": policy}))
    done = aerialstar("fly", path, "--output", tmp_path / "runs")
    assert done.returncode == 2
    line = the_error(done.stderr)
    assert "two.safetensors" in line
    assert "J = 2, the scenario has 4" in line
    assert not (tmp_path / "runs").exists()


def test_an_output_folder_that_cannot_be_written_is_refused(tmp_path, short):
    path = tmp_path / "short.yaml"
    path.write_text(yaml.safe_dump(short))
    (tmp_path / "file").write_text("")
    done = aerialstar("fly", path, "--output", tmp_path / "file" / "runs")
    assert done.returncode == 2
    line = the_error(done.stderr)
    assert "output" in line
    assert str(tmp_path / "file") in line


@pytest.mark.parametrize("node", ["rf", "agent"])
def test_a_zenoh_endpoint_that_refuses_is_named(tmp_path, short, node):
    path = tmp_path / "short.yaml"
    path.write_text(yaml.safe_dump(short))
    endpoint = free_endpoint()
    done = aerialstar(node, "--mission", path, "--connect", endpoint)
    assert done.returncode == 1
    assert endpoint in the_error(done.stderr)


def test_a_port_in_use_is_named(launch, foreign):
    port, mission = foreign
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        flight = launch(mission)
        assert flight.wait() == 1
    assert re.search(rf"^error: .*127\.0\.0\.1:{port}.*in use", flight.text, re.MULTILINE), flight.text
    assert not flight.processes()


def test_an_autopilot_that_never_answers_is_named(launch, foreign):
    port, mission = foreign
    flight = launch(mission)
    assert flight.wait() == 1
    assert re.search(rf"^error: .*127\.0\.0\.1:{port}.*never answered", flight.text, re.MULTILINE), flight.text
    assert not flight.processes()
    assert flight.log.complete


@pytest.fixture
def weak_sitl(foreign):
    """A simulated autopilot that has flown its battery down: it refuses to arm."""
    port, _ = foreign
    sitl = subprocess.Popen(
        [
            *(sys.executable, "-m", "sitl", "--companion-port", str(port), "--companion-bind", "0", "--gcs-bind", "0"),
            *("--lockstep", "--control-port", "0", "--param", "BAT1_CAPACITY=100", "--param", "BAT_CRIT_THR=0.5"),
            *("--speed", "20"),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        printed = dict(sitl.stdout.readline().split()[:2] for _ in range(3))
        host, control_port = printed["control"].split(":")
        gcs = mavutil.mavlink_connection(f"udpout:{printed['gcs']}", source_system=255)
        with socket.create_connection((host, int(control_port))) as control, control.makefile("rw") as lines:

            def advance(seconds):
                for _ in range(4 * seconds):  # no more at once than a socket holds
                    lines.write("advance 250\n")
                    lines.flush()
                    assert lines.readline().startswith("advanced")
                    while (message := gcs.recv_msg()) is not None:
                        heard[message.get_type()] = message

            def command(number, *parameters):
                padded = [*parameters, *[math.nan] * (7 - len(parameters))]
                gcs.mav.command_long_send(1, 1, number, 0, *padded)

            heard = {}
            gcs.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
            advance(10)
            command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            advance(1)
            command(mavlink.MAV_CMD_NAV_TAKEOFF)
            advance(40)
            command(mavlink.MAV_CMD_NAV_LAND)
            advance(40)
            assert not heard["HEARTBEAT"].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED, "it is down again"
            assert heard["SYS_STATUS"].battery_remaining < 50
        yield
    finally:
        sitl.kill()
        sitl.communicate()


def test_an_autopilot_that_refuses_to_arm_says_why(launch, foreign, weak_sitl):
    _, mission = foreign
    flight = launch(mission)
    assert flight.wait() == 1, flight.text
    assert re.search(r"^error: .*low battery", flight.text, re.MULTILINE), flight.text
    assert not flight.processes()


def test_a_node_that_cannot_start_is_told_in_its_own_words(launch, short):
    flight = launch(short | {"vehicle": {"sitl": {"parameters": {"SIH_KDX": 1.0}}}})
    assert flight.wait() == 1, flight.text
    assert re.search(r"^error: sitl: .*SIH_KDX.*SIH_KDV", flight.text, re.MULTILINE), flight.text
    assert not flight.processes()


def test_ctrl_c_while_the_nodes_start_leaves_nothing_behind(launch, short):
    flight = launch(short)
    flight.node("rf")
    flight.process.send_signal(2)
    assert flight.wait() in (1, 3), flight.text
    assert not flight.processes()
