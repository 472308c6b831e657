"""What a flight log says of who sent what after which."""

from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

OURS, VEHICLES = 245, 1
OFFBOARD = {mavlink.MAV_AUTOPILOT_PX4: 6 << 16, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: 4}
"""The mode that flies our setpoints."""
ASKING = ("COMMAND_LONG", "SET_MODE", "SET_POSITION_TARGET_LOCAL_NED")


def read_log(path):
    """Both directions, as they came and went."""
    log = mavutil.mavlink_connection(str(path))
    return list(iter(log.recv_match, None))


def setpoints(log):
    return [m for m in log if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]


def of_vehicle(log, kind):
    """(index, message) of what the autopilot has told."""
    return [(i, m) for i, m in enumerate(log) if m.get_type() == kind and m.get_srcSystem() == VEHICLES]


def asked(log):
    """What we have asked of the vehicle's flight: setpoints, and commands that change what it flies."""
    flight = {
        mavlink.MAV_CMD_DO_SET_MODE,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    }
    return [
        m
        for m in log
        if m.get_srcSystem() == OURS
        and m.get_type() in ASKING
        and (m.get_type() != "COMMAND_LONG" or m.command in flight)
    ]


def heard_mode(log, mode):
    """Index of the first HEARTBEAT of the vehicle in this custom mode."""
    return next(i for i, m in of_vehicle(log, "HEARTBEAT") if m.custom_mode == mode)
