"""The conformance kit passes our autopilots, fails wrong ones, and leaves every vehicle as it found it."""

import io
import json
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink
from rich.console import Console
from typer.testing import CliRunner

from sitl.conformance import parameters, report
from sitl.conformance.cli import conformance
from sitl.conformance.outcome import Outcome, Silent
from sitl.conformance.run import leave, meet, run
from sitl.conformance.suite import names, selected
from sitl.conformance.vehicle import Vehicle
from sitl.conformance.wire import WireError, connect, split
from tests.sitl.mutants import MUTANTS, Mutant, Spoiled
from tests.sitl.plans import item, upload
from tests.sitl.process import free_udp_port, sitl_process
from tests.sitl.stepped_wire import SteppedWire

NOT_DONE = {
    "px4": {"rally points"},
    "arducopter": {"rally points", "foreign component", "control without stream"},
}
"""Checks that do not apply to ours."""


def judged(wire: SteppedWire, *only: str) -> tuple[Vehicle, dict[str, Outcome]]:
    """A run of the kit on a wire, up to where it would land; the outcomes by name."""
    vehicle, outcomes = Vehicle(wire, clock=wire.clock), []
    meet(vehicle)
    run(vehicle, selected(3, frozenset(only)), outcomes)
    return vehicle, {outcome.name: outcome for outcome in outcomes}


@pytest.mark.parametrize("personality", ["px4", "arducopter"])
def test_ours_pass_and_are_left_as_they_were(personality):
    wire = SteppedWire(personality)
    try:
        autopilot = wire.direct.autopilot.vehicle
        mission = [item(16, 0, 0, 5), item(22, 0, 0, 5), item(16, 3, 3, 5)]
        assert upload(wire.direct, mission) == 0
        before = {name: autopilot.parameters[name] for name in autopilot.parameters.names}
        vehicle, outcomes = judged(wire)
        assert not leave(vehicle)
        assert not [outcome for outcome in outcomes.values() if outcome.verdict == "fail"]
        assert {name for name, outcome in outcomes.items() if outcome.verdict == "skip"} == NOT_DONE[personality]
        assert list(outcomes) == [check.name for check in selected()]
        assert not autopilot.commander.armed
        assert not autopilot.commander.flying
        assert {name: autopilot.parameters[name] for name in autopilot.parameters.names} == before
        kept = [(i.command, i.x, i.y) for i in autopilot.commander.plans.mission]
        assert kept[1:] == [(m[1], m[3], m[4]) for m in mission[1:]]  # the first is home, where there is one
        assert not autopilot.commander.plans.fence
        assert vehicle.autopilot.name == personality
    finally:
        wire.close()


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_a_wrong_autopilot_fails(mutant: Mutant):
    wire = Spoiled(mutant)
    try:
        _, outcomes = judged(wire, *mutant.kills, *mutant.along)
        survived = {name: outcomes[name] for name in mutant.kills if outcomes[name].verdict != "fail"}
        assert not survived
    finally:
        wire.close()


def test_every_check_can_fail():
    assert {name for mutant in MUTANTS for name in mutant.kills} == set(names())
    assert len(names()) == len(set(names()))


def test_the_kit_imports_nothing_of_the_simulator():
    code = "import sys, sitl.conformance.main; print(*(m for m in sys.modules if m.startswith('sitl.')))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, text=True).stdout.split()
    assert loaded
    assert all(module.startswith("sitl.conformance") for module in loaded)


def test_help_needs_no_heavy_imports():
    code = "import sys, sitl.conformance.cli; print(*{'numpy', 'pymavlink', 'rich.table'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout == b"\n"


# Frames and URLs


def frame_of(text: str) -> bytes:
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(mavlink.MAVLink_statustext_message(6, text.encode()).pack(codec))


