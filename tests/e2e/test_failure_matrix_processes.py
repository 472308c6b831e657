"""The failure matrix's rows of a killed mission process and of a full disk."""

import resource

from tests.failure_matrix.launched import PACED, Launched

FROM_SLOT = 2
SLOTS = 15


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
    with Launched("disk full", launch, short, slots=SLOTS, **PACED) as case:
        case.until_slot(FROM_SLOT)
        case.fault_s = case.witness.last.time_s
        for pid, command in case.flight.processes().items():
            if "sitl" not in command:
                resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
        log = case.judge()
    assert not log.complete
