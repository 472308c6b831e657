"""A bridge that is killed is followed by the autopilot's own failsafe; a thread that was stalled sends nothing it had
in hand."""

import signal

import pytest
from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge import helm
from tests.autopilot_bridge.bridge_process import PATIENT, RTL, SPEED, Bridge, Station
from tests.autopilot_bridge.on_the_wire import OFFBOARD, asked, heard_mode, of_vehicle, read_log


@pytest.fixture(params=["px4", "arducopter"])
def bridge(request, sitl, bridge_config, tmp_path):
    bridge = Bridge(request.param, sitl, bridge_config, tmp_path)
    yield bridge
    bridge.close()


def test_a_bridge_that_is_killed_is_followed_by_the_failsafe(bridge):
    bridge.signal(signal.SIGKILL)
    bridge.wait()
    bridge.station.until_mode(RTL[bridge.personality])
    bridge.station.until(lambda: not bridge.station.armed, "the ground")


def test_a_stall_right_before_the_wire_costs_the_setpoint(sitl, fly, bridge_config, tmp_path, monkeypatch):
    """The thread that flies is blocked between what it knows and what it sends, until PX4's failsafe acts."""
    autopilot = sitl("--speed", str(SPEED))
    station = Station(autopilot.gcs)
    stalled = []

    def slow(*arguments):
        if flight.slots and flight.slots[-1].slot >= 1 and not stalled:
            stalled.append(len(read_log(tmp_path / "flight.tlog")))
            station.until_mode(RTL["px4"])
        return track(*arguments)

    track = helm.track
    monkeypatch.setattr(helm, "track", slow)
    config = bridge_config(
        autopilot, clock={"kind": "paced", "speed": SPEED}, slots=1000, parameters=PATIENT["px4"], autostart=False
    )
    flight = fly(config, tlog=tmp_path / "flight.tlog")
    flight.until_phase("ready")
    flight.command("start")
    assert flight.wait() == 3
    station.socket.close()
    assert "AUTO.RTL was chosen" in flight.told("mode")[0]
    log = read_log(tmp_path / "flight.tlog")
    assert asked(log[stalled[0] :]) == []
    flying = [m for i, m in of_vehicle(log, "HEARTBEAT") if i > heard_mode(log, RTL["px4"]) and m.base_mode & 128]
    assert OFFBOARD[mavlink.MAV_AUTOPILOT_PX4] not in {m.custom_mode for m in flying}
