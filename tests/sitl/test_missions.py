"""Missions over real UDP: transfer by a pymavlink client, and what is flown of them."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import development as mavlink

from sitl.arducopter.personality import ARDUCOPTER
from sitl.autopilot import Autopilot
from sitl.links.network import Network
from sitl.links.signing import Signing
from sitl.parameters import Parameters
from sitl.personality import Result
from sitl.plan import Item, Kind, Verdict, judge, judge_whole
from sitl.px4.personality import PX4
from tests.sitl.client import direct
from tests.sitl.plans import (
    CHANGE_SPEED,
    DELAY,
    DO_JUMP,
    LAND,
    LOITER_TIME,
    LOITER_UNLIM,
    NAN,
    ORIGIN,
    RETURN,
    TAKEOFF,
    WAYPOINT,
    download,
    heard,
    item,
    message,
    order,
    upload,
)

ACCEPTED, TEMPORARILY_REJECTED, DENIED, UNSUPPORTED, FAILED = range(5)
ARM, DO_SET_MODE, START, PAUSE, SET_CURRENT = 400, 176, 300, 193, 224
LOITER, MISSION, RTL = (4, 3), (4, 4), (4, 5)
NO_SPACE = 4
HOME = item(WAYPOINT, 0.0, 0.0, 489.4, frame=0)

SQUARE = [
    item(TAKEOFF, up=8.0),
    item(WAYPOINT, 20.0, 0.0, 10.0),
    item(WAYPOINT, 20.0, 20.0, 12.0),
    item(WAYPOINT, 0.0, 20.0, 10.0),
]


def reached(vehicle):
    return [m.seq for m in vehicle.messages if m.get_type() == "MISSION_ITEM_REACHED"]


def fly_mission(vehicle, plan):
    """Upload, arm, start."""
    vehicle.boot()
    assert upload(vehicle, plan) == ACCEPTED
    assert vehicle.command(ARM, 1) == ACCEPTED
    assert vehicle.command(DO_SET_MODE, 1, 4, 4) == ACCEPTED


def track(vehicle, places, limit_s=120.0):
    """Fly until every place (north, east, up) was passed in turn within 2.2 m; the times [s] of passing."""
    times = []
    for place in places:
        vehicle.until(lambda place=place: math.dist(vehicle.position, (place[0], place[1], -place[2])) < 2.2, limit_s)
        times.append(vehicle.time_ms / 1000.0)
    return times


# Transfer


@pytest.mark.parametrize("integer", [True, False])
def test_upload_and_download_give_back_the_same_plan(vehicle, integer):
    """AUTOPILOT.md 1: COUNT -> REQUEST_INT xn -> ACK, download; also for clients of float items."""
    vehicle.boot()
    assert upload(vehicle, SQUARE, integer=integer) == ACCEPTED
    back = download(vehicle, integer=integer)
    assert [i[1] for i in back] == [i[1] for i in SQUARE]
    assert {i[0] for i in back} == {6 if integer else 3}
    scale = 1.0 if integer else 1e7
    for sent, got in zip(SQUARE, back, strict=True):
        assert got[3] * scale == pytest.approx(sent[3], abs=1 if integer else 40)
        assert got[5] == pytest.approx(sent[5])
    vehicle.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0))
    vehicle.advance()
    assert vehicle.latest["MISSION_ACK"].type == ACCEPTED
    assert download(vehicle) == []


def test_bad_plans_over_the_wire(vehicle):
    """AUTOPILOT.md 1: unsupported item: ACK 3. Issue 4: mission of 0 and of 10 thousand items."""
    vehicle.boot()
    assert upload(vehicle, SQUARE) == ACCEPTED
    assert upload(vehicle, [item(34)]) == UNSUPPORTED
    assert upload(vehicle, SQUARE[:1] * 10_000) == NO_SPACE
    assert upload(vehicle, [item(5100)], kind=2) == UNSUPPORTED  # rally points
    assert len(download(vehicle)) == 4  # none of them touched what was there
    assert upload(vehicle, []) == ACCEPTED
    assert download(vehicle) == []


def test_a_second_client_is_told_busy_and_the_first_goes_on(vehicle):
    """AUTOPILOT.md 1: a second upload meanwhile: ACK 1 and "Busy"."""
    vehicle.boot()
    vehicle.send(mavlink.MAVLink_mission_count_message(1, 1, 2, 0))
    vehicle.advance(20)
    vehicle.mav.srcComponent = 42
    vehicle.send(mavlink.MAVLink_mission_count_message(1, 1, 3, 0))
    vehicle.advance(20)
    ack = vehicle.latest["MISSION_ACK"]
    assert (ack.type, ack.target_component) == (1, 42)
    assert "Busy" in vehicle.texts()[-1]
    vehicle.mav.srcComponent = 191
    for seq in range(2):
        vehicle.send(message(seq, SQUARE[seq]))
        vehicle.advance(20)
    assert (vehicle.latest["MISSION_ACK"].type, vehicle.latest["MISSION_ACK"].target_component) == (0, 191)


def test_a_client_that_vanishes_in_mid_transfer(hovering):
    """Issue 4, bad input: the vehicle keeps flying; the next client is served after the timeout."""
    since = len(hovering.messages)
    hovering.send(mavlink.MAVLink_mission_count_message(1, 1, 2, 0))
    hovering.fly(6)
    asked = heard(hovering, since, "MISSION_REQUEST_INT")
    assert len(asked) == 20  # every 250 ms for 5 s
    assert hovering.texts()[-1] == "Operation timeout"
    assert hovering.position[2] == pytest.approx(-10, abs=0.3)
    assert upload(hovering, SQUARE) == ACCEPTED


def test_without_a_mission(vehicle):
    """AUTOPILOT.md 2: MISSION without a mission is TEMPORARILY_REJECTED; MISSION_CURRENT as recorded, 1 Hz."""
    vehicle.boot()
    assert vehicle.command(DO_SET_MODE, 1, 4, 4) == TEMPORARILY_REJECTED
    assert vehicle.command(START) == DENIED
    since = len(vehicle.messages)
    vehicle.fly(5)
    current = heard(vehicle, since, "MISSION_CURRENT")
    assert len(current) == pytest.approx(5, abs=1)
    assert (current[0].seq, current[0].total, current[0].mission_state) == (0, 65535, 0)


def test_parts_of_plans_are_refused_at_once(vehicle):
    vehicle.boot()
    for ask in (
        mavlink.MAVLink_mission_request_partial_list_message(1, 1, 0, 1),
        mavlink.MAVLink_mission_write_partial_list_message(1, 1, 0, 1),
    ):
        since = len(vehicle.messages)
        vehicle.send(ask)
        vehicle.advance(20)
        assert [m.type for m in heard(vehicle, since, "MISSION_ACK")] == [UNSUPPORTED]


# Flight


def test_mission_takes_off_flies_its_waypoints_and_holds(vehicle):
    """AUTOPILOT.md 1: MISSION_CURRENT and MISSION_ITEM_REACHED for progress; PX4 holds at the end."""
    fly_mission(vehicle, SQUARE)
    vehicle.until(lambda: vehicle.landed == 3, 10)  # taking off
    track(vehicle, [(0, 0, 8), (20, 0, 10), (20, 20, 12), (0, 20, 10)])
    vehicle.fly(8)
    assert reached(vehicle) == [0, 1, 2, 3]
    currents = [m.seq for m in vehicle.messages if m.get_type() == "MISSION_CURRENT" and m.total == 4]
    assert currents == sorted(currents)
    assert set(currents) == {0, 1, 2, 3}
    assert vehicle.mode == LOITER
    assert vehicle.position == pytest.approx((0, 20, -10), abs=0.3)
    assert vehicle.latest["MISSION_CURRENT"].mission_state == 5
    assert "Mission finished, loitering" in vehicle.texts()


def test_straight_waypoints_are_flown_through_and_holds_are_kept(vehicle):
    fly_mission(vehicle, [item(WAYPOINT, n, 0.0, 5.0) for n in (15.0, 30.0, 45.0)] + [
        item(LOITER_TIME, 45.0, 0.0, 5.0, p=(4.0, 0.0, 0.0, NAN)), item(WAYPOINT, 45.0, 10.0, 5.0)
    ])  # fmt: skip
    track(vehicle, [(15, 0, 5)])
    slowest = 9.0

    def watch():
        nonlocal slowest
        slowest = min(slowest, vehicle.velocity[0])

    vehicle.until(lambda: vehicle.position[0] > 38, 30, watch)
    assert slowest > 3.5  # MPC_XY_CRUISE is 5
    vehicle.until(lambda: 2 in reached(vehicle), 20)
    start = vehicle.time_ms
    vehicle.until(lambda: 3 in reached(vehicle), 20)
    assert vehicle.time_ms - start >= 3900
    assert vehicle.position[0] == pytest.approx(45, abs=1.0)


def test_a_mission_without_takeoff_item_climbs_first(vehicle):
    """As MAVSDK's missions do: PX4 puts a takeoff to MIS_TAKEOFF_ALT before the first waypoint."""
    fly_mission(vehicle, [item(WAYPOINT, 15.0, 0.0, 10.0)])
    vehicle.until(lambda: vehicle.position[2] < -1.5, 20)
    assert math.hypot(*vehicle.position[:2]) < 0.3
    track(vehicle, [(15, 0, 10)])


