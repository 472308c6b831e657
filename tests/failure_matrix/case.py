"""One flight of the matrix with the bridge in this process: recorded, witnessed, and held to its row."""

import socket
from contextlib import ExitStack
from functools import cached_property
from types import SimpleNamespace

from pymavlink import mavutil

from mission import flight_log
from mission.recorder import Recorder
from tests.failure_matrix.rows import ROWS, judge
from tests.failure_matrix.witness import Witness
from tests.sitl.process import step

SETPOINT = "SET_POSITION_TARGET_LOCAL_NED"
PATIENCE_S = 120.0  # only a failing test waits that long
AUTOPILOTS = {
    "px4": ("--personality", "px4"),
    "arducopter": ("--personality", "arducopter", "--tcp-port", "0"),
}


class Case:
    """A flight of `fault`'s row, that waits for `start`.

    `fly` is the fixture of tests/autopilot_bridge, to which `options` go; `gcs`, `control`: the autopilot's ports.
    """

    def __init__(self, fault, fly, config, folder, decide, *, gcs, control, **options):
        self.row = ROWS[fault]
        self.folder = folder
        self.tlog = folder / "flight.tlog"
        self.fence_m = max(abs(bound) for bound in (*config.slot_fence.spans[0], *config.slot_fence.spans[1]))
        self._control = control
        self._held = ExitStack()
        self.witness = Witness(gcs)
        self._held.callback(self.witness.close)
        self.flight = fly(config.model_copy(update={"autostart": False}), decide, tlog=self.tlog, **options)
        recorder = Recorder(self.flight.session, self.flight.vehicle, folder / flight_log.FILE_NAME)
        self._held.enter_context(recorder)

    def start(self):
        self.flight.until_phase("ready")
        assert self.flight.command("start").accepted

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._held.close()

    def inject(self, what):
        """A fault by the autopilot's control socket."""
        with socket.create_connection(("127.0.0.1", self._control)) as line, line.makefile("r") as answers:
            line.sendall(f"inject {what}\n".encode())
            answer = answers.readline()
        assert answer.startswith("injected"), answer

    def let_pass(self, until_s):
        """Let a paced vehicle's time pass at once, as far as `until_s`."""
        missing_s = until_s - self.witness.last.time_s
        if missing_s > 0:
            step(SimpleNamespace(control=self._control), round(missing_s * 1000))

    def over(self):
        """Wait for the end, also of a bridge that nobody on the bus hears; the exit code."""
        self.flight.thread.join(PATIENCE_S)
        assert not self.flight.thread.is_alive(), "still flying"
        return self.flight.code

    def judge(self, fault_s):
        """Hold the flight to its row once it is over; `fault_s`: vehicle time of the fault."""
        code = self.over()
        self._held.close()
        log = flight_log.read(self.folder)
        judge(self.row, self.witness, log, self.frames, self.fence_m, code, fault_s)
        assert log.complete
        assert log.lost_bytes == 0
        return log

    @cached_property
    def frames(self):
        """Every frame of the tlog, once the flight is over; fails when one cannot be read."""
        return read_tlog(self.tlog)

    @property
    def setpoints_s(self):
        """Vehicle times of the setpoints sent."""
        return [message.time_boot_ms / 1000 for message in self.frames if message.get_type() == SETPOINT]


def ports(autopilot):
    """Of the `sitl` fixture's vehicle."""
    return {"gcs": int(autopilot.gcs.split(":")[1]), "control": int(autopilot.control.split(":")[1])}


def read_tlog(path):
    """All messages, by pymavlink; one that cannot be read fails."""
    log = mavutil.mavlink_connection(str(path), robust_parsing=False)
    frames = []
    while (message := log.recv_msg()) is not None:
        assert message.get_type() != "BAD_DATA", f"{path}: bad data after {len(frames)} frames"
        frames.append(message)
    return frames
