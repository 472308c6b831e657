"""ArduCopter's landing detector: when the vehicle leaves the ground, when it is back, when its motors may stop."""

from sitl.arducopter.legs import ByPilot, Leg, taking_off
from sitl.arducopter.modes import Mode
from sitl.flight.flight_model import FlightModel
from sitl.mission_flight import MissionFlight
from sitl.parameters import Parameters
from sitl.personality import Landed

LIFT_OFF_MS = 1350
"""From a takeoff until the motors carry: spool-up and TKOFF_SLEW_TIME, as recorded."""
ARMING_DELAY_MS = 2000
"""From arming until the motors may spool up (ARMING_DELAY_SEC), as recorded."""
LANDED_S = 1.6
"""Contact until the landing is believed, as recorded."""
DISARM_LANDED_MS = 440
"""From a landing in RTL or LAND until the motors stop, as recorded."""


class Ground:
    """Whether the vehicle stands on the ground; `watch` is called once per tick while armed."""

    def __init__(self, p: Parameters, model: FlightModel) -> None:
        self._p = p
        self._model = model
        self._body = model.body
        self._controller = model.controller
        self.flying = False
        """Whether the control law drives the motors; False on the ground and disarmed."""
        self.has_flown = False
        """Whether it ever left the ground."""
        self.landed = Landed.ON_GROUND
        self._armed_ms = 0
        self._idle_ms = 0
        """Since when the vehicle stands armed with nothing to do."""
        self._takeoff_ms: int | None = None
        """When a takeoff was asked for, until it leaves the ground."""

    def arm(self, now_ms: int) -> None:
        self._armed_ms = self._idle_ms = now_ms

    def stop(self) -> None:
        """The motors stop."""
        self.flying = False
        self.landed = Landed.ON_GROUND
        self._takeoff_ms = None

    def take_off(self, now_ms: int) -> None:
        """A takeoff is asked for now."""
        self._takeoff_ms = now_ms

    def stay(self) -> None:
        """No takeoff is asked for any more."""
        self._takeoff_ms = None

    def watch(self, leg: Leg, mode: Mode, waits: bool, now_ms: int) -> bool:
        """Notice takeoff and landing; whether the motors are to be stopped. `waits`: the mode stands on the ground."""
        contact = float(self._body.contact_s[0])
        if not self.flying:
            if self._idle(leg, mode, now_ms):
                return True
            if isinstance(leg, ByPilot) and leg.climbs:
                self._lift_off()
            if waits:
                self._takeoff_ms = now_ms
            elif taking_off(leg) and self._takeoff_ms is not None:
                self._idle_ms = now_ms
                if now_ms - max(self._takeoff_ms, self._armed_ms + ARMING_DELAY_MS) >= LIFT_OFF_MS:
                    self._takeoff_ms = None
                    self._lift_off()
        elif contact >= LANDED_S and (self._model.wrecked or not self._wants_up(leg)):
            self.flying = False
            self.landed = Landed.ON_GROUND
            self._idle_ms = now_ms
        elif taking_off(leg):
            self.landed = Landed.TAKEOFF
        else:
            self.landed = Landed.LANDING if leg.landing else Landed.IN_AIR
        self.has_flown = self.has_flown or (self.flying and contact == 0.0)
        return False

    def _lift_off(self) -> None:
        self.flying = True
        self._body.contact_s[0] = 0.0

    def _wants_up(self, leg: Leg) -> bool:
        if isinstance(leg, ByPilot):
            return leg.climbs
        return float(self._controller.velocity_setpoint[2]) < -0.05

    def _idle(self, leg: Leg, mode: Mode, now_ms: int) -> bool:
        """Stop the motors soon after a landing in RTL or LAND, else after DISARM_DELAY."""
        idle = now_ms - self._idle_ms
        came_down = mode in (Mode.RTL, Mode.LAND) or (isinstance(leg, MissionFlight) and (leg.landing or leg.finished))
        delay = self._p["DISARM_DELAY"] * 1000.0
        return (came_down and idle >= DISARM_LANDED_MS) or (0.0 < delay <= idle)
