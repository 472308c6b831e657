"""A flight of the matrix by `aerialstar fly`, every node a process: witnessed, and held to its row."""

import queue
import signal
from collections import Counter

from bus import topics
from tests.failure_matrix.case import read_tlog
from tests.failure_matrix.rows import ROWS, judge
from tests.failure_matrix.witness import Witness

PATIENCE_S = 60.0
FENCE_M = 110.0
"""The short mission's box and 10 m."""
STOPPED_S, STILL_MPS = 3.0, 0.5
SPEED = 5.0
PACED = {"clock": "paced", "speed": SPEED}
LOW = {  # so that returns are short, and a busy machine's stalls at SPEED do not pass for a lost stream
    "px4": {"RTL_RETURN_ALT": 12.0, "RTL_DESCEND_ALT": 5.0, "COM_OF_LOSS_T": 3.0},
    "arducopter": {"RTL_ALT": 1200.0, "RTL_LOIT_TIME": 0.0, "BATT_LOW_VOLT": 10.5},
}
RETURNING = {"px4": 4 << 16 | 5 << 24, "arducopter": 6}
"""HEARTBEAT.custom_mode."""


class Launched:
    """A flight of `fault`'s row; `launch` and `short` are the fixtures of tests/e2e."""

    def __init__(self, fault, launch, short, personality="px4", slots=1000, **fields):
        self.row = ROWS[fault]
        self.personality = personality
        vehicle = {"sitl": {"personality": personality, "parameters": LOW[personality]}}
        self.flight = launch(short | {"slots": slots, "vehicle": vehicle} | fields)
        self.witness = Witness(self.flight.port("gcs"))
        self.session = self.flight.session()
        self._opened, self._states = queue.SimpleQueue(), queue.SimpleQueue()
        self._keep = [self.listen(topics.SLOT, self._opened), self.listen(topics.STATE, self._states)]
        self.fault_s = None
        """Vehicle time of the fault."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.session.close()
        self.witness.close()

    def listen(self, topic, inbox):
        return topics.subscribe(self.session, "star1", topic, inbox.put, Counter())

    def until_slot(self, slot):
        """The opening of `slot`, or of the first one after it that has not been given yet."""
        while (opened := self._opened.get(timeout=PATIENCE_S)).slot < slot:
            pass
        return opened

    def until_time(self, time_s):
        while self._states.get(timeout=PATIENCE_S).time_s < time_s:
            pass

    def until_returning(self):
        return self.witness.until(lambda sight: sight.custom_mode == RETURNING[self.personality], "the return")

    def begin(self, name, number=signal.SIGKILL):
        """The fault: a signal to a node."""
        self.fault_s = self.witness.last.time_s
        self.flight.signal(name, number)

    def judge(self):
        """Wait for the end and hold the flight to its row; the log."""
        code = self.flight.wait()
        assert not self.flight.processes()
        return self.judge_logs(code)

    def judge_logs(self, code):
        self.frames = read_tlog(self.flight.run / "flight.tlog")
        log = self.flight.log
        judge(self.row, self.witness, log, self.frames, FENCE_M, code, self.fault_s)
        return log

    def stood_still(self, log):
        """Whether it truly stood in the autopilot's hold, until it returned."""
        rungs = {
            event.text.split(":")[0]: event.time_s for event in log.messages(topics.EVENT) if event.kind == "ladder"
        }
        held = self.witness.since(rungs["HOLD -> HOLD_MODE"] + STOPPED_S)
        return all(sight.speed_mps < STILL_MPS for sight in held if sight.time_s < rungs["HOLD_MODE -> RETURN"])


def outcomes(log):
    """Of the slots, in order."""
    return [opened.flown.outcome for opened in log.messages(topics.SLOT) if opened.flown]
