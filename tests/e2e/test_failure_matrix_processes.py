"""The failure matrix's rows of a bridge that is killed or frozen, of a killed mission, of a full disk."""

import resource
import signal

import pytest

from tests.failure_matrix.case import SETPOINT
from tests.failure_matrix.launched import PACED, RETURNING, Launched
from tests.failure_matrix.rows import BOTH

FROM_SLOT = 2
SLOTS = 15
FROZEN_S = 10.0


@pytest.mark.parametrize("personality", BOTH)
def test_bridge_killed(launch, short, personality):
    with Launched("bridge killed", launch, short, personality) as case:
        case.until_slot(FROM_SLOT)
        case.begin("bridge")
        case.judge()
        assert "bridge: killed by SIGKILL; the autopilot's failsafe brings the vehicle down" in case.flight.text


@pytest.mark.parametrize("personality", BOTH)
def test_bridge_frozen(launch, short, personality):
    with Launched("bridge frozen", launch, short, personality, **PACED) as case:
        case.until_slot(FROM_SLOT)
        case.begin("bridge", signal.SIGSTOP)
        case.judge()


@pytest.mark.parametrize("personality", BOTH)
def test_bridge_frozen_and_back(launch, short, personality):
    with Launched("bridge frozen for 10 s", launch, short, personality, **PACED) as case:
        case.until_slot(FROM_SLOT)
        case.begin("bridge", signal.SIGSTOP)
        woken = case.witness.until(lambda sight: sight.time_s > case.fault_s + FROZEN_S, "10 s")
        case.flight.signal("bridge", signal.SIGCONT)
        case.judge()
        # What it sent before it was stopped has stamps of then.
        late = [f.time_boot_ms / 1000 for f in case.frames if f.get_type() == SETPOINT]
        assert not [time_s for time_s in late if time_s > case.fault_s + 1.0]
        assert woken.custom_mode == RETURNING[personality]


def test_mission_killed(launch, short):
    with Launched("mission process killed", launch, short, slots=SLOTS) as case:
        case.until_slot(FROM_SLOT)
        case.fault_s = case.witness.last.time_s
        case.flight.process.kill()
        case.flight.process.wait()
        case.flight.await_end()
        log = case.judge_logs(0)
    assert not log.complete
    words = (case.flight.run / "logs" / "bridge.log").read_text()
    assert words.rstrip().endswith("ended: exit 0"), words


def test_disk_full(launch, short):
    """RLIMIT_FSIZE of 0 for every process but the autopilot: no write to any file succeeds any more (EFBIG)."""
    with Launched("disk full", launch, short, slots=SLOTS) as case:
        case.until_slot(FROM_SLOT)
        case.fault_s = case.witness.last.time_s
        for pid, command in case.flight.processes().items():
            if "sitl" not in command:
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
        log = case.judge()
    assert not log.complete