def test_mission_lands_and_disarms(vehicle):
    fly_mission(vehicle, [item(TAKEOFF, up=5.0), item(LAND, 10.0, -5.0, 0.0)])
    vehicle.until(lambda: vehicle.landed == 4, 40)  # landing
    assert math.dist(vehicle.position[:2], (10.0, -5.0)) < 2.2
    assert vehicle.position[2] < -4.0  # level to above the place, then down
    vehicle.until(lambda: not vehicle.armed, 60)
    assert vehicle.position == pytest.approx((10, -5, 0), abs=0.5)
    assert reached(vehicle) == [0, 1]


def test_mission_returns(vehicle):
    fly_mission(vehicle, [item(TAKEOFF, up=5.0), item(WAYPOINT, 12.0, 0.0, 6.0), order(RETURN)])
    vehicle.until(lambda: vehicle.mode == RTL, 60)
    vehicle.until(lambda: not vehicle.armed, 90)
    assert vehicle.position == pytest.approx((0, 0, 0), abs=0.5)
    assert reached(vehicle) == [0, 1, 2]


def test_change_speed_in_the_mission_and_by_command(vehicle):
    fly_mission(
        vehicle,
        [item(TAKEOFF, up=5.0), order(CHANGE_SPEED, 1, 2.0), item(WAYPOINT, 60.0, 0.0, 5.0), item(WAYPOINT, 0, 0, 5.0)],
    )
    vehicle.until(lambda: vehicle.position[0] > 10, 60)
    assert vehicle.velocity[0] == pytest.approx(2.0, abs=0.2)
    assert vehicle.command(CHANGE_SPEED, 1, 6.0, -1) == ACCEPTED
    vehicle.until(lambda: vehicle.position[0] > 35, 30)
    assert vehicle.velocity[0] > 5.1  # above MPC_XY_CRUISE; SIH's drag keeps it short of 6
    assert reached(vehicle) == [0, 1]


