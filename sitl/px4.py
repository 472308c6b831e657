"""The PX4 personality: mode numbers, flags, link rates and timings as recorded from PX4's SIH quadrotor."""

from enum import Enum


class Mode(Enum):
    """Flight modes by PX4's name; values are (main mode, sub mode) of `custom_mode`."""

    POSCTL = (3, 0)
    TAKEOFF = (4, 2)
    LOITER = (4, 3)
    MISSION = (4, 4)
    RTL = (4, 5)
    LAND = (4, 6)
    OFFBOARD = (6, 0)


STICK_MAIN_MODES = (1, 2, 5, 7, 8)
"""Main modes that need a pilot's sticks: MANUAL, ALTCTL, ACRO, STABILIZED, RATTITUDE."""

BASE_MODE = {
    Mode.POSCTL: 0x51,
    Mode.TAKEOFF: 0x1D,
    Mode.LOITER: 0x1D,
    Mode.MISSION: 0x1D,
    Mode.RTL: 0x1D,
    Mode.LAND: 0x1D,
    Mode.OFFBOARD: 0x11,
}
"""HEARTBEAT.base_mode while disarmed; armed adds 0x80."""


def custom_mode(mode: Mode) -> int:
    """HEARTBEAT.custom_mode."""
    main, sub = mode.value
    return int(main << 16 | sub << 24)


CAPABILITIES = 0xE8FF
"""AUTOPILOT_VERSION.capabilities."""

# Boot timeline, milliseconds since start.
TELEMETRY_MS = 500
HEARTBEAT_MS = 1000
POSITION_MS = 2000
HOME_MS = 2400
ARMABLE_MS = 4000

# SYS_STATUS bit masks while the estimator has no position, once it has one, and once the vehicle may arm.
SENSORS_PRESENT = (0, 0x0300402D)
SENSORS_ENABLED = (0, 0x0301402D)
SENSORS_HEALTH = (0x2320883F, 0x2320C83F)
PREARM_CHECK = 0x10000000
"""MAV_SYS_STATUS_PREARM_CHECK."""

ESTIMATOR_WAITING = 1152
ESTIMATOR_READY = 831
"""ESTIMATOR_STATUS.flags before a position is known, and after."""

OFFBOARD_SETTLE_MS = 40
"""A setpoint stream must be this old before OFFBOARD may be entered."""
OFFBOARD_LOSS_EXTRA_MS = 50
"""What PX4 takes beyond COM_OF_LOSS_T to see that the stream is gone."""
DISARM_PREFLIGHT_EXTRA_S = 1.0
"""Auto-disarm without takeoff was seen at 11 s with COM_DISARM_PRFLT = 10."""

COMPANION_RATES_HZ = {
    "ATTITUDE": 100.0,
    "HIGHRES_IMU": 50.0,
    "ATTITUDE_QUATERNION": 50.0,
    "GLOBAL_POSITION_INT": 50.0,
    "LOCAL_POSITION_NED": 30.0,
    "ODOMETRY": 30.0,
    "ALTITUDE": 10.0,
    "ATTITUDE_TARGET": 10.0,
    "POSITION_TARGET_LOCAL_NED": 10.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "VFR_HUD": 10.0,
    "GPS_RAW_INT": 8.0,
    "SYS_STATUS": 5.0,
    "EXTENDED_SYS_STATE": 5.0,
    "HEARTBEAT": 1.0,
    "ESTIMATOR_STATUS": 1.0,
    "SYSTEM_TIME": 1.0,
    "HOME_POSITION": 0.5,
    "BATTERY_STATUS": 0.5,
    "CURRENT_MODE": 0.5,
}

GCS_RATES_HZ = {
    "LOCAL_POSITION_NED": 50.0,
    "GLOBAL_POSITION_INT": 50.0,
    "ATTITUDE": 50.0,
    "ATTITUDE_QUATERNION": 50.0,
    "ATTITUDE_TARGET": 50.0,
    "SERVO_OUTPUT_RAW": 50.0,
    "POSITION_TARGET_LOCAL_NED": 50.0,
    "GPS_RAW_INT": 5.0,
    "ALTITUDE": 1.0,
    "VFR_HUD": 1.0,
    "SYS_STATUS": 1.0,
    "EXTENDED_SYS_STATE": 1.0,
    "HEARTBEAT": 1.0,
    "ESTIMATOR_STATUS": 1.0,
    "SYSTEM_TIME": 1.0,
    "HOME_POSITION": 0.5,
    "BATTERY_STATUS": 0.5,
    "CURRENT_MODE": 0.5,
}
