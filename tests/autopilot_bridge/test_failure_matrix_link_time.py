"""The failure matrix's rows of a link that is late, or of an autopilot whose time is not what it was."""

import time

import pytest

from tests.failure_matrix.relayed import ALLOWED_S, SPEED, relayed_case
from tests.failure_matrix.rows import BOTH


def test_delay(fly, bridge_config, tmp_path):
    with relayed_case("MAVLink delay 500 ms", "px4", fly, bridge_config, tmp_path, slots=12) as (case, relay):
        fault_s = case.witness.last.time_s
        relay.delay_s = 0.5 / SPEED
        case.judge(fault_s)
        assert len(case.flight.flown) == 12


@pytest.mark.parametrize("personality", BOTH)
def test_mavlink_restarts(fly, bridge_config, tmp_path, personality):
    fault = "autopilot's MAVLink side restarted in flight"
    with relayed_case(fault, personality, fly, bridge_config, tmp_path) as (case, relay):
        fault_s = case.witness.last.time_s
        relay.restart_mavlink()
        told_at = time.monotonic() + ALLOWED_S / SPEED
        case.judge(fault_s)
        assert relay.setpoints_since(told_at) == 0


def test_clock_jumps_back(fly, bridge_config, tmp_path):
    with relayed_case("clock jumps 5 s back", "px4", fly, bridge_config, tmp_path) as (case, relay):
        fault_s = case.witness.last.time_s
        relay.jump(-5.0)
        told_at = time.monotonic() + ALLOWED_S / SPEED
        case.judge(fault_s)
        assert relay.setpoints_since(told_at) == 0


def test_clock_jumps_ahead(fly, bridge_config, tmp_path):
    with relayed_case("clock jumps 5 s ahead", "px4", fly, bridge_config, tmp_path, slots=20) as (
        case,
        relay,
    ):
        fault_s = case.witness.last.time_s
        relay.jump(5.0)
        case.judge(fault_s)
        assert [slot.slot for slot in case.flight.flown] == list(range(20)), "every slot is told of"
        assert case.flight.flown[-1].outcome in ("flown", "clipped")
