"""The failure matrix's rows of a dead link: a UDP relay that passes nothing for a while."""

import time

import pytest

from autopilot_bridge.deadman import SILENCE_WALL_S
from tests.failure_matrix.relayed import ALLOWED_S, SPEED, relayed_case
from tests.failure_matrix.rows import BOTH


@pytest.mark.parametrize(
    ("fault", "personality", "dead_s", "slots"),
    [
        ("link dead 3 s", "px4", 3, 1000),
        ("link dead 3 s, GUIDED", "arducopter", 3, 15),
        *(("link dead 10 s", personality, 10, 1000) for personality in BOTH),
        *(("link dead 60 s", personality, 60, 1000) for personality in BOTH),
    ],
)
def test_link_dead(fly, bridge_config, tmp_path, fault, personality, dead_s, slots):
    with relayed_case(fault, personality, fly, bridge_config, tmp_path, slots) as (case, relay):
        relay.cut, cut_at = True, time.monotonic()
        fault_s = case.witness.last.time_s
        paced_s = min(dead_s, SILENCE_WALL_S * SPEED + 3.0)
        case.witness.until(lambda sight: sight.time_s > fault_s + paced_s, f"{paced_s:g} s of a dead link")
        in_the_dark = relay.setpoints_since(cut_at + ALLOWED_S / SPEED)
        case.let_pass(fault_s + dead_s)
        relay.cut = False
        case.judge(fault_s)
        assert in_the_dark == 0
