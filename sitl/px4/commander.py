"""PX4's commander: arming, flight modes, failsafes and landed state, as PX4 was seen to behave.

Time is vehicle time in milliseconds since boot; nothing here waits. What is to be told to the ground goes to `say`.
"""

import math
from collections.abc import Callable

from sitl.flight.battery import Battery
from sitl.flight.control import Setpoint
from sitl.flight.flight_model import NOTHING, FlightModel
from sitl.flight.physics import GRAVITY, heading
from sitl.flight.reference import Reference, Vec3, stopping_point, vector
from sitl.geofence import Breach
from sitl.mission_flight import Fly, MissionFlight
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import CRITICAL, ERROR, INFO, WARNING, Landed, Result, State, Timeline
from sitl.plan import Plans
from sitl.px4.autonomy import Autonomous, Descend, Land, Loiter, Return, Takeoff
from sitl.px4.failsafes import Action, Conditions, Failsafe, can_fly, follow
from sitl.px4.failure_detector import FailureDetector
from sitl.px4.fence import CHECK_MS, FenceOfParameters
from sitl.px4.missions import Pilot, manners
from sitl.px4.modes import BASE_MODE, NAMES, STICK_MAIN_MODES, STICKS, Mode, custom_mode, mode_of
from sitl.px4.offboard import OffboardStream, SetpointRefusedError, flown, flown_attitude, read_target
from sitl.px4.sticks import (
    JOYSTICK_MODES,
    RADIO_MODES,
    AltitudeSticks,
    PositionSticks,
    StabilizedSticks,
)
from sitl.px4.vehicle_setup import pack
from sitl.stick_input import StickInput
from sitl.targets import AttitudeTarget, Destination, PositionTarget, Sticks

BOOT = Timeline(telemetry_ms=500, heartbeat_ms=1000, position_ms=2000, home_ms=2400, armable_ms=4000)
DISARM_PREFLIGHT_EXTRA_S = 1.0
"""Auto-disarm without takeoff was seen at 11 s with COM_DISARM_PRFLT = 10."""

BREACHED = {
    Breach.BOUNDARY: "Geofence: approaching or outside geofence",
    Breach.MAXALT: "Geofence: exceeding maximum altitude above Home",
}
"""PX4's texts."""
GROUND_NOTICED_S = 1.7
"""From touching the ground until thrust has fallen so far that PX4 takes it for contact, as recorded."""
LOWEST_SHARE = 0.1
"""Of the way from the lowest thrust to the hover thrust: less is the lowest."""
THRUST_ON_GROUND = 0.6
"""Share of the hover thrust below which a vehicle flown by thrust is believed to stay on the ground."""
THROTTLE_LOW = -0.9
"""Throttle stick at its bottom."""
LOOK_MS = 50
"""How often is looked at what may go wrong, but for the setpoint stream and the sticks."""


