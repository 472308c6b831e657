"""The failure matrix's row of a bridge that is frozen for good."""

import signal

import pytest

from tests.failure_matrix.launched import PACED, Launched
from tests.failure_matrix.rows import BOTH

FROM_SLOT = 2


@pytest.mark.parametrize("personality", BOTH)
def test_bridge_frozen(launch, short, personality):
    with Launched("bridge frozen", launch, short, personality, **PACED) as case:
        case.until_slot(FROM_SLOT)
        case.begin("bridge", signal.SIGSTOP)
        case.judge()
