"""The failure matrix's rows of an agent or rf node that is frozen, slow, or talks nonsense."""

import os
import queue
import signal

import pytest

from bus import topics
from tests.failure_matrix.launched import PACED, PATIENCE_S, Launched, outcomes

FROM_SLOT, TO_SLOT = 2, 6
SLOTS = 15


@pytest.mark.parametrize("node", ["agent", "rf"])
def test_frozen(launch, short, node):
    """It wakes on the way home, and nothing that it says then is flown."""
    with Launched(f"{node} frozen", launch, short, **PACED) as case:
        case.until_slot(FROM_SLOT)
        case.begin(node, signal.SIGSTOP)
        case.until_returning()
        case.flight.signal(node, signal.SIGCONT)
        log = case.judge()
    assert outcomes(log)[-1] == "missing"
    assert case.stood_still(log)


@pytest.mark.parametrize("node", ["agent", "rf"])
def test_slow(launch, short, node):
    """It gets the processor only when half of the slot is over."""
    said = {"agent": topics.ACTION, "rf": topics.CSI}[node]
    with Launched(f"{node} slow", launch, short, slots=SLOTS, **PACED) as case:
        pid, answers = case.flight.node(node)[0], queue.SimpleQueue()
        keep = case.listen(said, answers)
        case.until_slot(FROM_SLOT)
        case.begin(node, signal.SIGSTOP)
        for _ in range(TO_SLOT - FROM_SLOT):
            opened = case.until_slot(FROM_SLOT)
            case.until_time(opened.time_s + 0.5)
            os.kill(pid, signal.SIGCONT)
            while answers.get(timeout=PATIENCE_S).slot < opened.slot:
                pass
            os.kill(pid, signal.SIGSTOP)
        os.kill(pid, signal.SIGCONT)
        keep.undeclare()
        log = case.judge()
    assert "late" in outcomes(log)[FROM_SLOT:]


def test_rf_sending_malformed(launch, short):
    nonsense = [b"", b"\xff\x00", b'{"slot": 3}']
    with Launched("rf sending malformed", launch, short, slots=SLOTS, **PACED) as case:
        good = queue.SimpleQueue()
        keep = case.listen(topics.CSI, good)
        case.until_slot(FROM_SLOT)
        case.begin("rf", signal.SIGSTOP)
        state = topics.encode(good.get(timeout=PATIENCE_S))
        nonsense += [state.replace(b"[[", b"[[[0.0],", 1), state.replace(b"e-", b"e999,", 1), state[:-10]]
        for _ in range(TO_SLOT - FROM_SLOT):
            case.until_slot(FROM_SLOT)
            for payload in nonsense:
                case.session.put(topics.key("star1", topics.CSI.name), payload)
        case.flight.signal("rf", signal.SIGCONT)
        keep.undeclare()
        log = case.judge()
    agent = [health for health in log.messages(topics.HEALTH) if health.node == "agent"][-1]
    assert agent.counters["refused rf/csi"] >= len(nonsense)