class Commander:
    """The vehicle's decisions. `step` is called once per tick, before the physics."""

    def __init__(self, p: Parameters, model: FlightModel, origin: Origin, say: Callable[[str, int], None]) -> None:
        """`say(text, severity)` sends a STATUSTEXT."""
        self._p = p
        self._model = model
        self._body = model.body
        self._controller = model.controller
        self._origin_altitude = origin.altitude
        self.battery = Battery(pack(p))
        self.stream = OffboardStream()
        self.sticks = StickInput()
        self.news: list[str] = []
        self.plans = Plans()
        self.fence = FenceOfParameters(p, self.plans, origin)
        self.breach = Breach.NONE
        self.breaches = 0
        self._fence_due_ms = 0
        self._pushes = False
        """Whether a thrust given from outside wants to leave the ground."""
        self._mission_changes = 0
        self._judged = (0, 0)
        self._pilot = Pilot(
            self._body,
            p,
            origin,
            home=lambda: self.home or (0.0, 0.0, 0.0),
            flying=lambda: self.flying,
            set_home=self.set_home,
            go_home=self.return_home,
        )
        self._say = say
        self.now_ms = 0
        self.armed = False
        self.flying = False
        """Whether the control law drives the motors; False on the ground and disarmed."""
        self.has_flown = False
        """Whether it ever left the ground."""
        self.landed = Landed.ON_GROUND
        self.mode = Mode.LOITER
        """What is flown now."""
        self.intended = Mode.LOITER
        """What the user asked for; a failsafe may fly something else."""
        self.detector = FailureDetector()
        self._failsafe = Failsafe()
        self._conditions = Conditions()
        self._new_mode = False
        """Whether the user chose a mode that the failsafes have not heard of."""
        self._look_due_ms = 0
        self._ground_ms: int | None = None
        """When a ground station was heard last."""
        self._ground_lost = True
        self._sticks_optional = True
        """Whether there have been no sticks since arming."""
        self._sticks_lost = False
        self._wind_told = False
        self._lifted_ms = 0
        self._battery_at_arming = 0
        self.home: tuple[float, float, float] | None = None
        """NED from the local origin [m]."""
        self._home_yaw = 0.0
        self._autonomous: Autonomous = Loiter(self._body, p)
        self._mode_after_disarm = Mode.LOITER
        self._takeoff_altitude = math.nan
        self._armed_ms = 0
        self._landed_ms = 0
        self._flown_since_arming = False
        self._ramp_ms: int | None = None
        self._battery_level = 0

    # What a client can ask for

    def arm(self, force: bool = False, by: str = "external command") -> Result:
        """Start the motors. Refused before the estimator is ready and in modes that cannot start a flight."""
        if self.armed:
            return Result.ACCEPTED
        if not force:
            reason = self.why_not_arm()
            if reason:
                self.say(f"Arming denied: {reason}", CRITICAL)
                return Result.TEMPORARILY_REJECTED
        self.armed = True
        self._armed_ms = self.now_ms
        self._flown_since_arming = False
        self._battery_at_arming = self.battery.level
        self._sticks_optional = not self.sticks.alive(self.now_ms, self._p["COM_RC_LOSS_T"])
        self.home = vector(self._body.position)
        self._home_yaw = heading(self._body.attitude)
        self.say(f"Armed by {by}")
        self._enter(self.mode)
        return Result.ACCEPTED

    def why_not_arm(self) -> str:
        """The arming checks: what stands against arming now; empty when nothing does."""
        p, unhealthy = self._p, "Resolve system health failures first"
        if self.now_ms < BOOT.armable_ms or not self._model.estimator.valid or self._model.wrecked:
            return unhealthy
        if self.mode is Mode.OFFBOARD and not self.stream.alive(self.now_ms, p["COM_OF_LOSS_T"]):
            return unhealthy
        if not p["COM_ARMABLE"] or (p["COM_ARM_MIS_REQ"] and not self.plans.flyable):
            return unhealthy
        if p["NAV_DLL_ACT"] and self._ground_lost:
            return "no connection to the ground control station"
        if self.mode in STICKS and self.sticks.alive(self.now_ms, self._p["COM_RC_LOSS_T"]):
            return self._why_not_arm_by_sticks()
        if self.mode in (Mode.RTL, Mode.LAND, *STICKS) or (self.mode is Mode.MISSION and not self.plans.flyable):
            return "switch to another mode first"
        if self.battery.level >= 2 or self.battery.remaining < p["COM_ARM_BAT_MIN"]:
            return "low battery"
        return ""

    def _why_not_arm_by_sticks(self) -> str:
        """The throttle must not ask for a climb; where it is thrust, it must be at its bottom."""
        throttle = self.sticks.now.throttle
        if self.mode is Mode.STABILIZED:
            return "high throttle" if throttle > THROTTLE_LOW else ""
        return "throttle above center" if throttle > self._p["MPC_HOLD_DZ"] else ""

    def disarm(self, force: bool = False) -> Result:
        """Stop the motors; in the air only by force."""
        if not self.armed:
            return Result.ACCEPTED
        if self.flying and not force:
            self.say("Disarming denied: not landed", CRITICAL)
            return Result.TEMPORARILY_REJECTED
        self._stop("external command")
        return Result.ACCEPTED

    def takeoff(self, altitude_amsl: float) -> Result:
        """AUTO.TAKEOFF to an altitude above mean sea level [m]; NaN: MIS_TAKEOFF_ALT above home."""
        self._takeoff_altitude = altitude_amsl
        if math.isnan(altitude_amsl):
            self.say(f"Using default takeoff altitude: {self._p['MIS_TAKEOFF_ALT']:.1f} m")
        return self._take(Mode.TAKEOFF)

    def land(self) -> Result:
        return self._choose(Mode.LAND)

    def return_home(self) -> Result:
        return self._choose(Mode.RTL)

    def start_mission(self, first: float, last: float) -> Result:
        """MISSION_START: AUTO.MISSION, armed. The items are looked at, but the mission's own current one is flown."""
        if not self._mission_can_be_flown():
            self.say("Mission start denied! No valid mission", CRITICAL)
            return Result.DENIED
        if not -1.0 <= first < len(self.plans.mission):
            return Result.DENIED
        taken = self._choose(Mode.MISSION)
        return self.arm(by="mission start") if taken is Result.ACCEPTED else taken

    def set_mode(self, custom_mode: int) -> Result:
        """The mode of a HEARTBEAT.custom_mode."""
        if custom_mode >> 16 & 0xFF in STICK_MAIN_MODES:
            self.say("Mode needs manual control, and there is none", CRITICAL)
            return Result.TEMPORARILY_REJECTED
        mode = mode_of(custom_mode)
        return Result.UNSUPPORTED if mode is None else self._choose(mode)

    def _choose(self, mode: Mode) -> Result:
        """Fly a mode. While disarmed every mode is taken; in the air only one that can be flown now."""
        if mode is Mode.MISSION and not self._mission_can_be_flown():
            self.say("Switching to mode 'Mission' is currently not possible", CRITICAL)
            return Result.TEMPORARILY_REJECTED
        if mode is Mode.TAKEOFF:
            return self.takeoff(math.nan)
        if self.armed:
            if mode in STICKS and not self.sticks.alive(self.now_ms, self._p["COM_RC_LOSS_T"]):
                self.say(f"Switching to mode '{NAMES[mode][0]}' is currently not possible", CRITICAL)
                return Result.TEMPORARILY_REJECTED
            streams = mode is not Mode.OFFBOARD or self.stream.ready(self.now_ms, self._p["COM_OF_LOSS_T"])
            if not (streams and can_fly(mode, self._conditions._replace(stream_lost=False))):
                self.say(f"Switching to mode '{NAMES[mode][0]}' is currently not possible", CRITICAL)
                return Result.TEMPORARILY_REJECTED
        return self._take(mode)

    def _mission_can_be_flown(self) -> bool:
        """Whether there is a mission, inside the fence."""
        return self.plans.flyable and self.fence.waypoint_outside(self.home or (0.0, 0.0, 0.0)) is None

    def _judge_plans(self) -> None:
        """A mission that leaves the fence is told of as soon as either is there."""
        changes = (self.plans.mission_changes, self.plans.fence_changes)
        if changes == self._judged or self.home is None:
            return
        self._judged = changes
        outside = self.fence.waypoint_outside(self.home)
        if outside is not None:
            self.say(f"Geofence violation for waypoint {outside}", CRITICAL)

    def reposition(self, goal: Destination) -> Result:
        """Hold somewhere else; PX4 knows only the flag that changes the mode, and wants it."""
        if goal.flags != 1:
            return Result.UNSUPPORTED
        taken = self._choose(Mode.LOITER)
        if taken is not Result.ACCEPTED or not self.flying:
            return taken
        how = manners(self._p)
        moving = Reference(vector(self._body.position), vector(self._body.velocity))
        stop = stopping_point(moving, how.limits)
        north, east, down = (
            wanted if math.isfinite(wanted) else here for wanted, here in zip(goal.place, stop, strict=True)
        )
        if self.fence.now().breach((north, east, down), self.home or (0.0, 0.0, 0.0)):
            self.say("Reposition is outside geofence", CRITICAL)
            return taken
        self._autonomous = Fly(moving, (north, east, down), heading(self._body.attitude), how, goal.yaw)
        self.change_speed(1.0, goal.speed)
        return taken

    def change_speed(self, kind: float, speed: float) -> Result:
        """The cruise speed of missions and of DO_REPOSITION, until the mission is begun anew."""
        self.plans.speed = speed if speed > 0.0 else None
        if isinstance(self._autonomous, Fly | MissionFlight):
            self._autonomous.set_speed(self.plans.speed)
        return Result.ACCEPTED

    def pause(self, hold: bool) -> Result:
        return Result.UNSUPPORTED

    def enable_fence(self, on: bool) -> Result:
        return Result.UNSUPPORTED

    def receive(self, target: PositionTarget) -> None:
        """A setpoint that PX4 would not fly is told by STATUSTEXT and does not keep the stream alive."""
        try:
            understood = read_target(target, heading(self._body.attitude))
        except SetpointRefusedError as error:
            self.say(str(error), ERROR)
            return
        self.stream.receive(flown(understood), self.now_ms, self._p["COM_OF_LOSS_T"])

    def receive_attitude(self, target: AttitudeTarget) -> None:
        """OFFBOARD by attitude or body rates, and thrust."""
        try:
            setpoint = flown_attitude(target)
        except SetpointRefusedError as error:
            self.say(str(error), ERROR)
            return
        self.stream.receive(setpoint, self.now_ms, self._p["COM_OF_LOSS_T"])

    def pilot(self, sticks: Sticks | None, radio: bool) -> None:
        """Sticks of a source that COM_RC_IN_MODE allows."""
        if sticks is not None and int(self._p["COM_RC_IN_MODE"]) in (RADIO_MODES if radio else JOYSTICK_MODES):
            self.sticks.receive(sticks, self.now_ms)

    def set_home(self, position_ned: tuple[float, float, float]) -> None:
        """Another home."""
        self.home = position_ned

    @property
    def ready(self) -> bool:
        """What SYS_STATUS's PREARM_CHECK bit says: it may arm, or flies and nothing is wrong."""
        return not self.failsafe if self.armed else not self.why_not_arm()

    @property
    def system_status(self) -> State:
        if self.armed:
            return State.ACTIVE if self.ready else State.CRITICAL
        return State.STANDBY if self.ready else State.UNINIT

    @property
    def base_mode(self) -> int:
        return BASE_MODE[self.mode] | (0x80 if self.armed else 0)

    @property
    def custom_mode(self) -> int:
        return custom_mode(self.mode)

    @property
    def in_mission(self) -> bool:
        return self.mode is Mode.MISSION

    @property
    def intended_custom_mode(self) -> int:
        return custom_mode(self.intended)

    @property
    def destination(self) -> Vec3 | None:
        """The place flown to by a mode that flies by itself."""
        flown = self._autonomous
        if self.mode is Mode.OFFBOARD or not self.armed:
            return None
        if isinstance(flown, MissionFlight):
            return flown.place
        return flown.target if isinstance(flown, Loiter | Takeoff | Return | Fly) else None

    def say(self, text: str, severity: int = INFO) -> None:
        """Tell the ground; PX4 ends its texts with a tab where an event carries the same news."""
        self._say(f"{text}\t", severity)

    # One tick

    def step(self, dt: float) -> Setpoint:
        """Decide what is flown for the coming tick of dt [s]; `flying` tells whether at all."""
        if self.home is None and self.now_ms >= BOOT.home_ms:
            self.home = vector(self._body.position)
            self.news.append("HOME_POSITION")
        self._judge_plans()
        if not self.armed and self.now_ms >= self._look_due_ms:
            self._look_due_ms = self.now_ms + LOOK_MS
            self._watch_battery()
            self._watch_ground_station()
        if self.armed:
            self._watch_fence()
            self._watch(dt)
            self._watch_ground()
            self._watch_mission()
        setpoint = self._setpoint(dt) if self.armed else NOTHING
        if self.armed and not self.flying and self._wants_up(setpoint):
            self._start_ramp()
        if self.flying:
            setpoint = self._in_ramp(setpoint)
        self._pushes = setpoint.thrust > THRUST_ON_GROUND * self._p["MPC_THR_HOVER"]
        return setpoint

    def _setpoint(self, dt: float) -> Setpoint:
        if self.mode is Mode.OFFBOARD:
            return self.stream.setpoint or NOTHING
        flown = self._autonomous
        setpoint = flown.step(self._body, dt)
        if isinstance(flown, Takeoff) and flown.done and self.intended is Mode.TAKEOFF:
            if self._p["COM_TAKEOFF_ACT"] and self._mission_can_be_flown():
                self._take(Mode.MISSION)
                return setpoint
            self._take(Mode.LOITER)
            self._autonomous = Loiter(self._body, self._p, flown.target)
        elif isinstance(flown, MissionFlight) and flown.finished and self.mode is Mode.MISSION and self.flying:
            self.say("Mission finished, loitering")
            self._take(Mode.LOITER)
            self._autonomous = Loiter(self._body, self._p, flown.place)
        return setpoint

    # Modes

    def _take(self, mode: Mode) -> Result:
        """The user's will: flown now, and kept against a failsafe that comes later."""
        self._intend(mode)
        self._new_mode = True
        if mode is Mode.RTL:
            self.say("Returning to launch")
        elif mode is Mode.LAND:
            self.say("Landing at current position")
        self._enter(mode)
        return Result.ACCEPTED

    def _intend(self, mode: Mode) -> None:
        self.intended = mode
        if mode not in (Mode.TAKEOFF, Mode.MISSION, Mode.RTL, Mode.LAND):
            self._mode_after_disarm = mode

    def _enter(self, mode: Mode) -> None:
        self.mode = mode
        body, p = self._body, self._p
        home = self.home or (0.0, 0.0, 0.0)
        if mode is Mode.TAKEOFF:
            target = home[2] - p["MIS_TAKEOFF_ALT"]
            if math.isfinite(self._takeoff_altitude):
                target = self._origin_altitude - self._takeoff_altitude
            # Never down: a takeoff to below where the vehicle is, stays.
            self._autonomous = Takeoff(body, p, min(target, float(body.position[2])), home[2], lambda: self.flying)
        elif mode is Mode.LAND:
            self._autonomous = Land(body, p, home[2])
        elif mode is Mode.DESCEND:
            self._autonomous = Descend(body, p, landing=True)
        elif mode is Mode.RTL and self.armed:
            self._autonomous = Return(body, p, home, self._home_yaw, self._origin_altitude - home[2], self.say)
        elif mode in STICKS:
            self._autonomous = self._by_sticks(mode)
        elif mode is Mode.MISSION and self.armed:
            self._mission_changes = self.plans.mission_changes
            self._autonomous = MissionFlight(body, self.plans, manners(p), self._pilot)
        else:
            self._autonomous = Loiter(body, p)

    def _by_sticks(self, mode: Mode) -> Autonomous:
        """A mode flown by sticks; without them it sinks."""
        if not self.sticks.alive(self.now_ms, self._p["COM_RC_LOSS_T"]):
            return Descend(self._body, self._p)
        if mode is Mode.POSCTL:
            return PositionSticks(self._body, self._p, self.sticks)
        kind = AltitudeSticks if mode is Mode.ALTCTL else StabilizedSticks
        return kind(self._body, self._p, self.sticks)

    # Leaving and meeting the ground

    def _wants_up(self, setpoint: Setpoint) -> bool:
        """Whether a vehicle on the ground is asked to leave it."""
        if self.now_ms - self._armed_ms < self._p["COM_SPOOLUP_TIME"] * 1000.0:
            return False
        if self.mode is Mode.TAKEOFF:
            return True
        if isinstance(self._autonomous, MissionFlight):
            return self._autonomous.taking_off
        if isinstance(self._autonomous, PositionSticks | AltitudeSticks):
            return self._autonomous.climbs
        if math.isfinite(setpoint.thrust):
            return setpoint.thrust > THRUST_ON_GROUND * self._p["MPC_THR_HOVER"]
        if self.mode is not Mode.OFFBOARD:
            return False
        climb = -setpoint.velocity[2] if math.isfinite(setpoint.velocity[2]) else 0.0
        if math.isfinite(setpoint.position[2]):
            climb += (float(self._body.position[2]) - setpoint.position[2]) * self._p["MPC_Z_P"]
        elif not math.isfinite(setpoint.velocity[2]) and math.isfinite(setpoint.acceleration[2]):
            climb = -setpoint.acceleration[2]
        return climb > 0.05

    def _start_ramp(self) -> None:
        self.flying = True
        self._ramp_ms = self.now_ms

    def _in_ramp(self, setpoint: Setpoint) -> Setpoint:
        """PX4's takeoff ramp: in MPC_TKO_RAMP_T the climb limit rises from where thrust is zero to its parameter."""
        if self._ramp_ms is None:
            return setpoint._replace(thrust_min=self._p["MPC_THR_MIN"])
        share = (self.now_ms - self._ramp_ms) / 1000.0 / self._p["MPC_TKO_RAMP_T"]
        if share >= 1.0:
            self._ramp_ms = None
            self._body.contact_s[0] = 0.0
            return setpoint._replace(thrust_min=self._p["MPC_THR_MIN"])
        start = -GRAVITY / self._p["MPC_Z_VEL_P_ACC"]
        return setpoint._replace(climb_max=start + share * (self._p["MPC_Z_VEL_MAX_UP"] - start))

    def _watch_ground(self) -> None:
        contact = float(self._body.contact_s[0])
        if self.flying and (contact == 0.0 or self._carried()):
            if not self._flown_since_arming:
                self._flown_since_arming = True
                self.has_flown = True
                self._lifted_ms = self.now_ms
                self.say("Takeoff detected")
            if self.mode is Mode.TAKEOFF or (
                isinstance(self._autonomous, MissionFlight) and self._autonomous.taking_off
            ):
                self.landed = Landed.TAKEOFF
            elif self.mode is not Mode.OFFBOARD and self._autonomous.landing:
                self.landed = Landed.LANDING
            else:
                self.landed = Landed.IN_AIR
        elif self.flying and self._ramp_ms is None and contact >= GROUND_NOTICED_S + self._p["LNDMC_TRIG_TIME"]:
            wanted_down = float(self._controller.velocity_setpoint[2])
            if self._model.wrecked or (not wanted_down < -0.05 and not self._pushes):
                self.flying = False
                self.landed = Landed.ON_GROUND
                self._landed_ms = self.now_ms
                self.say("Landing detected")
        if not self.flying:
            self._watch_idle()

    def _carried(self) -> bool:
        """Whether a takeoff's thrust is no longer the lowest: takeoff is detected before the vehicle lifts off."""
        thrust = math.sqrt(sum(float(x) ** 2 for x in self._controller.thrust_setpoint))
        lowest, hover = self._p["MPC_THR_MIN"], self._p["MPC_THR_HOVER"]
        return self._ramp_ms is not None and thrust > lowest + LOWEST_SHARE * (hover - lowest)

    def _watch_idle(self) -> None:
        """Auto-disarm: after landing, or when armed without ever taking off."""
        since_arming = (self.now_ms - self._armed_ms) / 1000.0
        since_landing = (self.now_ms - self._landed_ms) / 1000.0
        if self._flown_since_arming:
            if 0.0 <= self._p["COM_DISARM_LAND"] <= since_landing:
                self._stop("landing")
        elif 0.0 <= self._p["COM_DISARM_PRFLT"] <= since_arming - DISARM_PREFLIGHT_EXTRA_S:
            self._stop("auto preflight disarming")

    def _stop(self, why: str) -> None:
        self.armed = False
        self.flying = False
        self.landed = Landed.ON_GROUND
        self._failsafe = Failsafe()
        self._conditions = Conditions()
        self._new_mode = False
        self._ramp_ms = None
        self.breach = Breach.NONE
        self.say(f"Disarmed by {why}")
        self.intended = self._mode_after_disarm
        self._enter(self.intended)

    def _watch_mission(self) -> None:
        """A mission that changes under way is begun anew; one that is gone leaves the vehicle where it is."""
        if self.mode is Mode.MISSION and self.plans.mission_changes != self._mission_changes:
            self._mission_changes = self.plans.mission_changes
            if self.plans.flyable:
                self._enter(Mode.MISSION)
            else:
                self._take(Mode.LOITER)

    # Failsafes

    @property
    def failsafe(self) -> str:
        """What is wrong and acted on; empty when nothing is."""
        return self._failsafe.cause if self._failsafe.action > Action.WARN else ""

    def hear_ground(self, system: int) -> None:
        """A heartbeat of a ground station."""
        if self._ground_lost and self._ground_ms is not None:
            self.say("GCS connection regained")
        self._ground_ms = self.now_ms
        self._ground_lost = False

    def _watch(self, dt: float) -> None:
        """Look at what can go wrong, and fly what the failsafes want."""
        p, now, before = self._p, self.now_ms, self._conditions
        moved = self._watch_sticks()
        if now >= self._look_due_ms:
            self._look_due_ms = now + LOOK_MS
            self._conditions = self._look()
        offboard = self.intended is Mode.OFFBOARD
        stream_lost = offboard and not self.stream.alive(now, p["COM_OF_LOSS_T"])
        if stream_lost != self._conditions.stream_lost:
            self._conditions = self._conditions._replace(stream_lost=stream_lost)
        if self._conditions == before and not self._new_mode and not moved and self._failsafe.idle:
            return
        was = self._failsafe
        self._failsafe = follow(was, self._conditions, self.intended, p, dt, self._new_mode, moved)
        self._new_mode = False
        if self._failsafe.by_sticks:
            self.say("Pilot took over using sticks")
            self._intend(Mode.POSCTL)
        self._act(was.action)

    def _act(self, before: Action) -> None:
        """Fly what was decided, and tell when it is worse than before."""
        action = self._failsafe.action
        if action > max(before, Action.WARN):
            hold = f", entering Hold for {self._failsafe.delay_s:.0f} seconds" if self._failsafe.waits else ""
            self.say(f"Failsafe activated{hold}", CRITICAL)
        mode = self._failsafe.mode(self.intended)
        if action in (Action.DISARM, Action.TERMINATE):
            self._stop("failsafe" if action is Action.DISARM else "flight termination")
        elif mode is not self.mode or (action is Action.HOLD and before is not Action.HOLD):
            self._enter(mode)

    def _look(self) -> Conditions:
        """What is wrong now, but for what is looked at in every tick."""
        p, flying = self._p, self.flying
        self._watch_battery()
        self._watch_ground_station()
        since_arming = (self.now_ms - self._armed_ms) / 1000.0
        overturned = self.detector.overturned(self._body.attitude, p, self.now_ms)
        setpoint = self.stream.setpoint
        return Conditions(
            stream_lost=self._conditions.stream_lost,
            sticks_lost=self._sticks_lost and flying,
            ground_lost=self._ground_lost and flying,
            battery=self._battery_level if flying else 0,
            battery_at_arming=self._battery_at_arming,
            breached=self.breach is not Breach.NONE,
            position_lost=not self._model.estimator.valid,
            overturned=overturned and not self._model.wrecked,
            motor_failed=self.detector.motor_failed(
                self._model.faults.motors, self._controller.commands, p, self.now_ms, flying
            ),
            windy=flying and self._watch_wind(),
            overdue=flying and 0.0 < p["COM_FLT_TIME_MAX"] <= (self.now_ms - self._lifted_ms) / 1000.0,
            just_armed=since_arming < p["COM_SPOOLUP_TIME"] + p["COM_LKDOWN_TKO"],
            attitude_only=setpoint is not None and math.isfinite(setpoint.thrust),
        )

    def _watch_ground_station(self) -> None:
        heard = self._ground_ms
        lost = heard is None or self.now_ms - heard > self._p["COM_DL_LOSS_T"] * 1000.0
        if lost and not self._ground_lost:
            self.say("Connection to ground station lost")
        self._ground_lost = lost

    def _watch_wind(self) -> bool:
        """Whether there is more wind than COM_WIND_MAX; COM_WIND_WARN is told, once."""
        p = self._p
        wind = math.hypot(float(self._body.air[0]), float(self._body.air[1]))
        warned = self._wind_told
        self._wind_told = 0.0 < p["COM_WIND_WARN"] < wind
        if self._wind_told and not warned:
            self.say(f"High wind speed detected ({wind:.1f} m/s), landing advised", WARNING)
        return 0.0 < p["COM_WIND_MAX"] < wind

    def _watch_sticks(self) -> bool:
        """Whether moved sticks want to take over from a failsafe; without one they do so here (COM_RC_OVERRIDE)."""
        p, sticks = self._p, self.sticks
        alive = sticks.alive(self.now_ms, p["COM_RC_LOSS_T"])
        self._sticks_optional = self._sticks_optional and not alive
        lost = not (alive or self._sticks_optional)
        if lost and not self._sticks_lost:
            self.say("Manual control lost", CRITICAL)
        elif self._sticks_lost and not lost:
            self.say("Manual control regained")
        if lost != self._sticks_lost:
            self._look_due_ms = self.now_ms
        self._sticks_lost = lost
        if not (alive and self.flying and self.mode not in STICKS and sticks.moved(p["COM_RC_STICK_OV"] / 100.0)):
            return False
        if not int(p["COM_RC_OVERRIDE"]) & (2 if self.mode is Mode.OFFBOARD else 1):
            return False
        if self._failsafe.action > Action.WARN:
            return True
        self.say("Pilot took over using sticks")
        self._take(Mode.POSCTL)
        return False

    def _watch_fence(self) -> None:
        """See and tell a breach; what is done is GF_ACTION."""
        if self.now_ms < self._fence_due_ms or self.home is None:
            return
        self._fence_due_ms = self.now_ms + CHECK_MS
        before = self.breach
        self.breach = self.fence.now().breach(vector(self._body.position), self.home) if self.flying else Breach.NONE
        if self.breach is Breach.NONE or before is not Breach.NONE or not self._p["GF_ACTION"]:
            return
        self.breaches += 1
        self._look_due_ms = self.now_ms
        self._say(BREACHED[self.breach], CRITICAL)

    def _watch_battery(self) -> None:
        """Tell a battery below BAT_LOW_THR, BAT_CRIT_THR, BAT_EMERGEN_THR; what is done is COM_LOW_BAT_ACT."""
        level = self.battery.level
        if level > self._battery_level:
            self.say(("Low battery", "Critical battery", "Emergency battery level")[level - 1], WARNING)
        self._battery_level = level
