"""What ArduCopter looks at and tells of: battery, ground station, estimator, crash, fence; failsafes.py says what then.

Each is news once: a method answers whether what it looks at has gone wrong in this tick.
"""

from collections.abc import Callable

from sitl.arducopter import failsafes, fence
from sitl.flight.battery import Battery
from sitl.flight.flight_model import FlightModel
from sitl.flight.reference import Vec3, vector
from sitl.geofence import Breach
from sitl.parameters import Parameters
from sitl.personality import CRITICAL, WARNING

FENCE_CHECK_MS = 200
EMERGENCY, NOTICE = 0, 5


class Watch:
    """Remembers what was wrong."""

    def __init__(
        self,
        p: Parameters,
        model: FlightModel,
        battery: Battery,
        fence_now: fence.FenceOfParameters,
        say: Callable[[str, int], None],
    ) -> None:
        self._p = p
        self._model = model
        self._battery = battery
        self._fence = fence_now
        self._say = say
        self.breach = Breach.NONE
        self.breaches = 0
        self._fence_due_ms = 0
        self._battery_level = 0
        self._ground_ms: int | None = None
        """When the ground station (MAV_GCS_SYSID) was heard last."""
        self._ground_lost = False
        self._located_ms = 0
        """When there was a position last."""
        self._position_lost = False
        self._crashed_ms: int | None = None

    def battery(self) -> int:
        """The level that the battery has come down to now; 0 when it has not."""
        level = self._battery.level
        if level <= self._battery_level:
            return 0
        self._battery_level = level
        kind = "low" if level == 1 else "critical"
        used = (1.0 - self._battery.remaining) * self._battery.pack.capacity_mah
        self._say(f"Battery 1 is {kind} {self._battery.voltage:.2f}V used {used:.0f} mAh", CRITICAL)
        return level

    def hear_ground(self, system: int, now_ms: int) -> None:
        """A heartbeat of a ground station; only one of MAV_GCS_SYSID counts."""
        if system != int(self._p["MAV_GCS_SYSID"]):
            return
        self._ground_ms = now_ms
        if self._ground_lost:
            self._ground_lost = False
            self._say("GCS Failsafe Cleared", WARNING)

    def ground_station(self, now_ms: int) -> bool:
        """FS_GCS_ENABLE, FS_GCS_TIMEOUT: a ground station that was there and is silent."""
        p = self._p
        if self._ground_lost or self._ground_ms is None or not p["FS_GCS_ENABLE"]:
            return False
        self._ground_lost = now_ms - self._ground_ms > p["FS_GCS_TIMEOUT"] * 1000.0
        return self._ground_lost

    def estimator(self, now_ms: int) -> bool:
        """There has been no position for a second (FS_EKF_THRESH 0: never)."""
        if self._model.estimator.valid:
            if self._position_lost:
                self._say("EKF Failsafe Cleared", CRITICAL)
            self._located_ms, self._position_lost = now_ms, False
            return False
        if self._position_lost or not self._p["FS_EKF_THRESH"]:
            return False
        self._position_lost = now_ms - self._located_ms >= failsafes.ESTIMATOR_MS
        if self._position_lost:
            self._say("EKF variance", CRITICAL)
        return self._position_lost

    def crash(self, now_ms: int) -> bool:
        """FS_CRASH_CHECK: the vehicle lies on its back."""
        if not (self._model.wrecked and self._p["FS_CRASH_CHECK"]):
            self._crashed_ms = None
            return False
        if self._crashed_ms is None:
            self._crashed_ms = now_ms
            return False
        if now_ms - self._crashed_ms < failsafes.CRASH_MS:
            return False
        self._say("Crash: Disarming: AngErr=180>30, Accel=0.0<3.0", EMERGENCY)
        return True

    def fence(self, home: Vec3, flying: bool, now_ms: int) -> bool:
        """A breach that was not there before."""
        if now_ms < self._fence_due_ms:
            return False
        self._fence_due_ms = now_ms + FENCE_CHECK_MS
        before = self.breach
        here = vector(self._model.body.position)
        self.breach = self._fence.now().breach(here, home) if flying else Breach.NONE
        if self.breach is Breach.NONE or before is not Breach.NONE:
            return False
        self.breaches += 1
        self._say(f"{fence.NAMES[self.breach]} fence breached", NOTICE)
        return True
