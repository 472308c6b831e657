"""ArduCopter's way from power-on until it may arm, as recorded, and its arming checks; all on vehicle time."""

from sitl.arducopter.fence import FenceOfParameters
from sitl.arducopter.modes import ARMABLE, Mode
from sitl.flight.battery import Battery
from sitl.flight.flight_model import FlightModel
from sitl.flight.reference import Vec3, vector
from sitl.parameters import Parameters
from sitl.personality import INFO, Timeline

ALLOW_ARMING = 1
"""AUTO_OPTIONS: AUTO may be armed in."""

READY_MS = 2450
"""Initialised: telemetry runs, modes are kept."""
HOME_MS = 20_020
"""The estimator has an origin, and that is home."""
GPS_MS = 41_620
"""The estimator uses GPS: there is a position."""
PREARM_MS = 30_450
"""First time that the arming checks are told unasked ..."""
PREARM_PERIOD_MS = 30_000
"""... and again."""

BOOT = Timeline(telemetry_ms=1000, heartbeat_ms=1000, position_ms=GPS_MS, home_ms=HOME_MS, armable_ms=GPS_MS)

CHECKS: tuple[tuple[int, tuple[str, ...]], ...] = (
    (READY_MS, ("System not initialised",)),
    (5800, ("Need Alt Estimate", "Accels inconsistent", "EKF attitude is bad", "AHRS: waiting for home")),
    (13_000, ("Accels inconsistent", "AHRS: waiting for home")),
    (HOME_MS, ("Gyros inconsistent", "AHRS: waiting for home")),
    (23_000, ("Gyros inconsistent", "Need Position Estimate")),
    (GPS_MS, ("Need Position Estimate",)),
)
"""Until when which arming checks fail."""

TEXTS: tuple[tuple[int, str], ...] = (
    (330, "Calibrating barometer"),
    (1920, "Barometer 1 calibration complete"),
    (1920, "Barometer 2 calibration complete"),
    (READY_MS, "ArduPilot Ready"),
    (READY_MS, "AHRS: DCM active"),
    (4450, "EKF3 IMU0 initialised"),
    (4450, "EKF3 IMU1 initialised"),
    (4450, "AHRS: EKF3 active"),
    (5800, "EKF3 IMU0 tilt alignment complete"),
    (5800, "EKF3 IMU1 tilt alignment complete"),
    (5900, "EKF3 IMU0 MAG0 initial yaw alignment complete"),
    (5900, "EKF3 IMU1 MAG0 initial yaw alignment complete"),
    (9830, "GPS 1: detected u-blox"),
    (HOME_MS, "EKF3 IMU0 origin set"),
    (20_220, "EKF3 IMU1 origin set"),
    (GPS_MS, "EKF3 IMU0 is using GPS"),
    (GPS_MS, "EKF3 IMU1 is using GPS"),
)
"""What is said during boot."""
TEXT_SEVERITY = INFO


def failing(now_ms: int) -> tuple[str, ...]:
    """The arming checks of the boot that fail at a time."""
    for until_ms, reasons in CHECKS:
        if now_ms < until_ms:
            return reasons
    return ()


def texts_between(before_ms: int, now_ms: int) -> list[str]:
    """What is said in (before, now]."""
    return [text for at_ms, text in TEXTS if before_ms < at_ms <= now_ms]


class ArmingChecks:
    """What is looked at before the motors may start."""

    def __init__(self, p: Parameters, model: FlightModel, battery: Battery, fence: FenceOfParameters) -> None:
        self._p = p
        self._model = model
        self._battery = battery
        self._fence = fence

    def why_not(self, mode: Mode, home: Vec3 | None, now_ms: int) -> tuple[str, ...]:
        """The arming checks that fail now."""
        if self._p["ARMING_CHECK"]:
            reasons = failing(now_ms)
            if reasons:
                return reasons
            if not self._model.estimator.valid:
                return ("Need Position Estimate",)
            if self._model.wrecked:
                return ("Vehicle has crashed",)
            if self._battery.level >= 2 or self._battery.voltage < self._p["BATT_ARM_VOLT"]:
                return ("Battery 1 below minimum arming voltage",)
            if home is not None and self._fence.now().breach(vector(self._model.body.position), home):
                return ("Vehicle breaching Fence",)
        elif now_ms < READY_MS:
            return ("System not initialised",)
        in_auto = mode is Mode.AUTO and int(self._p["AUTO_OPTIONS"]) & ALLOW_ARMING
        if mode not in ARMABLE and not in_auto:
            return (f"{mode.name} mode not armable",)
        return ()
