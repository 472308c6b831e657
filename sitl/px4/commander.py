"""PX4's commander: arming, flight modes, failsafes and landed state, as PX4 was seen to behave.

Time is vehicle time in milliseconds since boot; nothing here waits. What is to be told to the ground goes to `say`.
"""

import math
from collections.abc import Callable

from sitl.flight.battery import Battery
from sitl.flight.control import Setpoint
from sitl.flight.flight_model import NOTHING, FlightModel
from sitl.flight.physics import heading
from sitl.flight.reference import Reference, Vec3, stopping_point, vector
from sitl.geofence import Breach
from sitl.mission_flight import Fly, MissionFlight
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import CRITICAL, ERROR, INFO, Landed, Result, State
from sitl.plan import Plans
from sitl.px4.arming import BOOT, ArmingChecks
from sitl.px4.autonomy import Autonomous, Descend, Land, Loiter, Return, Takeoff
from sitl.px4.failsafes import Action, Conditions, Failsafe, can_fly, follow
from sitl.px4.fence import FenceOfParameters
from sitl.px4.ground import Ground
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
from sitl.px4.watch import Watch
from sitl.stick_input import StickInput
from sitl.targets import AttitudeTarget, Destination, PositionTarget, Sticks

GROUND_STATION = 6
"""MAV_TYPE_GCS."""

BREACHED = {
    Breach.BOUNDARY: "Geofence: approaching or outside geofence",
    Breach.MAXALT: "Geofence: exceeding maximum altitude above Home",
}
"""PX4's texts; its health checks tell them, without the tab that `say` puts behind."""


class Commander:
    """The vehicle's decisions. `step` is called once per tick, before the physics."""

    def __init__(self, p: Parameters, model: FlightModel, origin: Origin, say: Callable[[str, int], None]) -> None:
        """`say(text, severity)` sends a STATUSTEXT."""
        self._p = p
        self._body = model.body
        self._origin_altitude = origin.altitude
        self.battery = Battery(pack(p))
        self.stream = OffboardStream()
        self.sticks = StickInput()
        self.news: list[str] = []
        self.plans = Plans()
        self.fence = FenceOfParameters(p, self.plans, origin)
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
        self.mode = Mode.LOITER
        """What is flown now."""
        self.intended = Mode.LOITER
        """What the user asked for; a failsafe may fly something else."""
        self._failsafe = Failsafe()
        self._conditions = Conditions()
        self._new_mode = False
        """Whether the user chose a mode that the failsafes have not heard of."""
        self.home: tuple[float, float, float] | None = None
        """NED from the local origin [m]."""
        self._home_yaw = 0.0
        self._autonomous: Autonomous = Loiter(self._body, p)
        self._mode_after_disarm = Mode.LOITER
        self._takeoff_altitude = math.nan
        self.ground = Ground(p, model, self.say)
        self.watch = Watch(p, model, self.battery, self.sticks, self.fence, self.say)
        self._checks = ArmingChecks(p, model, self.battery, self.sticks, self.stream, self.plans)

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
        self.ground.arm(self.now_ms)
        self.watch.arm(self.now_ms)
        self.home = vector(self._body.position)
        self._home_yaw = heading(self._body.attitude)
        self.say(f"Armed by {by}")
        self._enter(self.mode)
        return Result.ACCEPTED

    def why_not_arm(self) -> str:
        """The arming checks: what stands against arming now; empty when nothing does."""
        return self._checks.why_not(self.mode, self.watch.ground_lost, self.now_ms)

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
        if self.armed:
            self._watch_fence()
            self._watch(dt)
        else:
            self.watch.on_ground(self.now_ms)
        if self.armed:  # still: a failsafe may just have stopped the motors
            self._watch_ground()
            self._watch_mission()
        if not self.armed:
            return NOTHING
        setpoint = self._setpoint(dt)
        return self.ground.leave(setpoint, self.mode, self._autonomous, self.now_ms)

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

    @property
    def flying(self) -> bool:
        """Whether the control law drives the motors; False on the ground and disarmed."""
        return self.ground.flying

    @property
    def has_flown(self) -> bool:
        """Whether it ever left the ground."""
        return self.ground.has_flown

    @property
    def landed(self) -> Landed:
        return self.ground.landed

    def _watch_ground(self) -> None:
        why = self.ground.watch(self.mode, self._autonomous, self.now_ms)
        if why:
            self._stop(why)

    def _stop(self, why: str) -> None:
        self.armed = False
        self.ground.stop()
        self.watch.stop()
        self._failsafe = Failsafe()
        self._conditions = Conditions()
        self._new_mode = False
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

    def hear_ground(self, system: int, kind: int) -> None:
        """A heartbeat; one of a ground station keeps the connection alive, whatever its system id."""
        if kind == GROUND_STATION:
            self.watch.hear_ground(self.now_ms)

    def _watch(self, dt: float) -> None:
        """Look at what can go wrong, and fly what the failsafes want."""
        p, now, before = self._p, self.now_ms, self._conditions
        self.watch.watch_sticks(now)
        moved = self._sticks_want_control()
        self._conditions = self.watch.look(before, self.ground, self.stream.setpoint, now)
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

    def _sticks_want_control(self) -> bool:
        """Whether moved sticks want to take over from a failsafe; without one they do so here (COM_RC_OVERRIDE)."""
        p, sticks = self._p, self.sticks
        alive = sticks.alive(self.now_ms, p["COM_RC_LOSS_T"])
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
        if self.watch.watch_fence(self.home, self.flying, self.now_ms):
            self._say(BREACHED[self.watch.breach], CRITICAL)