def test_jump_repeats_and_delay_waits(vehicle):
    fly_mission(
        vehicle,
        [item(TAKEOFF, up=4.0), item(WAYPOINT, 6.0, 0.0, 4.0), item(WAYPOINT, 0.0, 0.0, 4.0), order(DO_JUMP, 1, 2),
         order(DELAY, 3.0)],
    )  # fmt: skip
    vehicle.until(lambda: vehicle.mode == LOITER and 4 in reached(vehicle), 120)
    assert reached(vehicle) == [0, 1, 2, 1, 2, 1, 2, 4]


def test_a_mission_of_nothing_but_jumps_does_not_stop_the_clock(vehicle):
    fly_mission(vehicle, [item(TAKEOFF, up=4.0), order(DO_JUMP, 1, -1)])
    vehicle.fly(15)
    assert vehicle.mode == MISSION
    assert vehicle.position[2] == pytest.approx(-4.0, abs=0.5)
    assert reached(vehicle) == [0]


def test_pause_resume_and_choice_of_item(vehicle):
    fly_mission(vehicle, SQUARE)
    track(vehicle, [(0, 0, 8)])
    vehicle.until(lambda: vehicle.position[0] > 5, 30)
    assert vehicle.command(DO_SET_MODE, 1, 4, 3) == ACCEPTED  # MAVSDK pauses so
    vehicle.fly(6)
    stopped = vehicle.position
    assert math.hypot(*vehicle.velocity) < 0.2
    assert vehicle.latest["MISSION_CURRENT"].mission_state == 4
    vehicle.fly(2)
    assert vehicle.position == pytest.approx(stopped, abs=0.2)
    assert vehicle.command(DO_SET_MODE, 1, 4, 4) == ACCEPTED
    track(vehicle, [(20, 0, 10)])
    vehicle.send(mavlink.MAVLink_mission_set_current_message(1, 1, 3))
    track(vehicle, [(0, 20, 10)], 30)
    assert 2 not in reached(vehicle)
    assert vehicle.command(SET_CURRENT, 99) == FAILED
    assert "WPM: WP CURR CMD: Not in list" in vehicle.texts()