@given(
    texts=st.lists(st.text("abc", min_size=1, max_size=9), max_size=6),
    cuts=st.lists(st.integers(1, 40), min_size=1, max_size=40),
)
def test_frames_come_out_of_a_stream_however_it_is_cut(texts, cuts):
    sent = [frame_of(text) for text in texts]
    stream, found, rest = b"".join(sent), [], b""
    while stream:
        size = cuts[len(found) % len(cuts)]
        frames, rest = split(rest + stream[:size])
        found += frames
        stream = stream[size:]
    assert found == sent
    assert rest == b""


@given(before=st.binary(max_size=40).filter(lambda data: not {0xFD, 0xFE} & set(data)))
def test_what_is_no_frame_is_passed_over(before):
    assert split(before + frame_of("x"))[0] == [frame_of("x")]


def cli(*arguments: str):
    app = typer.Typer()
    app.command()(conformance)
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nonsense"], ["nonsense", "udpin:HOST:PORT"]),
        (["udp:127.0.0.1:14550"], ["udp:127.0.0.1:14550", "udpin:HOST:PORT"]),
        (["udpin:127.0.0.1:0"], ["udpin:127.0.0.1:0", "1 to 65535"]),
        (["udpin:127.0.0.1:99999"], ["99999", "1 to 65535"]),
        (["tcp:127.0.0.1:1"], ["tcp:127.0.0.1:1", "refused"]),
        (["udpout:nowhere.invalid:14550"], ["nowhere.invalid"]),
        (["udpin:127.0.0.1:14999", "--only", "flight"], ["flight", "no such check", "takeoff"]),
        (["udpout:127.0.0.1:9", "--tlog", "/nowhere/log"], ["/nowhere/log", "cannot be written"]),
    ],
)
def test_bad_options_are_one_clear_line(arguments, words):
    done = cli(*arguments)
    assert done.exit_code == 2
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert all(word in done.stderr for word in words), done.stderr


def test_port_in_use_is_one_clear_line():
    port = free_udp_port()
    taken = connect(f"udpin:127.0.0.1:{port}")
    try:
        with pytest.raises(WireError, match=str(port)):
            connect(f"udpin://127.0.0.1:{port}")
    finally:
        taken.close()


class Still:
    """A wire on which nothing comes."""

    def __init__(self) -> None:
        self.now = 0.0

    def send(self, frame: bytes) -> None:
        pass

    def receive(self, timeout_s: float) -> list[bytes]:
        self.now += timeout_s
        return []


def test_silence_ends_the_wait():
    wire = Still()
    with pytest.raises(Silent, match="no HEARTBEAT"):
        Vehicle(wire, clock=lambda: wire.now).meet()
    assert wire.now == pytest.approx(10.0, abs=0.1)


def test_a_vehicle_that_falls_silent_in_flight_fails_what_is_left():
    wire = SteppedWire("px4")
    try:
        vehicle, outcomes = Vehicle(wire, clock=wire.clock), []
        meet(vehicle)
        run(vehicle, selected(0, frozenset({"on the ground"})), outcomes)
        wire.direct.udp.close()
        still = Still()
        vehicle.wire, vehicle._clock = still, lambda: wire.clock() + still.now
        run(vehicle, selected(0, frozenset({"heartbeat", "ping"})), outcomes)
        assert [(outcome.verdict, "nothing heard" in outcome.seen) for outcome in outcomes] == [
            ("pass", False),
            ("fail", True),
            ("fail", True),
        ]
    finally:
        wire.close()


# As a program, over sockets


