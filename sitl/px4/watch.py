"""What PX4 looks at and tells of: ground station, wind, sticks, battery, fence. What is done, failsafes.py says."""

import math
from collections.abc import Callable

from sitl.flight.battery import Battery
from sitl.flight.control import Setpoint
from sitl.flight.flight_model import FlightModel
from sitl.flight.reference import Vec3, vector
from sitl.geofence import Breach
from sitl.parameters import Parameters
from sitl.personality import CRITICAL, INFO, WARNING
from sitl.px4.failsafes import Conditions
from sitl.px4.failure_detector import FailureDetector
from sitl.px4.fence import CHECK_MS, FenceOfParameters
from sitl.px4.ground import Ground
from sitl.stick_input import StickInput

LOOK_MS = 50
"""How often is looked at what may go wrong, but for the setpoint stream and the sticks."""


class Watch:
    """Remembers what was wrong, so that news is told once."""

    def __init__(
        self,
        p: Parameters,
        model: FlightModel,
        battery: Battery,
        sticks: StickInput,
        fence: FenceOfParameters,
        say: Callable[[str, int], None],
    ) -> None:
        self._p = p
        self._model = model
        self._body = model.body
        self._battery = battery
        self._sticks = sticks
        self._fence = fence
        self._say = say
        self.breach = Breach.NONE
        self._detector = FailureDetector()
        self._due_ms = 0
        self._fence_due_ms = 0
        self._ground_ms: int | None = None
        """When a ground station was heard last."""
        self.ground_lost = True
        self._sticks_optional = True
        """Whether there have been no sticks since arming."""
        self._sticks_lost = False
        self._wind_told = False
        self._battery_level = 0
        self._battery_at_arming = 0

    def arm(self, now_ms: int) -> None:
        """What is as it is at arming is no reason to act later."""
        self._battery_at_arming = self._battery.level
        self._sticks_optional = not self._sticks.alive(now_ms, self._p["COM_RC_LOSS_T"])

    def stop(self) -> None:
        """On the ground nothing breaches the fence."""
        self.breach = Breach.NONE

    def on_ground(self, now_ms: int) -> None:
        """Disarmed: only battery and ground station are told of."""
        if now_ms >= self._due_ms:
            self._due_ms = now_ms + LOOK_MS
            self._watch_battery()
            self._watch_ground_station(now_ms)

    def look(self, before: Conditions, ground: Ground, setpoint: Setpoint | None, now_ms: int) -> Conditions:
        """What is wrong now, but for the stream; as before until it is time to look. `setpoint`: OFFBOARD's."""
        if now_ms < self._due_ms:
            return before
        self._due_ms = now_ms + LOOK_MS
        self._watch_battery()
        self._watch_ground_station(now_ms)
        p, model, flying = self._p, self._model, ground.flying
        since_arming = (now_ms - ground.armed_ms) / 1000.0
        overturned = self._detector.overturned(self._body.attitude, p, now_ms)
        return Conditions(
            stream_lost=before.stream_lost,
            sticks_lost=self._sticks_lost and flying,
            ground_lost=self.ground_lost and flying,
            battery=self._battery_level if flying else 0,
            battery_at_arming=self._battery_at_arming,
            breached=self.breach is not Breach.NONE,
            position_lost=not model.estimator.valid,
            overturned=overturned and not model.wrecked,
            motor_failed=self._detector.motor_failed(model.faults.motors, model.controller.commands, p, now_ms, flying),
            windy=flying and self._watch_wind(),
            overdue=flying and 0.0 < p["COM_FLT_TIME_MAX"] <= (now_ms - ground.lifted_ms) / 1000.0,
            just_armed=since_arming < p["COM_SPOOLUP_TIME"] + p["COM_LKDOWN_TKO"],
            attitude_only=setpoint is not None and math.isfinite(setpoint.thrust),
        )

    def hear_ground(self, now_ms: int) -> None:
        """A heartbeat of a ground station."""
        if self.ground_lost and self._ground_ms is not None:
            self._say("GCS connection regained", INFO)
        self._ground_ms = now_ms
        self.ground_lost = False

    def _watch_ground_station(self, now_ms: int) -> None:
        heard = self._ground_ms
        lost = heard is None or now_ms - heard > self._p["COM_DL_LOSS_T"] * 1000.0
        if lost and not self.ground_lost:
            self._say("Connection to ground station lost", INFO)
        self.ground_lost = lost

    def _watch_wind(self) -> bool:
        """Whether there is more wind than COM_WIND_MAX; COM_WIND_WARN is told, once."""
        p = self._p
        wind = math.hypot(float(self._body.air[0]), float(self._body.air[1]))
        warned = self._wind_told
        self._wind_told = 0.0 < p["COM_WIND_WARN"] < wind
        if self._wind_told and not warned:
            self._say(f"High wind speed detected ({wind:.1f} m/s), landing advised", WARNING)
        return 0.0 < p["COM_WIND_MAX"] < wind

    def _watch_battery(self) -> None:
        """Tell a battery below BAT_LOW_THR, BAT_CRIT_THR, BAT_EMERGEN_THR; what is done is COM_LOW_BAT_ACT."""
        level = self._battery.level
        if level > self._battery_level:
            self._say(("Low battery", "Critical battery", "Emergency battery level")[level - 1], WARNING)
        self._battery_level = level

    def watch_sticks(self, now_ms: int) -> None:
        """Tell sticks that are lost or there again; it is then looked at everything at once."""
        alive = self._sticks.alive(now_ms, self._p["COM_RC_LOSS_T"])
        self._sticks_optional = self._sticks_optional and not alive
        lost = not (alive or self._sticks_optional)
        if lost and not self._sticks_lost:
            self._say("Manual control lost", CRITICAL)
        elif self._sticks_lost and not lost:
            self._say("Manual control regained", INFO)
        if lost != self._sticks_lost:
            self._due_ms = now_ms
        self._sticks_lost = lost

    def watch_fence(self, home: Vec3 | None, flying: bool, now_ms: int) -> bool:
        """See a breach; whether there is a new one that GF_ACTION wants told."""
        if now_ms < self._fence_due_ms or home is None:
            return False
        self._fence_due_ms = now_ms + CHECK_MS
        before = self.breach
        self.breach = self._fence.now().breach(vector(self._body.position), home) if flying else Breach.NONE
        if self.breach is Breach.NONE or before is not Breach.NONE or not self._p["GF_ACTION"]:
            return False
        self._due_ms = now_ms
        return True