def test_mission_start_arms_and_flies(vehicle):
    """MISSION_START on PX4 arms too."""
    vehicle.boot()
    assert upload(vehicle, SQUARE[:2]) == ACCEPTED
    assert vehicle.command(START, 7, 0) == DENIED
    assert vehicle.command(START, 0, 0) == ACCEPTED
    assert vehicle.texts()[-1] == "Armed by mission start"
    track(vehicle, [(0, 0, 8), (20, 0, 10)])


def test_a_new_mission_under_way_and_a_cleared_one(vehicle):
    fly_mission(vehicle, SQUARE)
    track(vehicle, [(0, 0, 8)])
    assert upload(vehicle, [item(LOITER_UNLIM, -10.0, 0.0, 8.0)]) == ACCEPTED
    track(vehicle, [(-10, 0, 8)], 40)
    vehicle.fly(6)
    assert vehicle.mode == MISSION
    vehicle.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 0))
    vehicle.fly(2)
    assert vehicle.mode == LOITER
    assert vehicle.position[0] == pytest.approx(-10, abs=0.5)


def test_waypoint_yaw_and_acceptance_radius():
    with direct(NAV_ACC_RAD=5.0) as vehicle:
        near = item(WAYPOINT, 30.0, 0.0, 5.0, p=(0.5, 0.5, 0.0, 90.0))
        fly_mission(vehicle, [item(TAKEOFF, up=5.0), near, item(LOITER_UNLIM, 30.0, 0.0, 5.0)])
        vehicle.until(lambda: 1 in reached(vehicle), 60)
        assert vehicle.position[0] == pytest.approx(30.0, abs=0.6)
        assert vehicle.latest["ATTITUDE"].yaw == pytest.approx(math.pi / 2, abs=0.1)


def test_a_mission_flies_the_same_to_the_bit():
    """Issue 4, item 6: deterministic to the bit for a seed, missions and their transfer too."""

    def flight():
        with direct(seed=7) as vehicle:
            fly_mission(vehicle, SQUARE[:2])
            vehicle.fly(10)
            return vehicle.raw

    assert flight() == flight()


fields = st.one_of(st.floats(allow_infinity=False, width=32), st.sampled_from([0.0, -1.0, 1.0, NAN, 3.0]))
places = st.builds(
    lambda command, p, north, east, up, frame: item(command, north, east, up, p=p, frame=frame),
    command=st.sampled_from([WAYPOINT, LOITER_UNLIM, LOITER_TIME, LAND, TAKEOFF, 31, 82]),
    p=st.tuples(fields, fields, fields, fields),
    north=st.floats(-30, 30),
    east=st.floats(-30, 30),
    up=st.floats(-100, 60),
    frame=st.sampled_from([0, 3, 5, 6]),
)
orders = st.builds(
    order, st.sampled_from([RETURN, DELAY, DO_JUMP, CHANGE_SPEED, 179, 205, 2000]), fields, fields, fields, fields
)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.one_of(places, orders), min_size=1, max_size=6), st.booleans())
def test_no_accepted_mission_breaks_the_vehicle(plan, copter):
    """Whatever plan is judged good: numbers stay numbers, the clock goes on, the vehicle obeys a landing after it."""
    items = tuple(Item(*fields) for fields in plan)
    assume(all(judge(i, Kind.MISSION) is Verdict.ACCEPTED for i in items))
    assume(judge_whole(items, Kind.MISSION) is Verdict.ACCEPTED)
    personality = ARDUCOPTER if copter else PX4
    p = Parameters(personality.table)
    autopilot = Autopilot(personality, p, ORIGIN, Network((), 1, Signing()), 0, 0)
    commander, body = autopilot.vehicle.commander, autopilot.vehicle.body
    while not commander.ready:
        autopilot.advance(500)
    if copter:
        items = (Item(*HOME), Item(*item(TAKEOFF, up=5.0)), *items)
        commander.set_mode(4)
        assert commander.arm(force=False) is Result.ACCEPTED
    commander.plans.store(Kind.MISSION, items)
    assert commander.start_mission(0.0, 0.0) is Result.ACCEPTED
    for _ in range(40):
        autopilot.advance(1000)
        assert np.isfinite(body.position).all()
        assert np.isfinite(body.velocity).all()
        assert abs(np.linalg.norm(body.attitude) - 1.0) < 1e-6
        assert 0 <= commander.plans.current < len(items)
    if commander.armed:
        assert commander.land() is Result.ACCEPTED
        for _ in range(300):
            autopilot.advance(1000)
            if not commander.armed:
                break
        assert not commander.armed
        assert body.position[2] == 0.0
