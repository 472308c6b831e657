"""PX4's failsafes: the decision as a table, then flown, over real UDP."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from sitl.injection import inject
from sitl.parameters import Parameters
from sitl.px4.failsafes import Action, Conditions, Failsafe, follow
from sitl.px4.modes import Mode
from sitl.px4.parameters import TABLE
from tests.sitl.client import NAN, direct

POSCTL, ALTCTL, STABILIZED, LOITER, RETURN, LANDING, OFFBOARD = (3, 0), (2, 0), (7, 0), (4, 3), (4, 5), (4, 6), (6, 0)
ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED = range(4)
ACTIVE, CRITICAL = 4, 5
TICK_S = 0.01


# The decision


def parameters(**values: float) -> Parameters:
    p = Parameters(TABLE)
    for name, value in values.items():
        p.set(name, value)
    return p


def decided(
    c: Conditions, intended: Mode = Mode.LOITER, seconds: float = 0.0, before=None, **values: float
) -> Failsafe:
    """What is done after conditions have held for so long."""
    p = parameters(**values)
    failsafe = follow(before or Failsafe(), c, intended, p, TICK_S, False, False)
    for _ in range(round(seconds / TICK_S)):
        failsafe = follow(failsafe, c, intended, p, TICK_S, False, False)
    return failsafe


LOST = Conditions(stream_lost=True)
BLIND = Conditions(position_lost=True)


@pytest.mark.parametrize(
    ("conditions", "intended", "values", "at_once", "later"),
    [
        (Conditions(), Mode.MISSION, {}, Mode.MISSION, Mode.MISSION),
        # AUTOPILOT.md 2: COM_OBL_RC_ACT: 0 POSCTL; 4 land, 3 return
        (LOST, Mode.OFFBOARD, {}, Mode.POSCTL, Mode.POSCTL),
        (LOST, Mode.OFFBOARD, {"COM_OBL_RC_ACT": 1}, Mode.ALTCTL, Mode.ALTCTL),
        (LOST, Mode.OFFBOARD, {"COM_OBL_RC_ACT": 2}, Mode.STABILIZED, Mode.STABILIZED),
        (LOST, Mode.OFFBOARD, {"COM_OBL_RC_ACT": 3}, Mode.RTL, Mode.RTL),
        (LOST, Mode.OFFBOARD, {"COM_OBL_RC_ACT": 4}, Mode.LAND, Mode.LAND),
        (LOST, Mode.OFFBOARD, {"COM_OBL_RC_ACT": 5}, Mode.LOITER, Mode.LOITER),
        (LOST, Mode.LOITER, {}, Mode.LOITER, Mode.LOITER),
        # AUTOPILOT.md 2: GF_ACTION 2 = hold on breach; COM_FAIL_ACT_T 5 s hold before an action
        (Conditions(breached=True), Mode.OFFBOARD, {}, Mode.LOITER, Mode.LOITER),
        (Conditions(breached=True), Mode.OFFBOARD, {"GF_ACTION": 0}, Mode.OFFBOARD, Mode.OFFBOARD),
        (Conditions(breached=True), Mode.OFFBOARD, {"GF_ACTION": 1}, Mode.OFFBOARD, Mode.OFFBOARD),
        (Conditions(breached=True), Mode.OFFBOARD, {"GF_ACTION": 3}, Mode.LOITER, Mode.RTL),
        (Conditions(breached=True), Mode.OFFBOARD, {"GF_ACTION": 5}, Mode.LOITER, Mode.LAND),
        (Conditions(breached=True), Mode.OFFBOARD, {"GF_ACTION": 3, "COM_FAIL_ACT_T": 0}, Mode.RTL, Mode.RTL),
        # AUTOPILOT.md 2: COM_LOW_BAT_ACT; NAV_DLL_ACT = 0
        (Conditions(battery=1), Mode.MISSION, {"COM_LOW_BAT_ACT": 3}, Mode.MISSION, Mode.MISSION),
        (Conditions(battery=2), Mode.MISSION, {"COM_LOW_BAT_ACT": 0}, Mode.MISSION, Mode.MISSION),
        (Conditions(battery=2), Mode.MISSION, {"COM_LOW_BAT_ACT": 2}, Mode.LOITER, Mode.LAND),
        (Conditions(battery=2), Mode.MISSION, {"COM_LOW_BAT_ACT": 3}, Mode.LOITER, Mode.RTL),
        (Conditions(battery=3), Mode.MISSION, {"COM_LOW_BAT_ACT": 3}, Mode.LOITER, Mode.LAND),
        (Conditions(battery=2, battery_at_arming=2), Mode.MISSION, {"COM_LOW_BAT_ACT": 3}, Mode.MISSION, Mode.MISSION),
        (Conditions(ground_lost=True), Mode.MISSION, {}, Mode.MISSION, Mode.MISSION),
        (Conditions(ground_lost=True), Mode.MISSION, {"NAV_DLL_ACT": 1}, Mode.LOITER, Mode.LOITER),
        (Conditions(ground_lost=True), Mode.MISSION, {"NAV_DLL_ACT": 2}, Mode.LOITER, Mode.RTL),
        (Conditions(ground_lost=True), Mode.MISSION, {"NAV_DLL_ACT": 3}, Mode.LOITER, Mode.LAND),
        (Conditions(ground_lost=True), Mode.LAND, {"NAV_DLL_ACT": 2}, Mode.LAND, Mode.LAND),
        (Conditions(sticks_lost=True), Mode.POSCTL, {}, Mode.LOITER, Mode.RTL),
        (Conditions(sticks_lost=True), Mode.OFFBOARD, {"NAV_RCL_ACT": 3}, Mode.LOITER, Mode.LAND),
        (Conditions(sticks_lost=True), Mode.OFFBOARD, {"COM_RCL_EXCEPT": 4}, Mode.OFFBOARD, Mode.OFFBOARD),
        (Conditions(sticks_lost=True), Mode.MISSION, {"COM_RCL_EXCEPT": 1}, Mode.MISSION, Mode.MISSION),
        (Conditions(sticks_lost=True), Mode.LOITER, {"COM_RCL_EXCEPT": 5}, Mode.LOITER, Mode.RTL),
        # without a position
        (BLIND, Mode.OFFBOARD, {}, Mode.DESCEND, Mode.DESCEND),
        (BLIND, Mode.RTL, {}, Mode.DESCEND, Mode.DESCEND),
        (BLIND, Mode.POSCTL, {}, Mode.ALTCTL, Mode.ALTCTL),
        (BLIND, Mode.POSCTL, {"COM_POSCTL_NAVL": 1}, Mode.DESCEND, Mode.DESCEND),
        (BLIND._replace(attitude_only=True), Mode.OFFBOARD, {}, Mode.OFFBOARD, Mode.OFFBOARD),
        (BLIND._replace(battery=2), Mode.STABILIZED, {"COM_LOW_BAT_ACT": 3}, Mode.DESCEND, Mode.DESCEND),
        # other
        (Conditions(windy=True), Mode.LOITER, {"COM_WIND_MAX_ACT": 3}, Mode.LOITER, Mode.RTL),
        (Conditions(windy=True), Mode.MISSION, {}, Mode.MISSION, Mode.MISSION),
        (Conditions(overdue=True), Mode.MISSION, {}, Mode.LOITER, Mode.RTL),
        (Conditions(motor_failed=True), Mode.MISSION, {}, Mode.MISSION, Mode.MISSION),
        (Conditions(motor_failed=True), Mode.MISSION, {"COM_ACT_FAIL_ACT": 2}, Mode.LOITER, Mode.LAND),
        (Conditions(battery=2), Mode.LAND, {"COM_LOW_BAT_ACT": 3}, Mode.LAND, Mode.LAND),
    ],
)
def test_what_is_flown(conditions, intended, values, at_once, later):
    assert decided(conditions, intended, **values).mode(intended) is at_once
    assert decided(conditions, intended, 4.9, **values).mode(intended) is at_once
    assert decided(conditions, intended, 5.2, **values).mode(intended) is later


@pytest.mark.parametrize(
    ("conditions", "values", "action"),
    [
        (Conditions(overturned=True, just_armed=True), {}, Action.DISARM),
        (Conditions(overturned=True), {}, Action.WARN),
        (Conditions(overturned=True), {"CBRK_FLIGHTTERM": 0}, Action.TERMINATE),
        (Conditions(breached=True), {"GF_ACTION": 4}, Action.TERMINATE),
        (Conditions(motor_failed=True), {"COM_ACT_FAIL_ACT": 4}, Action.TERMINATE),
        (Conditions(ground_lost=True), {"NAV_DLL_ACT": 6}, Action.DISARM),
        (Conditions(sticks_lost=True), {"NAV_RCL_ACT": 5}, Action.TERMINATE),
    ],
)
def test_ends_of_a_flight_do_not_wait(conditions, values, action):
    assert decided(conditions, **values).action is action


def test_the_most_severe_action_wins_and_a_worse_one_does_not_wait_again():
    p = {"COM_LOW_BAT_ACT": 3, "NAV_DLL_ACT": 1}
    both = Conditions(ground_lost=True, battery=2)
    returning = decided(both, Mode.MISSION, 6.0, **p)
    assert returning.action is Action.RETURN
    assert returning.cause == "battery 2"
    assert decided(both._replace(battery=3), Mode.MISSION, before=returning, **p).action is Action.LAND


def test_what_lasts_and_what_ends_with_its_cause():
    """A lost link's action lasts until the mode is changed; a mode that can be flown again is flown again."""
    p = parameters(NAV_DLL_ACT=2)
    returning = decided(Conditions(ground_lost=True), Mode.MISSION, 6.0, NAV_DLL_ACT=2)
    regained = follow(returning, Conditions(), Mode.MISSION, p, TICK_S, False, False)
    assert regained.action is Action.RETURN
    chosen = follow(regained, Conditions(), Mode.LOITER, p, TICK_S, True, False)
    assert chosen.mode(Mode.LOITER) is Mode.LOITER
    assert chosen.action is Action.NONE
    descending = decided(BLIND, Mode.OFFBOARD)
    assert follow(descending, Conditions(), Mode.OFFBOARD, p, TICK_S, False, False).action is Action.NONE


