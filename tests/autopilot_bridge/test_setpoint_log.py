"""Every setpoint on the wire is told on the bus: what it was, what it came from, how old that was."""

import math

import pytest
from pymavlink import mavutil

from bus import messages as m
from bus import topics


def on_the_wire(tlog):
    log = mavutil.mavlink_connection(str(tlog), robust_parsing=False)
    return list(iter(lambda: log.recv_match(type="SET_POSITION_TARGET_LOCAL_NED"), None))


def test_every_setpoint_is_told_with_its_source_age_and_clips(sitl, fly, bridge_config, tmp_path):
    told = []
    config = bridge_config(sitl("--lockstep"), slots=3)
    flight = fly(
        config, lambda opened: {0: (2.0, 0.0, 0.0), 1: None, 2: (0.0, 3.0, 0.0)}[opened.slot], tmp_path / "f.tlog"
    )
    topics.subscribe(flight.ground, "test", topics.SETPOINT, told.append, topics.Counter())
    assert flight.wait() == 0
    sent = on_the_wire(tmp_path / "f.tlog")
    flight.until(lambda: len(told) >= len(sent), "the setpoints on the bus")
    assert len(told) == len(sent) > 100
    for setpoint, wire in zip(told, sent, strict=True):
        assert (wire.vy, wire.vx, -wire.vz) == pytest.approx(setpoint.velocity_enu, abs=1e-5)
        assert wire.time_boot_ms == round(setpoint.time_s * 1000)
        assert setpoint.state_age_s <= 0.1
        assert bool(setpoint.reasons) == (setpoint.velocity_enu != setpoint.wanted_enu)
    opened = {slot.slot: slot.time_s for slot in flight.slots}
    assert {setpoint.source for setpoint in told if setpoint.time_s < opened[0]} == {"hold", "transit"}
    for setpoint in told:
        if setpoint.slot == 0:
            assert (setpoint.source, setpoint.action_slot) == ("test", 0)
            assert setpoint.action_age_s == pytest.approx(setpoint.time_s - opened[0])
        if setpoint.slot == 1:
            assert (setpoint.source, setpoint.action_slot, setpoint.action_age_s) == ("hold", None, None)
        if setpoint.slot == 2:
            assert (setpoint.source, setpoint.action_slot) == ("test", 2)


def test_a_setpoint_that_was_not_finite_can_be_told():
    message = m.Setpoint(
        time_s=1.0,
        slot=None,
        source="hold",
        action_slot=None,
        action_age_s=None,
        state_age_s=0.0,
        wanted_enu=None,
        velocity_enu=(0.0, 0.0, 0.0),
        yaw_rad=0.0,
        reasons=["not finite"],
    )
    assert topics.decode(topics.encode(message), m.Setpoint) == message
    nan = message.__class__(
        **{name: getattr(message, name) for name in message.__struct_fields__} | {"yaw_rad": math.nan}
    )
    with pytest.raises(topics.RefusedError):
        topics.decode(topics.encode(nan), m.Setpoint)
