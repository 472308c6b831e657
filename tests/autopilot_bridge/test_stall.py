"""A bridge that was frozen or stalled sends nothing on waking before it knows anew who flies; one that is gone is
followed by the autopilot's own failsafe. Real bridge processes, real signals, on both autopilots."""

import contextlib
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge import helm
from tests.autopilot_bridge.on_the_wire import OFFBOARD, OURS, asked, heard_mode, of_vehicle, read_log, setpoints

SPEED = 10.0
RTL = {"px4": 4 << 16 | 5 << 24, "arducopter": 6}
PATIENT = {
    "px4": {"COM_OF_LOSS_T": 10},
    "arducopter": {"GUID_TIMEOUT": 5, "FS_GCS_TIMEOUT": 30},
}
"""A busy machine's own stalls are many times as long at speed."""

PROGRAM = """
import sys
from pathlib import Path
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.node import run
from bus.session import open_session
session = open_session()
code = run(BridgeConfig.model_validate_json(sys.argv[1]), "test", session, Path(sys.argv[2]))
session.close()
sys.exit(code)
"""


class Station:
    """A ground station that watches the vehicle's mode."""

    def __init__(self, gcs):
        host, port = gcs.split(":")
        self.codec = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self.decoder = mavlink.MAVLink(None)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.05)
        self.place = (host, int(port))
        self.mode, self.armed = None, None

    def watch(self):
        beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0, 3)
        self.socket.sendto(beat.pack(self.codec), self.place)
        with contextlib.suppress(TimeoutError):
            while True:
                for message in self.decoder.parse_buffer(self.socket.recv(4096)) or ():
                    if message.get_type() == "HEARTBEAT" and message.get_srcSystem() == 1:
                        self.mode = message.custom_mode
                        self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
                        return

    def until(self, condition, what):
        deadline = time.monotonic() + 60
        while not condition():
            assert time.monotonic() < deadline, f"waited in vain for {what}"
            self.watch()

    def until_mode(self, mode):
        self.until(lambda: self.mode == mode, f"mode {mode:#x}")


class Bridge:
    """A bridge process that holds in its slots, since no agent is there; and its autopilot."""

    def __init__(self, personality, sitl, bridge_config, folder):
        self.personality, self.tlog = personality, folder / "flight.tlog"
        self.autopilot = sitl("--speed", str(SPEED), "--personality", personality)
        self.station = Station(self.autopilot.gcs)
        config = bridge_config(
            self.autopilot,
            clock={"kind": "paced", "speed": SPEED},
            slots=100000,
            grace_s=3600.0,
            hold_mode_s=3600.0,
            parameters=PATIENT[personality],
        )
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, config.model_dump_json(), str(self.tlog)],
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[2],
        )
        self.said = []
        self.reader = threading.Thread(target=lambda: self.said.extend(self.process.stdout))
        for line in self.process.stdout:
            self.said.append(line)
            if "phase: slots" in line or "phase: holding" in line:
                break
        self.reader.start()
        time.sleep(0.3)

    def signal(self, number):
        self.process.send_signal(number)

    def freeze(self):
        """What the log held then."""
        self.signal(signal.SIGSTOP)
        stat = Path(f"/proc/{self.process.pid}/stat")
        while stat.read_text().rpartition(")")[2].split()[0] != "T":
            time.sleep(0.001)
        return len(read_log(self.tlog))

    def wait(self):
        code = self.process.wait(90)
        self.reader.join()
        return code

    def told(self, kind):
        return [line.partition(f" {kind}: ")[2].strip() for line in self.said if f" {kind}: " in line]

    def close(self):
        with contextlib.suppress(ProcessLookupError):
            self.process.kill()
        self.process.wait()
        if self.reader.is_alive():
            self.reader.join()
        self.process.stdout.close()
        self.station.socket.close()


@pytest.fixture(params=["px4", "arducopter"])
def bridge(request, sitl, bridge_config, tmp_path):
    bridge = Bridge(request.param, sitl, bridge_config, tmp_path)
    yield bridge
    bridge.close()


