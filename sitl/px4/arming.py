"""PX4's boot timeline and arming checks."""

from sitl.flight.battery import Battery
from sitl.flight.flight_model import FlightModel
from sitl.parameters import Parameters
from sitl.personality import Timeline
from sitl.plan import Plans
from sitl.px4.modes import STICKS, Mode
from sitl.px4.offboard import OffboardStream
from sitl.stick_input import StickInput

BOOT = Timeline(telemetry_ms=500, heartbeat_ms=1000, position_ms=2000, home_ms=2400, armable_ms=4000)
THROTTLE_LOW = -0.9
"""Throttle stick at its bottom."""
UNHEALTHY = "Resolve system health failures first"


class ArmingChecks:
    """What is looked at before the motors may start."""

    def __init__(
        self,
        p: Parameters,
        model: FlightModel,
        battery: Battery,
        sticks: StickInput,
        stream: OffboardStream,
        plans: Plans,
    ) -> None:
        self._p = p
        self._model = model
        self._battery = battery
        self._sticks = sticks
        self._stream = stream
        self._plans = plans

    def why_not(self, mode: Mode, ground_lost: bool, now_ms: int) -> str:
        """What stands against arming now; empty when nothing does."""
        p = self._p
        if now_ms < BOOT.armable_ms or not self._model.estimator.valid or self._model.wrecked:
            return UNHEALTHY
        if mode is Mode.OFFBOARD and not self._stream.alive(now_ms, p["COM_OF_LOSS_T"]):
            return UNHEALTHY
        if not p["COM_ARMABLE"] or (p["COM_ARM_MIS_REQ"] and not self._plans.flyable):
            return UNHEALTHY
        if p["NAV_DLL_ACT"] and ground_lost:
            return "no connection to the ground control station"
        if mode in STICKS and self._sticks.alive(now_ms, p["COM_RC_LOSS_T"]):
            return self._why_not_by_sticks(mode)
        if mode in (Mode.RTL, Mode.LAND, *STICKS) or (mode is Mode.MISSION and not self._plans.flyable):
            return "switch to another mode first"
        if self._battery.level >= 2 or self._battery.remaining < p["COM_ARM_BAT_MIN"]:
            return "low battery"
        return ""

    def _why_not_by_sticks(self, mode: Mode) -> str:
        """The throttle must not ask for a climb; where it is thrust, it must be at its bottom."""
        throttle = self._sticks.now.throttle
        if mode is Mode.STABILIZED:
            return "high throttle" if throttle > THROTTLE_LOW else ""
        return "throttle above center" if throttle > self._p["MPC_HOLD_DZ"] else ""
