"""MAVLink services of the autopilot, one file each: functions of (vehicle, link, message)."""
