"""The failure matrix's rows of a dead link: a UDP relay that passes nothing for a while."""

import time

import pytest

from tests.failure_matrix.relayed import SPEED, relayed_case
from tests.failure_matrix.rows import BOTH

ALLOWED_S = 1.5
"""Vehicle time from the fault to our last setpoint."""


@pytest.mark.parametrize("personality", BOTH)
@pytest.mark.parametrize("dead_s", [3, 10, 60])
def test_link_dead(fly, bridge_config, tmp_path, dead_s, personality):
    with relayed_case(f"link dead {dead_s} s", personality, fly, bridge_config, tmp_path) as (case, relay):
        relay.cut, cut_at = True, time.monotonic()
        fault_s = case.witness.last.time_s
        case.witness.until(lambda sight: sight.time_s > fault_s + dead_s, f"{dead_s} s of a dead link")
        in_the_dark = [at for at in relay.setpoints if at > cut_at + ALLOWED_S / SPEED]
        relay.cut = False
        case.judge(fault_s)
        assert not in_the_dark
