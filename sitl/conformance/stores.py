"""Level 2: what the vehicle keeps for its clients, and flies by: parameters, missions, fences."""

import math
from dataclasses import replace

from pymavlink.dialects.v20 import common as mavlink

from sitl.conformance import flying, parameters, plans
from sitl.conformance.checks import State, check
from sitl.conformance.failures import loss_s
from sitl.conformance.flying import distance, place, result_name, take_control, velocity
from sitl.conformance.outcome import Failed, Skipped, require
from sitl.conformance.plans import FENCE, LAND, MISSION, POLYGON_INCLUSION, RALLY, TAKEOFF, Item, waypoint
from sitl.conformance.vehicle import Vehicle

ACCEPTED = mavlink.MAV_MISSION_ACCEPTED
FENCE_M = 15.0
OVERSHOOT_M = 10.0
"""What a vehicle at 3 m/s may need to stop once it has seen that it is outside."""
PASS_M = 3.0
"""Acceptance radii are 2 m by default (NAV_ACC_RAD, WPNAV_RADIUS)."""


def mission_result(result: int | None) -> str:
    if result is None:
        return "no MISSION_ACK"
    return str(mavlink.enums["MAV_MISSION_RESULT"][result].name.removeprefix("MAV_MISSION_"))


def uploaded(v: Vehicle, items: list[Item], kind: int = MISSION) -> None:
    result = plans.upload(v, items, kind)
    require(result == ACCEPTED, f"upload: {mission_result(result)}")


def compare(sent: list[Item], shown: list[Item]) -> None:
    require(len(sent) == len(shown), f"{len(sent)} items were sent, {len(shown)} are shown")
    for seq, (a, b) in enumerate(zip(sent, shown, strict=True)):
        require(a.like(b), f"item {seq} was sent as {a}, is shown as {b}")


@check(2, State.GROUND, "Parameter Protocol: PARAM_REQUEST_LIST gives every index from 0 to param_count - 1 once")
def parameter_list(v: Vehicle) -> str:
    values = parameters.read_all(v)
    counts = {value.count for value in values.values()}
    require(len(counts) == 1, f"param_count differs: {sorted(counts)}")
    (count,) = counts
    missing = [index for index in range(count) if index not in values]
    require(not missing, f"{len(missing)} of {count} never came, the first is {missing[:1]}")
    names = {value.name for value in values.values()}
    require(len(names) == count, f"{count - len(names)} names came under two indices")
    return f"{count} parameters"


@check(2, State.GROUND, "Parameter Protocol: PARAM_REQUEST_READ by name and by index tell the same")
def parameter_read(v: Vehicle) -> str:
    name = v.autopilot.loss_parameter
    by_name = parameters.read(v, name)
    if by_name is None:
        raise Failed(f"{name}: not told by name")
    if by_name.index >= by_name.count:
        raise Skipped(f"{name} is told without its index")
    by_index = parameters.read(v, "", by_name.index)
    if by_index is None:
        raise Failed(f"index {by_name.index}: not told")
    require((by_index.name, by_index.value) == (name, by_name.value), f"{name} = {by_name.value}, by index {by_index}")
    return f"{name} = {by_name.value:g}, index {by_name.index}"


@check(2, State.GROUND, "Parameter Protocol: PARAM_SET is told back, and kept")
def parameter_set(v: Vehicle) -> str:
    name = v.autopilot.loss_parameter
    first = parameters.read(v, name)
    if first is None:
        raise Failed(f"{name}: not there")
    wanted = first.value + 0.75
    told = parameters.write(v, name, wanted)
    require(told is not None and math.isclose(told.value, wanted, rel_tol=1e-5), f"{wanted:g} set, told back: {told}")
    kept = parameters.read(v, name)
    require(kept is not None and math.isclose(kept.value, wanted, rel_tol=1e-5), f"{wanted:g} set, read then: {kept}")
    parameters.restore(v)
    again = parameters.read(v, name)
    require(again is not None and again.value == first.value, f"set back to {first.value:g}, read then: {again}")
    return f"{name}: {first.value:g}, {wanted:g}, {first.value:g}"


@check(2, State.GROUND, "Parameter Protocol: integers as their bytes (PX4) or as floats (ArduPilot), by param_type")
def parameter_integer(v: Vehicle) -> str:
    name = "MAV_TYPE" if v.autopilot.integers_bytewise else "FRAME_CLASS"
    told = parameters.read(v, name)
    if told is None:
        raise Skipped(f"{name} is not there")
    require(told.mav_type in parameters.INTEGERS, f"{name} has MAV_PARAM_TYPE {told.mav_type}, no integer")
    require(told.value == round(told.value) and 0 < told.value < 100, f"{name} = {told.value:g}")
    return f"{name} = {told.value:g}, MAV_PARAM_TYPE {told.mav_type}"


