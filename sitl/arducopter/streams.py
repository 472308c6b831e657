"""Which messages ArduCopter sends: little by itself, the rest by groups or one by one as clients ask."""

RATES_HZ = {"HEARTBEAT": 1.0, "TIMESYNC": 0.1}
"""Without being asked; TIMESYNC every 10 s as recorded."""

GROUPS: dict[int, tuple[str, ...]] = {
    1: ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3", "SCALED_PRESSURE", "SCALED_PRESSURE2"),
    2: (
        "SYS_STATUS",
        "POWER_STATUS",
        "MCU_STATUS",
        "MEMINFO",
        "MISSION_CURRENT",
        "GPS_RAW_INT",
        "NAV_CONTROLLER_OUTPUT",
        "FENCE_STATUS",
        "POSITION_TARGET_GLOBAL_INT",
    ),
    3: ("SERVO_OUTPUT_RAW", "RC_CHANNELS"),
    6: ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"),
    10: ("ATTITUDE", "SIMSTATE", "AHRS2"),
    11: ("VFR_HUD",),
    12: (
        "AHRS",
        "SYSTEM_TIME",
        "TERRAIN_REPORT",
        "BATTERY_STATUS",
        "EKF_STATUS_REPORT",
        "VIBRATION",
    ),
}
"""MAV_DATA_STREAM -> messages, as ArduCopter groups what its simulator has: 27 kinds in all, and
FENCE_STATUS while the fence is on. 0 stands for all."""
