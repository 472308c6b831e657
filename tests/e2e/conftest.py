"""Real flights: the command line in processes of its own, real UDP, a real zenoh session; nothing is left behind."""

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from pathlib import Path

import pytest
import yaml

from bus import topics
from bus.session import open_session
from mission import flight_log

TAG = "AERIALSTAR_TEST"
PATIENCE_S = 120.0  # only a failing test waits that long
LOW = {  # near the ground, so that takeoff and landing are short
    "preset": "physical_small",
    "box_enu": [[-100, 100], [-100, 100], [10, 120]],
    "start_enu": [0, 0, 15],
}
SHORT = {"scenario": LOW, "slots": 6, "policy": {"kind": "random"}, "at_end": "land"}


class Flight:
    """One `aerialstar ...` process and all that it starts, told apart from everything else by an environment tag."""

    def __init__(self, folder, arguments, environment):
        self.folder = folder
        self.tag = uuid.uuid4().hex
        self.output = folder / f"{self.tag}.out"
        with self.output.open("wb") as out:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "mission", *map(str, arguments)],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | environment | {TAG: self.tag},
            )

    @property
    def text(self):
        return self.output.read_text(errors="replace")

    @property
    def run(self):
        (run,) = (self.folder / "runs").iterdir()
        return run

    @property
    def log(self):
        return flight_log.read(self.run)

    @property
    def report(self):
        return json.loads((self.run / "report.json").read_text())

    def wait(self, timeout_s=PATIENCE_S):
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            pytest.fail(f"still running after {timeout_s:g} s:\n{self.text}")

    def processes(self):
        """Command lines by pid of what this flight started and still runs."""
        mark = f"{TAG}={self.tag}".encode()
        found = {}
        for process in Path("/proc").iterdir():
            if process.name.isdigit():
                with contextlib.suppress(OSError):
                    if mark in (process / "environ").read_bytes().split(b"\0"):
                        found[int(process.name)] = (process / "cmdline").read_bytes().decode().split("\0")
        return found

    def node(self, name):
        """(pid, command line) of a node, once it is there."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            for pid, command in self.processes().items():
                if command[2:4] == ["mission", name]:
                    return pid, command
            assert self.process.poll() is None, self.text
            time.sleep(0.02)
        pytest.fail(f"{name} never started:\n{self.text}")

    def session(self):
        """A session on the flight's bus."""
        _, command = self.node("bridge")
        return open_session(connect=[command[command.index("--connect") + 1]])

    def await_slot(self, slot):
        """Return as soon as a slot opens, as seen on the bus."""
        opened = queue.SimpleQueue()
        with self.session() as session:
            keep = topics.subscribe(session, "star1", topics.SLOT, opened.put, Counter())
            with contextlib.suppress(queue.Empty):
                while opened.get(timeout=PATIENCE_S).slot < slot:
                    pass
                return
            del keep
        pytest.fail(f"slot {slot} never opened:\n{self.text}")

    def await_end(self):
        """Wait until everything has ended by itself."""
        deadline = time.monotonic() + PATIENCE_S
        while left := self.processes():
            if time.monotonic() > deadline:
                pytest.fail(f"still there: {left}")
            time.sleep(0.05)

    def signal(self, name, number):
        os.kill(self.node(name)[0], number)

    def kill(self, name):
        self.signal(name, signal.SIGKILL)

    def port(self, name):
        """The embedded autopilot's port of that name, once it is open."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            for log in (self.folder / "runs").glob("*/logs/sitl.log"):
                for line in log.read_text().splitlines():
                    if line.startswith(f"{name} 127.0.0.1:"):
                        return int(line.split()[1].split(":")[1])
            assert self.process.poll() is None, self.text
            time.sleep(0.02)
        pytest.fail(f"the autopilot never opened its port {name}:\n{self.text}")

    def end(self):
        for pid in self.processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self.process.wait()


@pytest.fixture(scope="session")
def launch(tmp_path_factory):
    """Start `aerialstar fly` of a mission given by its fields or its file; killed at the end whatever happens."""
    flights = []

    def start(mission, *options, **environment):
        folder = tmp_path_factory.mktemp("flight")
        if isinstance(mission, dict):
            path = folder / "short.yaml"
            path.write_text(yaml.safe_dump(mission))
        else:
            path = mission
        flight = Flight(folder, ["fly", path, "--output", folder / "runs", *options], environment)
        flights.append(flight)
        return flight

    yield start
    for flight in flights:
        flight.end()


@pytest.fixture
def short():
    """Fields of a short mission."""
    return dict(SHORT)
