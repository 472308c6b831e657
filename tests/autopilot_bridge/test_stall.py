"""A bridge that was frozen sends nothing on waking before it knows anew who flies: real processes, real signals, both
autopilots."""

import signal
import time

import pytest

from tests.autopilot_bridge.bridge_process import RTL, Bridge
from tests.autopilot_bridge.on_the_wire import OURS, asked, heard_mode, of_vehicle, read_log, setpoints


@pytest.fixture(params=["px4", "arducopter"])
def bridge(request, sitl, bridge_config, tmp_path):
    bridge = Bridge(request.param, sitl, bridge_config, tmp_path)
    yield bridge
    bridge.close()


def test_a_bridge_frozen_until_the_failsafe_obeys_it(bridge):
    """By then its socket's buffer is full of HEARTBEATs from before, and the kernel has dropped the newer ones."""
    frozen = bridge.freeze()
    bridge.station.until_mode(RTL[bridge.personality])
    time.sleep(0.5)
    bridge.signal(signal.SIGCONT)
    assert bridge.wait() == 3
    (stall, *_), (mode, *_) = bridge.told("stall"), bridge.told("mode")
    assert "without listening: nothing is sent before the mode is known anew" in stall
    assert "RTL was chosen by autopilot or pilot: obeyed" in mode
    assert bridge.told("phase")[-1] == "yielded"
    log = read_log(bridge.tlog)
    assert len(asked(log[frozen:])) <= 1, "one may have been on its way into the socket"
    home = heard_mode(log, RTL[bridge.personality])
    assert asked(log[home:]) == []
    flying = [m for i, m in of_vehicle(log, "HEARTBEAT") if i > home and m.base_mode & 128]
    assert {m.custom_mode for m in flying} == {RTL[bridge.personality]}


def test_a_bridge_frozen_for_a_moment_asks_who_flies_and_goes_on(bridge):
    frozen = bridge.freeze()
    time.sleep(0.2)  # 2 s of vehicle time, so no failsafe
    bridge.signal(signal.SIGCONT)
    time.sleep(1.0)
    bridge.signal(signal.SIGINT)
    assert bridge.wait() == 3
    assert bridge.told("mode") == []
    assert bridge.told("phase")[-1] == "landing"
    log = read_log(bridge.tlog)[frozen:]
    asked_at = next(i for i, m in enumerate(log) if m.get_type() == "TIMESYNC" and m.get_srcSystem() == OURS)
    questions = {m.ts1 for m in log if m.get_type() == "TIMESYNC" and m.get_srcSystem() == OURS}
    answered_at = next(i for i, m in of_vehicle(log, "TIMESYNC") if m.tc1 and m.ts1 in questions)
    told_at = next(i for i, _ in of_vehicle(log, "HEARTBEAT") if i > answered_at)
    assert asked_at < answered_at < told_at
    assert len(asked(log[:told_at])) <= 1, "one may have been on its way into the socket"
    assert len(setpoints(log[told_at:])) > 10
