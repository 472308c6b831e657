"""The failure matrix's rows of a node that is killed: agent, rf, bridge."""

import pytest

from tests.failure_matrix.launched import Launched, outcomes
from tests.failure_matrix.rows import BOTH

FROM_SLOT = 2
SLOTS = 40


@pytest.mark.parametrize("node", ["agent", "rf"])
def test_killed(launch, short, node):
    with Launched(f"{node} killed", launch, short, slots=SLOTS) as case:
        case.until_slot(FROM_SLOT)
        case.begin(node)
        log = case.judge()
    assert log.complete
    assert outcomes(log)[-1] in ("flown", "clipped")
    assert len(outcomes(log)) == SLOTS


@pytest.mark.parametrize("node", ["agent", "rf"])
def test_killed_for_good(launch, short, node):
    with Launched(f"{node} killed, not started again", launch, short, restart="never") as case:
        case.until_slot(FROM_SLOT)
        case.begin(node)
        log = case.judge()
    assert log.complete
    assert outcomes(log)[-1] == "missing"
    assert case.stood_still(log)


@pytest.mark.parametrize("personality", BOTH)
def test_bridge_killed(launch, short, personality):
    with Launched("bridge killed", launch, short, personality) as case:
        case.until_slot(FROM_SLOT)
        case.begin("bridge")
        case.judge()
    assert "bridge: killed by SIGKILL; the autopilot's failsafe brings the vehicle down" in case.flight.text
