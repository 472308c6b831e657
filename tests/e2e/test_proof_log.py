"""The log of a real flight proves every setpoint: what it says on the bus is what went over the wire."""

import numpy as np
import pytest
from pymavlink import mavutil

from airframe.frames import enu_to_ned, yaw_enu_to_ned
from bus import topics

LOW = {"preset": "physical_small", "box_enu": [[-100, 100], [-100, 100], [10, 120]], "start_enu": [0, 0, 15]}


@pytest.fixture(scope="module")
def flight(launch):
    flown = launch({"scenario": LOW, "slots": 6, "policy": {"kind": "random"}, "at_end": "land"})
    assert flown.wait() == 0, flown.text
    return flown


def on_the_wire(path):
    log = mavutil.mavlink_connection(str(path), robust_parsing=False)
    return list(iter(lambda: log.recv_match(type="SET_POSITION_TARGET_LOCAL_NED"), None))


def test_every_setpoint_on_the_wire_is_in_the_log_bit_for_bit_and_no_other(flight):
    told = flight.log.messages(topics.SETPOINT)
    sent = on_the_wire(flight.run / "flight.tlog")
    assert len(told) == len(sent) > 6 * 20
    for setpoint, wire in zip(told, sent, strict=True):
        velocity_ned = np.float32(enu_to_ned(*setpoint.velocity_enu))
        assert (wire.vx, wire.vy, wire.vz) == tuple(velocity_ned.tolist())
        assert wire.yaw == np.float32(yaw_enu_to_ned(setpoint.yaw_rad)).item()
        assert wire.time_boot_ms == round(setpoint.time_s * 1000)


def test_the_report_finds_that_they_hold_together(flight):
    told = flight.log.messages(topics.SETPOINT)
    found = flight.report["setpoints"]
    assert found["contradictions"] == []
    assert found["number"] == len(told)
    assert found["by_source"]["transit"] > 0
    assert found["by_source"]["random"] == sum(setpoint.action_slot is not None for setpoint in told) >= 6 * 20
    assert found["longest_interval_s"] == pytest.approx(0.05)
    assert found["max_action_age_s"] <= 1.0
    assert found["max_state_age_s"] <= 0.1


def test_the_report_evaluates_the_flight_in_its_own_world(flight):
    flyability = flight.report["flyability"]
    assert flyability["difference"] == ""
    links, opened = flight.log.by_slot(topics.LINK), flight.log.by_slot(topics.SLOT)
    assert [row["slot"] for row in flyability["by_slot"]] == sorted(links)
    for row in flyability["by_slot"]:
        link = links[row["slot"]]
        assert row["as_set"]["rate_bps"]["flown"] == pytest.approx(link.sum_rate_bps)
        assert row["as_set"]["reward"]["flown"] == pytest.approx(link.reward)
        assert row["energy_j"]["flown"] == pytest.approx(link.energy_j)
        flown = opened[row["slot"] + 1].flown
        track, plan = (np.array([sample.position_enu for sample in samples]) for samples in (flown.track, flown.plan))
        assert row["tracking_rms_m"] == pytest.approx(np.sqrt(np.mean(np.sum((track - plan) ** 2, axis=1))))
        assert row["limits_m"] == pytest.approx(np.linalg.norm(np.subtract(flown.commanded_enu, flown.planned_enu)))
    assert "flyability: 6 slots" in flight.text