def test_pilots_take_over_by_a_mode_in_the_hold_and_by_sticks_after_it():
    c, p = Conditions(battery=2), parameters(COM_LOW_BAT_ACT=3)
    holding = decided(c, Mode.MISSION, 2.0, COM_LOW_BAT_ACT=3)
    assert follow(holding, c, Mode.MISSION, p, TICK_S, False, True).action is Action.HOLD
    by_mode = follow(holding, c, Mode.OFFBOARD, p, TICK_S, True, False)
    assert (by_mode.mode(Mode.OFFBOARD), by_mode.taken_over) == (Mode.OFFBOARD, True)
    assert decided(c, Mode.OFFBOARD, 60.0, by_mode, COM_LOW_BAT_ACT=3).mode(Mode.OFFBOARD) is Mode.OFFBOARD
    worse = decided(c._replace(battery=3), Mode.OFFBOARD, 6.0, by_mode, COM_LOW_BAT_ACT=3)
    assert worse.action is Action.LAND
    returning = decided(c, Mode.MISSION, 6.0, COM_LOW_BAT_ACT=3)
    by_sticks = follow(returning, c, Mode.MISSION, p, TICK_S, False, True)
    assert by_sticks.by_sticks
    assert by_sticks.mode(Mode.POSCTL) is Mode.POSCTL


