"""A bridge as a process of its own, its autopilot, and a ground station that watches the vehicle's mode."""

import contextlib
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from pymavlink.dialects.v20 import common as mavlink

from tests.autopilot_bridge.on_the_wire import read_log

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
