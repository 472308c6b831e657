"""ArduCopter, as measured (shared/design/AUTOPILOT.md sections 3 and 4).

GUIDED is what PX4 splits into hold, takeoff and OFFBOARD: it is armed in, takes off in, and flies setpoints. A velocity
ends a takeoff, so none is sent before the height is reached. When the stream stops, it flies on for GUID_TIMEOUT (3 s),
brakes, and stays in GUIDED for as long as the battery lasts: what brings it down is the failsafe of its ground station,
and for that our HEARTBEAT must be the one that it listens to (MAV_GCS_SYSID).
"""

import math

from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.dialects import Dialect, Need, OwnFence, Read
from autopilot_bridge.link import OWN_SYSTEM
from autopilot_bridge.vehicle import Mode

GUIDED, LOITER, RTL, LAND, BRAKE = 4, 5, 6, 9, 17
FENCE_TOP, FENCE_CIRCLE, FENCE_AREAS, FENCE_FLOOR = 1, 2, 4, 8
"""Bits of FENCE_TYPE."""
FENCE_UNION = 2
"""Bit of FENCE_OPTIONS."""
WITH_CIRCLE_AND_TOP = tuple(kinds for kinds in range(16) if kinds & FENCE_TOP and kinds & FENCE_CIRCLE)


def _own_fence(read: Read) -> OwnFence:
    if not read("FENCE_ENABLE"):
        return OwnFence()
    kinds = int(read("FENCE_TYPE"))
    return OwnFence(
        radius_m=read("FENCE_RADIUS") if kinds & FENCE_CIRCLE else math.inf,
        height_m=read("FENCE_ALT_MAX") if kinds & FENCE_TOP else math.inf,
        floor_m=read("FENCE_ALT_MIN") if kinds & FENCE_FLOOR else -math.inf,
        margin_m=read("FENCE_MARGIN"),
        areas=bool(kinds & FENCE_AREAS),
        any_inclusion=bool(int(read("FENCE_OPTIONS")) & FENCE_UNION),
    )


def _tilt_max_deg(read: Read) -> float:
    """Of the position controller; 0: that of all modes."""
    return read("PSC_ANGLE_MAX") or read("ANGLE_MAX") / 100


def _battery_acts_at(read: Read) -> float:
    """By charge; at which share BATT_LOW_VOLT acts nobody can say."""
    if not read("BATT_FS_LOW_ACT"):
        return 0.0
    return min(read("BATT_LOW_MAH") / max(read("BATT_CAPACITY"), 1.0), 1.0)


ARDUCOPTER = Dialect(
    name="arducopter",
    autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    modes={
        0: (Mode.OTHER, "STABILIZE"),
        1: (Mode.OTHER, "ACRO"),
        2: (Mode.OTHER, "ALT_HOLD"),
        3: (Mode.OTHER, "AUTO"),
        GUIDED: (Mode.OFFBOARD, "GUIDED"),
        LOITER: (Mode.OTHER, "LOITER"),  # by sticks: a pilot's
        RTL: (Mode.RETURN, "RTL"),
        7: (Mode.OTHER, "CIRCLE"),
        LAND: (Mode.LAND, "LAND"),
        16: (Mode.OTHER, "POSHOLD"),
        BRAKE: (Mode.HOLD, "BRAKE"),  # the hold that asks for no sticks
        21: (Mode.RETURN, "SMART_RTL"),
    },
    commands={Mode.HOLD: (BRAKE, 0), Mode.RETURN: (RTL, 0), Mode.LAND: (LAND, 0), Mode.OFFBOARD: (GUIDED, 0)},
    rates_hz={  # it sends nothing but HEARTBEAT by itself
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 10.0,  # the mode: how soon a pilot is obeyed
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE: 20.0,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
        mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1.0,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    },
    stream_before_offboard_s=0.0,
    lead_s=(0.5, 0.5, 0.3),  # level: WPNAV_ACCEL over PSC_JERK_XY, the shaper's own lag (benchmarks/slot_tracking.py)
    drag_share=0.0,  # its shaper and integrator make it up; more made tracking worse (benchmarks/slot_tracking.py)
    reaction_s=1.2,
    ready=Mode.OFFBOARD,
    takeoff_altitude=None,
    takeoff_done=0.95,
    limits={
        "horizontal_mps": ("WPNAV_SPEED", 0.01),
        "up_mps": ("WPNAV_SPEED_UP", 0.01),
        "down_mps": ("WPNAV_SPEED_DN", 0.01),
        "acceleration_mps2": ("WPNAV_ACCEL", 0.01),
        "vertical_acceleration_mps2": ("WPNAV_ACCEL_Z", 0.01),
        "jerk_mps3": ("PSC_JERK_XY", 1.0),
    },
    failsafes={"FS_GCS_ENABLE": (1, 2, 3, 4, 5, 6), "MAV_GCS_SYSID": (OWN_SYSTEM,)},
    stream_loss=("GUID_TIMEOUT", 1.0),  # by itself 3 s: 30 m at 10 m/s, and the fence is 10 m from the box
    owners_failsafes={
        "battery_failsafe": (
            Need("BATT_FS_LOW_ACT", among=(1, 2, 3, 4, 6)),
            Need("BATT_MONITOR", above=0),
            Need("BATT_LOW_VOLT", above=0, instead="BATT_LOW_MAH"),
            Need("BATT_LOW_TIMER", above=0, instead="BATT_LOW_MAH"),  # 0: the voltage is not watched
        ),
        "gcs_loss": (Need("FS_GCS_ENABLE", among=(1, 2, 3, 4, 5, 6)),),
        "geofence": (
            Need("FENCE_ENABLE", among=(1,)),
            Need("FENCE_ACTION", among=(1, 2, 3, 4, 5)),
            Need("FENCE_TYPE", among=WITH_CIRCLE_AND_TOP),
        ),
    },
    tilt_max_deg=_tilt_max_deg,
    own_fence=_own_fence,
    battery_acts_at=_battery_acts_at,
    fence_parameters=("FENCE_RADIUS", "FENCE_ALT_MAX", "FENCE_ALT_MIN"),
    int_bytewise=False,
)
