"""PX4's landing detector and takeoff ramp: when the vehicle leaves the ground, and when it is back."""

import math
from collections.abc import Callable

from sitl.flight.control import Setpoint
from sitl.flight.flight_model import FlightModel
from sitl.flight.physics import GRAVITY
from sitl.mission_flight import MissionFlight
from sitl.parameters import Parameters
from sitl.personality import Landed
from sitl.px4.autonomy import Autonomous
from sitl.px4.modes import Mode
from sitl.px4.sticks import AltitudeSticks, PositionSticks

DISARM_PREFLIGHT_EXTRA_S = 1.0
"""Auto-disarm without takeoff was seen at 11 s with COM_DISARM_PRFLT = 10."""
GROUND_NOTICED_S = 1.7
"""From touching the ground until thrust has fallen so far that PX4 takes it for contact, as recorded."""
LOWEST_SHARE = 0.1
"""Of the way from the lowest thrust to the hover thrust: less is the lowest."""
THRUST_ON_GROUND = 0.6
"""Share of the hover thrust below which a vehicle flown by thrust is believed to stay on the ground."""


class Ground:
    """Whether the vehicle stands on the ground; `watch` and `leave` are called once per tick while armed."""

    def __init__(self, p: Parameters, model: FlightModel, say: Callable[[str], None]) -> None:
        self._p = p
        self._model = model
        self._body = model.body
        self._controller = model.controller
        self._say = say
        self.flying = False
        """Whether the control law drives the motors; False on the ground and disarmed."""
        self.has_flown = False
        """Whether it ever left the ground."""
        self.landed = Landed.ON_GROUND
        self.armed_ms = 0
        self.lifted_ms = 0
        """When the last takeoff was detected."""
        self._landed_ms = 0
        self._flown_since_arming = False
        self._ramp_ms: int | None = None
        """Since when the takeoff ramp runs; None when it does not."""
        self._pushes = False
        """Whether a thrust given from outside wants to leave the ground."""

    def arm(self, now_ms: int) -> None:
        self.armed_ms = now_ms
        self._flown_since_arming = False

    def stop(self) -> None:
        """The motors stop."""
        self.flying = False
        self.landed = Landed.ON_GROUND
        self._ramp_ms = None

    def watch(self, mode: Mode, flown: Autonomous, now_ms: int) -> str:
        """Notice takeoff and landing; why the motors are to be stopped, empty when they are not."""
        contact = float(self._body.contact_s[0])
        if self.flying and (contact == 0.0 or self._carried()):
            if not self._flown_since_arming:
                self._flown_since_arming = True
                self.has_flown = True
                self.lifted_ms = now_ms
                self._say("Takeoff detected")
            if mode is Mode.TAKEOFF or (isinstance(flown, MissionFlight) and flown.taking_off):
                self.landed = Landed.TAKEOFF
            elif mode is not Mode.OFFBOARD and flown.landing:
                self.landed = Landed.LANDING
            else:
                self.landed = Landed.IN_AIR
        elif self.flying and self._ramp_ms is None and contact >= GROUND_NOTICED_S + self._p["LNDMC_TRIG_TIME"]:
            wanted_down = float(self._controller.velocity_setpoint[2])
            if self._model.wrecked or (not wanted_down < -0.05 and not self._pushes):
                self.flying = False
                self.landed = Landed.ON_GROUND
                self._landed_ms = now_ms
                self._say("Landing detected")
        return "" if self.flying else self._idle(now_ms)

    def _carried(self) -> bool:
        """Whether a takeoff's thrust is no longer the lowest: takeoff is detected before the vehicle lifts off."""
        thrust = math.sqrt(sum(float(x) ** 2 for x in self._controller.thrust_setpoint))
        lowest, hover = self._p["MPC_THR_MIN"], self._p["MPC_THR_HOVER"]
        return self._ramp_ms is not None and thrust > lowest + LOWEST_SHARE * (hover - lowest)

    def _idle(self, now_ms: int) -> str:
        """Auto-disarm: after landing, or when armed without ever taking off."""
        since_arming = (now_ms - self.armed_ms) / 1000.0
        since_landing = (now_ms - self._landed_ms) / 1000.0
        if self._flown_since_arming:
            return "landing" if 0.0 <= self._p["COM_DISARM_LAND"] <= since_landing else ""
        late = 0.0 <= self._p["COM_DISARM_PRFLT"] <= since_arming - DISARM_PREFLIGHT_EXTRA_S
        return "auto preflight disarming" if late else ""

    def leave(self, setpoint: Setpoint, mode: Mode, flown: Autonomous, now_ms: int) -> Setpoint:
        """Begin the takeoff ramp if the setpoint asks for it; the setpoint within what the ramp allows."""
        if not self.flying and self._wants_up(setpoint, mode, flown, now_ms):
            self.flying = True
            self._ramp_ms = now_ms
        if self.flying:
            setpoint = self._in_ramp(setpoint, now_ms)
        self._pushes = setpoint.thrust > THRUST_ON_GROUND * self._p["MPC_THR_HOVER"]
        return setpoint

    def _wants_up(self, setpoint: Setpoint, mode: Mode, flown: Autonomous, now_ms: int) -> bool:
        """Whether a vehicle on the ground is asked to leave it."""
        if now_ms - self.armed_ms < self._p["COM_SPOOLUP_TIME"] * 1000.0:
            return False
        if mode is Mode.TAKEOFF:
            return True
        if isinstance(flown, MissionFlight):
            return flown.taking_off
        if isinstance(flown, PositionSticks | AltitudeSticks):
            return flown.climbs
        if math.isfinite(setpoint.thrust):
            return setpoint.thrust > THRUST_ON_GROUND * self._p["MPC_THR_HOVER"]
        if mode is not Mode.OFFBOARD:
            return False
        climb = -setpoint.velocity[2] if math.isfinite(setpoint.velocity[2]) else 0.0
        if math.isfinite(setpoint.position[2]):
            climb += (float(self._body.position[2]) - setpoint.position[2]) * self._p["MPC_Z_P"]
        elif not math.isfinite(setpoint.velocity[2]) and math.isfinite(setpoint.acceleration[2]):
            climb = -setpoint.acceleration[2]
        return climb > 0.05

    def _in_ramp(self, setpoint: Setpoint, now_ms: int) -> Setpoint:
        """PX4's takeoff ramp: in MPC_TKO_RAMP_T the climb limit rises from where thrust is zero to its parameter."""
        if self._ramp_ms is None:
            return setpoint._replace(thrust_min=self._p["MPC_THR_MIN"])
        share = (now_ms - self._ramp_ms) / 1000.0 / self._p["MPC_TKO_RAMP_T"]
        if share >= 1.0:
            self._ramp_ms = None
            self._body.contact_s[0] = 0.0
            return setpoint._replace(thrust_min=self._p["MPC_THR_MIN"])
        start = -GRAVITY / self._p["MPC_Z_VEL_P_ACC"]
        return setpoint._replace(climb_max=start + share * (self._p["MPC_Z_VEL_MAX_UP"] - start))