def test_termination_is_for_good():
    ended = decided(Conditions(breached=True), GF_ACTION=4)
    assert follow(ended, Conditions(), Mode.LOITER, parameters(), TICK_S, True, True).action is Action.TERMINATE


def test_a_cause_that_comes_and_goes_is_acted_on_in_the_end():
    """The hold is used up four times as fast as it is filled again."""
    p, failsafe = parameters(COM_LOW_BAT_ACT=3), Failsafe()
    actions = []
    for i in range(1200):
        c = Conditions(battery=2 * (i // 50 % 2))
        failsafe = follow(failsafe, c, Mode.MISSION, p, TICK_S, False, False)
        actions.append(failsafe.action)
    assert Action.RETURN in actions
    assert actions.index(Action.RETURN) > 5.0 / TICK_S


modes = st.sampled_from([mode for mode in Mode if mode is not Mode.DESCEND])
booleans = st.booleans()
anything = st.builds(
    Conditions,
    stream_lost=booleans,
    sticks_lost=booleans,
    ground_lost=booleans,
    battery=st.integers(0, 3),
    battery_at_arming=st.integers(0, 3),
    breached=booleans,
    position_lost=booleans,
    overturned=booleans,
    motor_failed=booleans,
    windy=booleans,
    overdue=booleans,
    just_armed=booleans,
    attitude_only=booleans,
)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.tuples(anything, modes, booleans, booleans), max_size=30),
    st.integers(0, 7),
    st.integers(0, 5),
    st.sampled_from([0, 1, 2, 3, 5, 6]),
)
def test_any_history_flies_something_that_can_be_flown(history, obl, fence, dll):
    """Never a mode that needs a position without one, nor OFFBOARD without its stream."""
    p = parameters(COM_OBL_RC_ACT=obl, GF_ACTION=fence, NAV_DLL_ACT=dll, COM_LOW_BAT_ACT=3, COM_WIND_MAX_ACT=3)
    failsafe = Failsafe()
    for c, intended, switched, moved in history:
        failsafe = follow(failsafe, c, intended, p, 0.5, switched, moved)
        if failsafe.by_sticks:
            intended = Mode.POSCTL
        mode = failsafe.mode(intended)
        if failsafe.action >= Action.DISARM:
            continue
        if c.position_lost and not (mode is Mode.OFFBOARD and c.attitude_only):
            assert mode in (Mode.ALTCTL, Mode.STABILIZED, Mode.DESCEND)
        assert not (mode is Mode.OFFBOARD and c.stream_lost)
        assert 0.0 <= failsafe.delay_s <= 5.0
        assert replace(failsafe) == failsafe