@check(2, State.GROUND, "Mission Protocol: an uploaded mission is downloaded as it was sent")
def mission_transfer(v: Vehicle) -> str:
    sent = plans.with_home(
        v,
        [
            waypoint(v, 0.0, 0.0, 8.0, TAKEOFF),
            waypoint(v, 10.0, 0.0, 8.0),
            waypoint(v, 10.0, 10.0, 9.5),
            Item(178, (1.0, 4.0, -1.0, 0.0), 0, 0, 0.0, 2),
            waypoint(v, 0.0, 10.0, 8.0),
        ],
    )
    uploaded(v, sent)
    shown = plans.download(v)
    compare(plans.without_home(v, sent), plans.without_home(v, shown))
    return f"{len(sent)} items"


@check(2, State.GROUND, "Mission Protocol: MISSION_CLEAR_ALL leaves nothing to download")
def mission_clear(v: Vehicle) -> str:
    uploaded(v, plans.with_home(v, [waypoint(v, 0.0, 0.0, 8.0, TAKEOFF), waypoint(v, 10.0, 0.0, 8.0)]))
    result = plans.clear(v)
    require(result == ACCEPTED, f"MISSION_CLEAR_ALL: {mission_result(result)}")
    left = plans.without_home(v, plans.download(v))
    require(not left, f"{len(left)} items are left")
    return "empty"


@check(2, State.GROUND, "Mission Protocol: an item that is not supported is refused, and the mission before is kept")
def mission_refused(v: Vehicle) -> str:
    kept = plans.with_home(v, [waypoint(v, 0.0, 0.0, 8.0, TAKEOFF), waypoint(v, 10.0, 0.0, 8.0)])
    uploaded(v, kept)
    unknown = Item(45678, (0.0, 0.0, 0.0, 0.0), *plans.globe(v, 0.0, 0.0), 8.0)
    result = plans.upload(v, plans.with_home(v, [waypoint(v, 0.0, 0.0, 8.0, TAKEOFF), unknown]))
    require(result != ACCEPTED, "a mission with command 45678 was accepted")
    shown = plans.without_home(v, plans.download(v))
    require(all(item.command != unknown.command for item in shown), "command 45678 is in the mission")
    return f"{mission_result(result)}, {len(shown)} items kept"


def square(v: Vehicle, half: float) -> list[Item]:
    corners = ((half, half), (half, -half), (-half, -half), (-half, half))
    return [
        Item(POLYGON_INCLUSION, (4.0, 0.0, 0.0, 0.0), *plans.globe(v, north, east), 0.0, 0) for north, east in corners
    ]


@check(2, State.GROUND, "Mission Protocol, MAV_MISSION_TYPE_FENCE: a fence is downloaded as it was sent, and cleared")
def fence_transfer(v: Vehicle) -> str:
    sent = square(v, FENCE_M)
    uploaded(v, sent, FENCE)
    shown = plans.download(v, FENCE)
    compare(sent, [replace(item, z=0.0, frame=0) for item in shown])  # a fence has no altitude
    require(all(item.p[0] == 4.0 for item in shown), f"vertex counts {[item.p[0] for item in shown]}")
    result = plans.clear(v, FENCE)
    require(result == ACCEPTED, f"MISSION_CLEAR_ALL: {mission_result(result)}")
    require(not plans.download(v, FENCE), "items are left after MISSION_CLEAR_ALL")
    return f"{len(sent)} vertices"


@check(2, State.GROUND, "Mission Protocol, MAV_MISSION_TYPE_RALLY: kept, or refused at once")
def rally_points(v: Vehicle) -> str:
    sent = [Item(5100, (0.0, 0.0, 0.0, 0.0), *plans.globe(v, 5.0, 5.0), 10.0)]
    result = plans.upload(v, sent, RALLY)
    if result != ACCEPTED:
        require(result == mavlink.MAV_MISSION_UNSUPPORTED, f"refused by {mission_result(result)}, not UNSUPPORTED")
        raise Skipped("rally points are refused by UNSUPPORTED")
    compare(sent, plans.download(v, RALLY))
    plans.clear(v, RALLY)
    return "kept and shown"


