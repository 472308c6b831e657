"""What nobody thought of ends no flight in the air, a vehicle that somebody else flies is not ours to start, and `hold`
means now."""

import io
import itertools
import sys
from types import SimpleNamespace

from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge import node, preflight, slots
from autopilot_bridge.clock import Lockstep
from autopilot_bridge.ground import Ground
from autopilot_bridge.node import run
from bus.session import open_session
from tests.autopilot_bridge.on_the_wire import OURS, asked, heard_mode, read_log


def test_a_vehicle_that_somebody_else_has_armed_meanwhile_is_not_started(sitl, fly, bridge_config, tmp_path):
    """In PX4 his hold is the mode in which we take off: only that it is armed tells."""
    autopilot, speed = sitl("--speed", "10"), 10
    config = bridge_config(autopilot, autostart=False).model_copy(
        update={"clock": bridge_config(autopilot, clock={"kind": "paced", "speed": speed}).clock}
    )
    flight = fly(config, tlog=tmp_path / "flight.tlog")
    flight.until_phase("ready")
    autopilot.pilot(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    flight.until(lambda: flight.states[-1].armed, "somebody's arming")
    autopilot.pilot(mavlink.MAV_CMD_NAV_TAKEOFF, *[float("nan")] * 7)
    flight.until(lambda: flight.states[-1].position_enu[2] > 1.0, "his takeoff")
    reply = flight.command("start")
    assert not reply.accepted
    assert "armed" in reply.reason
    autopilot.pilot(mavlink.MAV_CMD_NAV_LAND, *[float("nan")] * 7)
    flight.until(lambda: not flight.states[-1].armed, "his landing")
    assert flight.command("land").accepted
    assert flight.wait() == 3
    assert asked(read_log(tmp_path / "flight.tlog")) == []


def test_a_mistake_of_ours_in_the_air_brings_it_home_and_is_told(sitl, fly, bridge_config, monkeypatch, capfd):
    def plan_slot(*_):
        raise KeyError("nobody thought of this")

    flight = fly(bridge_config(sitl("--lockstep"), slots=20, start_position_enu=(20.0, 0.0, 12.0)))
    flight.until_slot(2)
    monkeypatch.setattr(slots, "plan_slot", plan_slot)
    assert flight.wait() == 1
    assert flight.told("error") == ["KeyError in the bridge: 'nobody thought of this'"]
    assert flight.phases[-1] == "returning"
    assert max(map(abs, flight.states[-1].position_enu[:2])) < 2.0
    assert not flight.states[-1].armed
    assert flight.events[-1].exit_code == 1
    assert "plan_slot" in capfd.readouterr().err


def test_a_mistake_of_ours_while_a_pilot_flies_is_not_his_to_pay_for(sitl, fly, bridge_config, monkeypatch, tmp_path):
    def sample(*_):
        raise KeyError("nobody thought of this")

    autopilot = sitl("--lockstep")
    flight = fly(bridge_config(autopilot, slots=2000), tlog=tmp_path / "flight.tlog")
    flight.until_slot(2)
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 3)
    flight.until_phase("yielded")
    monkeypatch.setattr(slots.Slots, "sample", sample)
    flight.until(lambda: flight.told("error"), "the mistake")
    made_s = flight.states[-1].time_s
    flight.until(lambda: flight.states[-1].time_s > made_s + 3.0, "what comes of it")
    assert flight.states[-1].mode == "AUTO.LOITER"
    autopilot.pilot(mavlink.MAV_CMD_DO_SET_MODE, 1, 4, 6)
    assert flight.wait() == 1
    log = read_log(tmp_path / "flight.tlog")
    taken = heard_mode(log, 6 << 16)
    taken += heard_mode(log[taken:], 4 << 16 | 3 << 24)
    assert asked(log[taken:]) == []


def test_a_mistake_of_ours_on_the_ground_ends_it_with_a_word(sitl, fly, bridge_config, monkeypatch):
    def clear(*_):
        raise KeyError("nobody thought of this")

    monkeypatch.setattr(preflight, "clear", clear)
    flight = fly(bridge_config(sitl("--lockstep")))
    assert flight.wait() == 1
    assert flight.told("error") == ["KeyError in the bridge: 'nobody thought of this'"]
    assert flight.events[-1].exit_code == 1


def test_letters_that_our_output_has_not_end_no_flight(monkeypatch):
    """An autopilot's STATUSTEXT may hold anything."""
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    with open_session() as session:
        ground = Ground(session, "test")
        ground.tell("statustext", "caf\u00e9")
        assert ground.counters["print_failed"] == 1
        ground.bell.close()


def test_a_hold_by_command_is_at_once_and_not_after_the_slot(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep"), slot_s=60.0), lambda opened: (30.0, 0.0, 0.0))
    flight.until_slot(0)
    flight.until(lambda: flight.states[-1].time_s > flight.slots[0].time_s + 2.0, "its way")
    assert flight.command("hold").accepted
    flight.until_phase("holding")
    told = {event.text: event.time_s for event in flight.events if event.kind in ("command", "phase")}
    assert told["holding"] - told["hold"] < 0.2
    flight.until(lambda: flight.states[-1].time_s > told["hold"] + 8.0, "it stands")
    assert flight.slots[-1].slot == 0
    assert max(map(abs, flight.states[-1].velocity_enu)) < 0.3
    assert flight.command("land").accepted
    assert flight.wait() == 3


def test_a_bridge_that_is_slow_beats_once_a_second_all_the_same(sitl, fly, bridge_config, monkeypatch, tmp_path):
    """ArduCopter takes a ground station for lost after 5 s; steps that take four times as long must not do that."""
    monkeypatch.setattr(node, "_clock", lambda config: Lockstep(config.clock.control, 4 * config.tick_ms))
    assert fly(bridge_config(sitl("--lockstep")), tlog=tmp_path / "flight.tlog").wait() == 0
    beats = [
        message._timestamp
        for message in read_log(tmp_path / "flight.tlog")
        if message.get_type() == "HEARTBEAT" and message.get_srcSystem() == OURS
    ]
    gaps = [after - before for before, after in itertools.pairwise(beats)]
    assert max(gaps) < 1.3


def test_a_vehicle_is_not_its_own_neighbour(bridge_config, capsys):
    config = bridge_config(SimpleNamespace(port=14540, control=None), separation_m=5.0)
    with open_session() as session:
        assert run(config, "test", session, None, others=["other", "test"]) == 1
    assert "error: others: 'test' is this vehicle itself" in capsys.readouterr().out