# Flown


def hear(vehicle) -> None:
    """A ground station's heartbeat."""
    vehicle.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))


def until_text(vehicle, beginning: str, limit_s: float, each=None) -> int:
    """Vehicle time at which a STATUSTEXT that begins so has come [ms]."""
    vehicle.until(lambda: any(text.startswith(beginning) for text in vehicle.texts()), limit_s, each)
    return vehicle.time_ms


@pytest.mark.parametrize(("action", "mode"), [(1, LOITER), (2, RETURN), (3, LANDING)])
def test_ground_station_lost(action, mode):
    """AUTOPILOT.md 2: NAV_DLL_ACT, COM_DL_LOSS_T 10 s; COM_FAIL_ACT_T 5 s hold before an action."""
    with direct(NAV_DLL_ACT=action) as vehicle:
        vehicle.until(lambda: "HEARTBEAT" in vehicle.latest, 3)
        vehicle.fly(4, lambda: hear(vehicle))
        assert vehicle.command(400, 1) == ACCEPTED
        assert vehicle.command(22, 0, 0, 0, NAN, NAN, NAN, 499.4) == ACCEPTED
        vehicle.until(lambda: vehicle.landed == 2 and vehicle.mode == LOITER, 40, lambda: hear(vehicle))
        hear(vehicle)
        last = vehicle.time_ms
        vehicle.advance()
        lost = until_text(vehicle, "Connection to ground station lost", 11)
        assert lost - last == pytest.approx(10_000, abs=100)
        until_text(vehicle, "Failsafe activated", 0.2)
        vehicle.fly(1.2)
        assert vehicle.mode == LOITER
        assert vehicle.latest["HEARTBEAT"].system_status == CRITICAL
        if mode != LOITER:
            vehicle.until(lambda: vehicle.mode == mode, 6)
            assert vehicle.time_ms - lost == pytest.approx(5000, abs=1050)  # HEARTBEAT is sent once a second
        hear(vehicle)
        vehicle.fly(2)
        assert "GCS connection regained" in vehicle.texts()
        assert vehicle.mode == mode  # it lasts