def test_a_bridge_frozen_until_the_failsafe_obeys_it(bridge):
    """By then its socket's buffer is full of HEARTBEATs from before, and the kernel has dropped the newer ones."""
    frozen = bridge.freeze()
    bridge.station.until_mode(RTL[bridge.personality])
    time.sleep(0.5)
    bridge.signal(signal.SIGCONT)
    assert bridge.wait() == 3
    (stall, *_), (mode, *_) = bridge.told("stall"), bridge.told("mode")
    assert "without listening: nothing is sent before the mode is known anew" in stall
    assert "RTL was chosen by autopilot or pilot: obeyed" in mode
    assert bridge.told("phase")[-1] == "yielded"
    log = read_log(bridge.tlog)
    assert len(asked(log[frozen:])) <= 1, "one may have been on its way into the socket"
    home = heard_mode(log, RTL[bridge.personality])
    assert asked(log[home:]) == []
    flying = [m for i, m in of_vehicle(log, "HEARTBEAT") if i > home and m.base_mode & 128]
    assert {m.custom_mode for m in flying} == {RTL[bridge.personality]}


def test_a_bridge_frozen_for_a_moment_asks_who_flies_and_goes_on(bridge):
    frozen = bridge.freeze()
    time.sleep(0.2)  # 2 s of vehicle time, so no failsafe
    bridge.signal(signal.SIGCONT)
    time.sleep(1.0)
    bridge.signal(signal.SIGINT)
    assert bridge.wait() == 3
    assert bridge.told("mode") == []
    assert bridge.told("phase")[-1] == "landing"
    log = read_log(bridge.tlog)[frozen:]
    asked_at = next(i for i, m in enumerate(log) if m.get_type() == "TIMESYNC" and m.get_srcSystem() == OURS)
    questions = {m.ts1 for m in log if m.get_type() == "TIMESYNC" and m.get_srcSystem() == OURS}
    answered_at = next(i for i, m in of_vehicle(log, "TIMESYNC") if m.tc1 and m.ts1 in questions)
    told_at = next(i for i, _ in of_vehicle(log, "HEARTBEAT") if i > answered_at)
    assert asked_at < answered_at < told_at
    assert len(asked(log[:told_at])) <= 1, "one may have been on its way into the socket"
    assert len(setpoints(log[told_at:])) > 10


def test_a_bridge_that_is_killed_is_followed_by_the_failsafe(bridge):
    bridge.signal(signal.SIGKILL)
    bridge.wait()
    bridge.station.until_mode(RTL[bridge.personality])
    bridge.station.until(lambda: not bridge.station.armed, "the ground")


def test_a_stall_right_before_the_wire_costs_the_setpoint(sitl, fly, bridge_config, tmp_path, monkeypatch):
    """The thread that flies is blocked between what it knows and what it sends, until PX4's failsafe acts."""
    autopilot = sitl("--speed", str(SPEED))
    station = Station(autopilot.gcs)
    stalled = []

    def slow(reference, position, lead_s):
        if flight.slots and flight.slots[-1].slot >= 1 and not stalled:
            stalled.append(len(read_log(tmp_path / "flight.tlog")))
            station.until_mode(RTL["px4"])
        return track(reference, position, lead_s)

    track = helm.track
    monkeypatch.setattr(helm, "track", slow)
    config = bridge_config(
        autopilot, clock={"kind": "paced", "speed": SPEED}, slots=1000, parameters=PATIENT["px4"], autostart=False
    )
    flight = fly(config, tlog=tmp_path / "flight.tlog")
    flight.until_phase("ready")
    flight.command("start")
    assert flight.wait() == 3
    station.socket.close()
    assert "AUTO.RTL was chosen" in flight.told("mode")[0]
    log = read_log(tmp_path / "flight.tlog")
    assert asked(log[stalled[0] :]) == []
    flying = [m for i, m in of_vehicle(log, "HEARTBEAT") if i > heard_mode(log, RTL["px4"]) and m.base_mode & 128]
    assert OFFBOARD[mavlink.MAV_AUTOPILOT_PX4] not in {m.custom_mode for m in flying}
