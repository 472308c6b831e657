"""PX4, as measured (shared/design/AUTOPILOT.md sections 2 and 4)."""

import math

from pymavlink.dialects.v20 import common as mavlink

from autopilot_bridge.dialects import Dialect, Need, OwnFence, Read
from autopilot_bridge.vehicle import Mode

AUTO = 4


def _custom_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


def _own_fence(read: Read) -> OwnFence:
    """0: none."""
    if not read("GF_ACTION"):
        return OwnFence()
    return OwnFence(read("GF_MAX_HOR_DIST") or math.inf, read("GF_MAX_VER_DIST") or math.inf, areas=True)


def _tilt_max_deg(read: Read) -> float:
    return read("MPC_TILTMAX_AIR")


def _battery_acts_at(read: Read) -> float:
    return read("BAT_CRIT_THR") if read("COM_LOW_BAT_ACT") else 0.0


PX4 = Dialect(
    name="px4",
    autopilot=mavlink.MAV_AUTOPILOT_PX4,
    modes={
        _custom_mode(1): (Mode.OTHER, "MANUAL"),
        _custom_mode(2): (Mode.OTHER, "ALTCTL"),
        _custom_mode(3): (Mode.OTHER, "POSCTL"),
        _custom_mode(AUTO, 2): (Mode.TAKEOFF, "AUTO.TAKEOFF"),
        _custom_mode(AUTO, 3): (Mode.HOLD, "AUTO.LOITER"),
        _custom_mode(AUTO, 4): (Mode.OTHER, "AUTO.MISSION"),
        _custom_mode(AUTO, 5): (Mode.RETURN, "AUTO.RTL"),
        _custom_mode(AUTO, 6): (Mode.LAND, "AUTO.LAND"),
        _custom_mode(5): (Mode.OTHER, "ACRO"),
        _custom_mode(6): (Mode.OFFBOARD, "OFFBOARD"),
        _custom_mode(7): (Mode.OTHER, "STABILIZED"),
    },
    commands={Mode.HOLD: (AUTO, 3), Mode.RETURN: (AUTO, 5), Mode.LAND: (AUTO, 6), Mode.OFFBOARD: (6, 0)},
    rates_hz={
        mavlink.MAVLINK_MSG_ID_HEARTBEAT: 10.0,  # the mode: how soon a pilot is obeyed
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20.0,  # one per step, and none of those we do not read
        mavlink.MAVLINK_MSG_ID_ATTITUDE: 20.0,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
        mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
        mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1.0,  # not every link streams it by itself
        mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: 1.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 1.0,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 5.0,
        mavlink.MAVLINK_MSG_ID_ODOMETRY: 1.0,
        mavlink.MAVLINK_MSG_ID_ALTITUDE: 1.0,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 5.0,
        mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED: 5.0,
        mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 1.0,
        mavlink.MAVLINK_MSG_ID_VFR_HUD: 2.0,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    },
    stream_before_offboard_s=0.2,
    lead_s=(0.8, 0.8, 0.4),
    drag_share=0.15,  # 15 deg of tilt at 10 m/s over MPC_XY_VEL_P_ACC, 1.8 /s: what its slow integrator is late with
    reaction_s=0.5,
    ready=Mode.HOLD,
    takeoff_altitude="MIS_TAKEOFF_ALT",
    takeoff_done=0.8,  # it changes to HOLD by itself, once there
    limits={  # no acceleration or jerk: OFFBOARD velocities pass by PX4's smoothing
        "horizontal_mps": ("MPC_XY_VEL_MAX", 1.0),
        "up_mps": ("MPC_Z_VEL_MAX_UP", 1.0),
        "down_mps": ("MPC_Z_VEL_MAX_DN", 1.0),
    },
    failsafes={"COM_OBL_RC_ACT": (3, 4)},
    stream_loss=("COM_OF_LOSS_T", math.inf),  # 1 s by itself; who has made it longer has chosen so
    owners_failsafes={
        "battery_failsafe": (Need("COM_LOW_BAT_ACT", among=(1, 2, 3)),),  # return, land, return or land
        "gcs_loss": (Need("NAV_DLL_ACT", among=(1, 2, 3)),),  # hold, return, land
        "geofence": (
            Need("GF_ACTION", among=(2, 3, 5)),
            Need("GF_MAX_HOR_DIST", above=0),
            Need("GF_MAX_VER_DIST", above=0),
        ),
    },
    tilt_max_deg=_tilt_max_deg,
    own_fence=_own_fence,
    battery_acts_at=_battery_acts_at,
    fence_parameters=("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", ""),
    int_bytewise=True,
)