def test_without_a_ground_station_no_arming_where_its_loss_has_an_action():
    with direct(NAV_DLL_ACT=2) as vehicle:
        vehicle.fly(6)
        assert vehicle.command(400, 1) == TEMPORARILY_REJECTED
        assert vehicle.texts()[-1] == "Arming denied: no connection to the ground control station"
        hear(vehicle)
        assert vehicle.command(400, 1) == ACCEPTED
        assert vehicle.command(400, 0) == ACCEPTED
        vehicle.fly(11)
        assert "Connection to ground station lost" in vehicle.texts()
        assert vehicle.command(400, 1) == TEMPORARILY_REJECTED


def test_no_action_without_a_ground_station_by_default(hovering):
    """AUTOPILOT.md 2: NAV_DLL_ACT = 0."""
    hear(hovering)
    hovering.fly(14)
    assert hovering.mode == LOITER
    assert hovering.latest["HEARTBEAT"].system_status == ACTIVE


def test_battery_holds_five_seconds_then_returns_then_lands():
    """AUTOPILOT.md 2: COM_LOW_BAT_ACT; COM_FAIL_ACT_T 5 s hold before an action."""
    with direct(COM_LOW_BAT_ACT=3) as vehicle:
        vehicle.take_off(499.4)
        inject(vehicle.autopilot, "battery 0.06")
        start = vehicle.time_ms
        until_text(vehicle, "Failsafe activated, entering Hold for 5 seconds", 1)
        assert vehicle.time_ms - start <= 100
        vehicle.until(lambda: "Failsafe activated" in vehicle.texts(), 6)
        assert vehicle.time_ms - start == pytest.approx(5000, abs=100)
        assert vehicle.commander.mode is Mode.RTL
        inject(vehicle.autopilot, "battery 0.04")
        vehicle.fly(0.2)
        assert vehicle.commander.mode is Mode.LAND
        assert "Emergency battery level" in vehicle.texts()
        vehicle.until(lambda: not vehicle.armed, 60)


@pytest.mark.parametrize(
    ("action", "mode"),
    [(0, POSCTL), (1, ALTCTL), (2, STABILIZED), (3, RETURN), (4, LANDING), (5, LOITER)],
)
def test_offboard_loss_action_and_its_time(action, mode):
    """AUTOPILOT.md 2: "the failsafe fires 1.03 to 1.11 s after the last setpoint"."""
    with direct(COM_OBL_RC_ACT=action) as vehicle:
        vehicle.take_off(499.4)
        vehicle.offboard(0.0, 0.0, 0.0)
        last = vehicle.time_ms
        fired = until_text(vehicle, "Failsafe activated", 2)
        assert 1030 <= fired - last <= 1110
        vehicle.fly(1.1)
        assert vehicle.mode == mode


