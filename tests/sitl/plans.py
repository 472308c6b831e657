"""Mission items for tests, and a pymavlink client that transfers them over real UDP."""

import math

from pymavlink.dialects.v20 import development as mavlink

from sitl.origin import Origin

NAN = math.nan
ORIGIN = Origin()
WAYPOINT, LOITER_UNLIM, LOITER_TIME, RETURN, LAND, TAKEOFF = 16, 17, 19, 20, 21, 22
DELAY, DO_JUMP, CHANGE_SPEED, SET_HOME = 93, 177, 178, 179
RELATIVE = 6


def item(command, north=0.0, east=0.0, up=10.0, p=(0.0, 0.0, 0.0, NAN), frame=RELATIVE):
    """frame, command, params, x, y, z of an item at a local place."""
    latitude, longitude = ORIGIN.globe(north, east)
    return (frame, command, p, round(latitude * 1e7), round(longitude * 1e7), up)


def order(command, *p):
    """An item without a place."""
    return (2, command, (*p, *[0.0] * (4 - len(p))), 0, 0, 0.0)


def message(seq, plan_item, kind=0, integer=True, current=0):
    frame, command, p, x, y, z = plan_item
    if integer:
        return mavlink.MAVLink_mission_item_int_message(
            1, 1, seq, frame, command, current, 1, *p, x, y, z, mission_type=kind
        )
    return mavlink.MAVLink_mission_item_message(
        1, 1, seq, frame, command, current, 1, *p, x * 1e-7, y * 1e-7, z, mission_type=kind
    )


def heard(vehicle, since, name):
    return [m for m in vehicle.messages[since:] if m.get_type() == name]


def upload(vehicle, plan, kind=0, integer=True):
    """COUNT, items as they are asked for, ACK: the result."""
    since = len(vehicle.messages)
    vehicle.send(mavlink.MAVLink_mission_count_message(1, 1, len(plan), kind))
    answered = 0
    for _ in range(4 * len(plan) + 20):
        vehicle.advance(10)
        acks = heard(vehicle, since, "MISSION_ACK")
        if acks:
            assert acks[0].mission_type == kind
            return acks[0].type
        asked = heard(vehicle, since, "MISSION_REQUEST_INT") + heard(vehicle, since, "MISSION_REQUEST")
        if len(asked) > answered:
            answered = len(asked)
            last = max(request.seq for request in asked)
            vehicle.send(message(last, plan[last], kind, integer))
    return None


def download(vehicle, kind=0, integer=True):
    """The plan as the vehicle shows it."""
    since = len(vehicle.messages)
    vehicle.send(mavlink.MAVLink_mission_request_list_message(1, 1, kind))
    vehicle.advance(20)
    (count,) = heard(vehicle, since, "MISSION_COUNT")
    assert count.mission_type == kind
    plan = []
    for seq in range(count.count):
        ask = mavlink.MAVLink_mission_request_int_message if integer else mavlink.MAVLink_mission_request_message
        vehicle.send(ask(1, 1, seq, kind))
        vehicle.advance(20)
        m = heard(vehicle, since, "MISSION_ITEM_INT" if integer else "MISSION_ITEM")[-1]
        assert (m.seq, m.mission_type) == (seq, kind)
        plan.append((m.frame, m.command, (m.param1, m.param2, m.param3, m.param4), m.x, m.y, m.z))
    vehicle.send(mavlink.MAVLink_mission_ack_message(1, 1, 0, kind))
    vehicle.advance(20)
    return plan