@check(2, State.GROUND, "Mission Protocol; PX4 Mission Mode / Copter Auto Mode: flown from takeoff to landing")
def mission_flown(v: Vehicle) -> str:
    corners = [(12.0, 0.0), (12.0, 10.0)]
    home_at = (4.0, 6.0)
    items = [
        waypoint(v, 0.0, 0.0, 8.0, TAKEOFF),
        *(waypoint(v, north, east, 8.0) for north, east in corners),
        waypoint(v, *home_at, 0.0, LAND),
    ]
    sent = plans.with_home(v, items)
    uploaded(v, sent)
    first = len(sent) - len(items)
    flying.arm(v)
    with v.track() as samples, v.hear("MISSION_ITEM_REACHED") as reached:
        if v.autopilot.needs_stream:
            result = v.set_mode(v.autopilot.mission)
        else:
            result = v.command(mavlink.MAV_CMD_MISSION_START)
        require(result == mavlink.MAV_RESULT_ACCEPTED, f"starting the mission: {result_name(result)}")
        v.until(lambda: v.mode == v.autopilot.mission, flying.HEARD_S, "mission mode")
        v.until(lambda: not v.armed, 120.0, "flown, landed and disarmed")
    missed = [min(distance(s.position, place(v, *corner, 8.0)) for s in samples) for corner in corners]
    require(max(missed) < PASS_M, f"passed the waypoints {missed[0]:.1f} and {missed[1]:.1f} m away")
    end = v.now.position
    off = math.hypot(end[0] - v.start[0] - home_at[0], end[1] - v.start[1] - home_at[1])
    require(off < 2.0, f"landed {off:.1f} m from where the mission ends")
    told = [m.seq for m in reached]
    wanted = [first + 1, first + 2]
    require([seq for seq in told if seq in wanted] == wanted, f"MISSION_ITEM_REACHED {told}, {wanted} wanted")
    return f"waypoints passed at {missed[0]:.1f} and {missed[1]:.1f} m, landed {off:.1f} m off"


@check(2, State.AIR, "PX4 COM_OF_LOSS_T / ArduPilot GUID_TIMEOUT: a parameter that was set acts at once")
def parameter_acts(v: Vehicle) -> str:
    parameters.change(v, v.autopilot.loss_settings)
    first = parameters.read(v, v.autopilot.loss_parameter)
    if first is None:
        raise Failed(f"{v.autopilot.loss_parameter}: not there")
    wanted = first.value + (1.5 if first.value < 2.0 else -1.5)
    parameters.write(v, v.autopilot.loss_parameter, wanted)
    seen = loss_s(v, wanted)
    parameters.restore(v)
    return f"set to {wanted:g} s: acts {seen:.1f} s after the last setpoint"


@check(2, State.AIR, "Mission Protocol: a mission is left and gone on with where it was")
def mission_paused(v: Vehicle) -> str:
    far = (14.0, 0.0)
    uploaded(v, plans.with_home(v, [waypoint(v, 0.0, 0.0, 10.0, TAKEOFF), waypoint(v, *far, 10.0)]))
    v.set_mode(v.autopilot.mission)
    v.until(lambda: v.now.position[0] - v.start[0] > 4.0, 40.0, "on its way")
    flying.hold(v)
    stood = v.now.position[0] - v.start[0]
    begin = v.now.position
    v.go_on(3.0)
    require(distance(v.now.position, begin) < 1.0, f"it moved {distance(v.now.position, begin):.1f} m while it held")
    require(stood < far[0] - 1.0, f"held only at {stood:.1f} m, the waypoint is at {far[0]:g}")
    v.set_mode(v.autopilot.mission)
    v.until(lambda: distance(v.now.position, place(v, *far)) < PASS_M, 40.0, "waypoint reached after the pause")
    flying.hold(v)
    return f"held at {stood:.1f} m, then went on to {far[0]:g} m"


@check(2, State.AIR, "PX4 GF_ACTION / ArduPilot FENCE_ENABLE: an inclusion fence is not flown out of")
def fence_holds(v: Vehicle) -> str:
    uploaded(v, square(v, FENCE_M), FENCE)
    parameters.change(v, v.autopilot.fence_settings)
    take_control(v)
    with v.track() as samples:
        v.go_on(14.0, velocity(v, 3.0))
    farthest = max(s.position[0] - v.start[0] for s in samples)
    plans.clear(v, FENCE)
    parameters.restore(v)
    require(farthest > 0.5 * FENCE_M, f"it flew only {farthest:.1f} m, and never met the fence")
    require(farthest < FENCE_M + OVERSHOOT_M, f"{farthest:.1f} m north, the fence is at {FENCE_M:g} m")
    return f"fence at {FENCE_M:g} m, flown to {farthest:.1f} m"