def test_position_lost_descends_blindly_with_the_wind_and_disarms(hovering):
    """EKF2_NOAID_TOUT after the last fix no mode that needs a position flies: level, down at MPC_LAND_SPEED."""
    inject(hovering.autopilot, "wind 0,3,0")
    inject(hovering.autopilot, "gps_loss")
    start = hovering.time_ms
    hovering.fly(4)
    assert hovering.latest["GPS_RAW_INT"].fix_type < 2
    assert not hovering.latest["SYS_STATUS"].onboard_control_sensors_health & 0x20
    assert hovering.mode == LOITER
    until_text(hovering, "Failsafe activated", 3)
    assert hovering.time_ms - start == pytest.approx(5000, abs=100)
    before = len([m for m in hovering.messages if m.get_type() == "LOCAL_POSITION_NED"])
    hovering.fly(3)
    assert len([m for m in hovering.messages if m.get_type() == "LOCAL_POSITION_NED"]) == before
    assert hovering.mode == LANDING  # DESCEND looks like LAND
    assert hovering.command(176, 1, 4, 3) == TEMPORARILY_REJECTED
    truth = hovering.autopilot.vehicle.model.truth
    assert truth.velocity[2] == pytest.approx(0.7, abs=0.1)
    assert truth.velocity[1] > 1.0
    hovering.until(lambda: not hovering.armed, 40)
    assert hovering.command(400, 1) == TEMPORARILY_REJECTED
    assert hovering.texts()[-1] == "Arming denied: Resolve system health failures first"
    inject(hovering.autopilot, "gps_loss 0")
    hovering.fly(0.1)
    assert hovering.command(400, 1) == ACCEPTED


def test_position_that_comes_back_is_flown_by_again(hovering):
    hovering.offboard(1.0, 0.0, 0.0)
    inject(hovering.autopilot, "gps_loss 8")
    stream = lambda: hovering.setpoint(1.0, 0.0, 0.0)  # noqa: E731
    hovering.fly(7, stream)
    assert hovering.mode == LANDING
    hovering.fly(3, stream)
    assert hovering.mode == OFFBOARD


def test_short_gps_loss_is_bridged(hovering):
    inject(hovering.autopilot, "gps_loss 4")
    hovering.fly(8)
    assert hovering.mode == LOITER
    assert hovering.latest["GPS_RAW_INT"].fix_type == 3


def test_motor_failure_falls_and_never_flies_again(hovering):
    """A quadrotor with three motors tips over; by default PX4 only warns (COM_ACT_FAIL_ACT 0, CBRK_FLIGHTTERM)."""
    inject(hovering.autopilot, "motor 2 fail")
    hovering.until(lambda: not hovering.armed, 30)
    assert hovering.position[2] == 0.0
    assert hovering.autopilot.vehicle.model.wrecked
    assert hovering.command(400, 1) == TEMPORARILY_REJECTED
    inject(hovering.autopilot, "motor all ok")
    assert hovering.command(400, 1) == ACCEPTED


def test_failure_detector_terminates_when_allowed():
    """FD_FAIL_R, FD_FAIL_R_TTRI 0.3 s, once CBRK_FLIGHTTERM is 0."""
    with direct(CBRK_FLIGHTTERM=0) as vehicle:
        vehicle.take_off(520.0)
        inject(vehicle.autopilot, "motor 1 fail")
        vehicle.until(lambda: not vehicle.commander.armed, 5)
        assert vehicle.position[2] < -5  # still falling
        vehicle.fly(0.2)
        ended = [text for text in vehicle.texts() if text.startswith("Disarmed")]
        assert ended == ["Disarmed by flight termination"]


@pytest.mark.parametrize("lockdown_s", [5.0, 0.0])
def test_tipping_over_just_after_arming_disarms(lockdown_s):
    """Within COM_LKDOWN_TKO and COM_SPOOLUP_TIME of arming; later it is only told."""
    with direct(COM_LKDOWN_TKO=lockdown_s, MPC_TKO_RAMP_T=0.2) as vehicle:
        vehicle.boot()
        assert vehicle.command(400, 1) == ACCEPTED
        assert vehicle.command(22, 0, 0, 0, NAN, NAN, NAN, 510.0) == ACCEPTED
        vehicle.until(lambda: vehicle.autopilot.vehicle.model.truth.position[2] < -3.0, 10)
        inject(vehicle.autopilot, "motor 3 fail")
        vehicle.fly(1.0)
        assert ("Disarmed by failsafe" in vehicle.texts()) == (lockdown_s > 0.0)


