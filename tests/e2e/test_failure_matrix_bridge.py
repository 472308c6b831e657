"""The failure matrix's rows of a bridge that is frozen for a while."""

import signal

import pytest

from tests.failure_matrix.case import SETPOINT
from tests.failure_matrix.launched import PACED, RETURNING, Launched
from tests.failure_matrix.rows import BOTH

FROM_SLOT = 2
FROZEN_S = 10.0


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