def program(url: str, *arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "sitl.conformance", url, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_as_a_program_on_udp_with_a_log(tmp_path):
    """udpin as a companion; the table, and a log that pymavlink's mavlogdump reads."""
    log = tmp_path / "kit.tlog"
    with sitl_process(lockstep=False, speed=5.0) as sitl:
        only = ["--only", "velocity ned", "--only", "command is answered"]
        done = program(f"udpin:127.0.0.1:{sitl.companion}", *only, "--tlog", str(log))
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 pass, 0 fail, 0 skip" in done.stdout
    assert "px4" in done.stdout
    dump = [sys.executable, str(Path(sys.executable).with_name("mavlogdump.py")), "--format", "json"]
    dump += ["--types", "SET_POSITION_TARGET_LOCAL_NED,LOCAL_POSITION_NED", str(log)]
    lines = subprocess.run(dump, capture_output=True, text=True, check=True).stdout.splitlines()
    messages = [json.loads(line) for line in lines]
    asked = [m["data"]["vx"] for m in messages if m["meta"]["type"] == "SET_POSITION_TARGET_LOCAL_NED"]
    flown = [m["data"]["vx"] for m in messages if m["meta"]["type"] == "LOCAL_POSITION_NED"]
    assert 2.0 in asked
    assert max(flown) == pytest.approx(1.75, abs=0.25)


def test_as_a_program_on_tcp_with_json():
    with sitl_process("--personality", "arducopter", "--tcp-port", "0", lockstep=False, speed=20.0) as sitl:
        done = program(f"tcp:127.0.0.1:{sitl.tcp}", "--level", "0", "--json", "--personality", "arducopter")
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(done.stdout)
    assert told["counts"] == {"pass": 11, "fail": 0, "skip": 0}
    assert told["not_restored"] == []
    assert {check["level"] for check in told["checks"]} == {0}
    assert all(check["clause"] for check in told["checks"])


def test_a_failure_is_exit_code_1():
    """An ArduCopter that is expected to be a PX4."""
    with sitl_process("--personality", "arducopter", "--tcp-port", "0", lockstep=False, speed=20.0) as sitl:
        url = f"udpout:127.0.0.1:{sitl.gcs_bind}"
        done = program(url, "--only", "heartbeat", "--personality", "px4", "--json")
    assert done.returncode == 1, done.stdout + done.stderr
    (check,) = json.loads(done.stdout)["checks"]
    assert check["verdict"] == "fail"
    assert "px4" in check["seen"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_in_the_air_it_lands_and_restores(number):
    with sitl_process(lockstep=False, speed=8.0) as sitl:
        watcher = Vehicle(connect(f"udpout:127.0.0.1:{sitl.gcs_bind}"))
        command = [sys.executable, "-m", "sitl.conformance", f"udpin:127.0.0.1:{sitl.companion}", "--json"]
        kit = subprocess.Popen([*command, "--only", "stream lost"], stdout=subprocess.PIPE, text=True)
        try:
            meet(watcher)
            watcher.until(lambda: "LOCAL_POSITION_NED" in watcher.latest, 10.0, "a position")
            watcher.until(lambda: watcher.now.position[0] > 2.0, 120.0, "flying north")
            assert watcher.armed
            assert parameters.read(watcher, "COM_OBL_RC_ACT").value == 5
            kit.send_signal(number)
            watcher.until(lambda: not watcher.armed, 120.0, "landed and disarmed")
            told = json.loads(kit.communicate(timeout=60)[0])
            assert watcher.now.position[2] == pytest.approx(0.0, abs=0.1)
            assert parameters.read(watcher, "COM_OBL_RC_ACT").value == 0
        finally:
            kit.kill()
            watcher.wire.close()
        assert kit.returncode == 1
        assert told["not_restored"] == ["interrupted"]


@pytest.mark.parametrize("width", [60, 80, 200])
def test_the_table_leaves_no_word_out(width):
    """Also piped, when rich takes the terminal to be 80 columns wide."""
    seen, clause = "velocity 4.93 of 5 [m/s] after 8 s", "MAVLink common: SET_POSITION_TARGET_LOCAL_NED is followed"
    told = io.StringIO()
    outcome = Outcome(3, "velocity setpoints", "pass", seen, clause, 8.0)
    report.show(Console(file=told, width=width), [outcome], "PX4", [])
    text = told.getvalue()
    assert "…" not in text
    assert Counter("".join((seen + clause).split())) <= Counter(text)
    if width == 200:
        assert seen in text
        assert clause in text