def test_motor_failure_action():
    """COM_ACT_FAIL_ACT 4 terminates FD_ACT_MOT_TOUT (100 ms) after the motor stopped."""
    with direct(COM_ACT_FAIL_ACT=4) as vehicle:
        vehicle.take_off(520.0)
        inject(vehicle.autopilot, "motor 1 fail")
        start = vehicle.time_ms
        vehicle.until(lambda: not vehicle.commander.armed, 1)
        assert vehicle.time_ms - start <= 200


def test_wind_above_its_limit_returns():
    """COM_WIND_MAX, COM_WIND_MAX_ACT, COM_WIND_WARN."""
    with direct(COM_WIND_MAX=6.0, COM_WIND_MAX_ACT=3, COM_WIND_WARN=4.0) as vehicle:
        vehicle.take_off(499.4)
        inject(vehicle.autopilot, "wind 3,-4,0")
        until_text(vehicle, "High wind speed detected (5.0 m/s)", 1)
        vehicle.fly(7)
        assert vehicle.mode == LOITER
        inject(vehicle.autopilot, "wind 0,7,0")
        vehicle.fly(7)
        assert vehicle.mode == RETURN


def test_flight_time_limit_returns():
    with direct(COM_FLT_TIME_MAX=15) as vehicle:
        vehicle.take_off(494.0)
        vehicle.until(lambda: vehicle.mode == RETURN, 25)
        assert vehicle.time_ms - vehicle.commander.ground.lifted_ms == pytest.approx(20_000, abs=1050)


def test_sticks_lost_in_offboard(hovering):
    """COM_RCL_EXCEPT 0: also an offboard flight ends when the sticks that were there are lost."""
    hovering.offboard(0.0, 0.0, 0.0)

    def centred() -> None:
        hovering.setpoint(0.0, 0.0, 0.0)
        hovering.send(mavlink.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0))

    hovering.fly(2, centred)
    assert hovering.mode == OFFBOARD
    hovering.fly(7, lambda: hovering.setpoint(0.0, 0.0, 0.0))
    assert hovering.mode == RETURN


def test_pilots_mode_during_a_failsafe_is_kept(hovering):
    inject(hovering.autopilot, "battery 0.06")
    hovering.autopilot.vehicle.parameters.set("COM_LOW_BAT_ACT", 3)
    hovering.until(lambda: "Failsafe activated" in hovering.texts(), 8)
    assert hovering.command(21, 0, 0, 0, NAN) == ACCEPTED
    hovering.fly(2)
    assert hovering.mode == LANDING
    hovering.until(lambda: not hovering.armed, 40)


def test_estimator_not_ready_denies_arming(vehicle):
    """AUTOPILOT.md 2: "Arming too early: TEMPORARILY_REJECTED"."""
    vehicle.boot()
    inject(vehicle.autopilot, "estimator_loss 3")
    vehicle.fly(1)
    assert vehicle.command(400, 1) == TEMPORARILY_REJECTED
    vehicle.fly(3)
    assert vehicle.command(400, 1) == ACCEPTED


@pytest.mark.parametrize(
    ("name", "value"), [("COM_ARMABLE", 0), ("COM_ARM_MIS_REQ", 1), ("SIM_GPS_USED", 3), ("COM_ARM_BAT_MIN", 0.5)]
)
def test_parameters_that_forbid_arming(name, value):
    with direct(**{name: value}) as vehicle:
        vehicle.fly(12)
        vehicle.commander.battery.leave(0.4)
        assert vehicle.command(400, 1) == TEMPORARILY_REJECTED


def test_health_is_finite_whatever_happens(hovering):
    """All at once."""
    for what in ("wind 10,-10,3 20", "gps_loss", "gcs_loss", "sticks_loss", "battery 0", "motor all 0.4"):
        inject(hovering.autopilot, what)
    hovering.fly(20)
    truth = hovering.autopilot.vehicle.model.truth
    assert all(math.isfinite(value) for array in truth for value in array)
