"""ArduCopter's commander: arming, flight modes, failsafes and landed state, as ArduCopter was seen to behave.

Time is vehicle time in milliseconds since boot; nothing here waits. What is to be told to the ground goes to `say`.
"""

import math
from collections.abc import Callable

from sitl.arducopter import arming, failsafes, fence, guided
from sitl.arducopter.autonomy import BlindLand, Destination, Land, Level, Return, Takeoff, Velocity
from sitl.arducopter.ground import Ground
from sitl.arducopter.guided import Order, understood
from sitl.arducopter.legs import Leg
from sitl.arducopter.missions import Pilot, manners
from sitl.arducopter.modes import Mode, base_mode, mode_of
from sitl.arducopter.sticks import Attitude, LeanSticks, LoiterSticks, attitude_setpoint
from sitl.arducopter.vehicle_setup import pack, shape
from sitl.arducopter.watch import Watch
from sitl.flight.battery import Battery
from sitl.flight.control import Setpoint
from sitl.flight.flight_model import NOTHING, FlightModel
from sitl.flight.physics import heading
from sitl.flight.reference import Vec3, vector
from sitl.geofence import Breach, bent
from sitl.mission_flight import MissionFlight
from sitl.origin import Origin
from sitl.parameters import Parameters
from sitl.personality import CRITICAL, INFO, WARNING, Landed, Result, State
from sitl.plan import PLACES, TAKEOFF, Plans
from sitl.stick_input import StickInput
from sitl.targets import AttitudeTarget, PositionTarget, Sticks
from sitl.targets import Destination as Goal

RAISED = -0.9
"""Throttle stick that is not at its bottom."""

ALLOW_TAKEOFF = 2
"""AUTO_OPTIONS: AUTO takes off without the throttle being raised."""


class Commander:
    """The vehicle's decisions. `step` is called once per tick, before the physics."""

    def __init__(self, p: Parameters, model: FlightModel, origin: Origin, say: Callable[[str, int], None]) -> None:
        """`say(text, severity)` sends a STATUSTEXT."""
        self._p = p
        self._model = model
        self._body = model.body
        self._controller = model.controller
        self._origin = origin
        self._say = say
        self.battery = Battery(pack(p))
        self.plans = Plans(first=1)
        self.fence = fence.FenceOfParameters(p, self.plans, origin)
        self.now_ms = 0
        self.armed = False
        self.mode = Mode.STABILIZE
        self.failsafe = ""
        """What is wrong: `battery`, `fence`, `gcs`, `ekf`, or nothing."""
        self.home: Vec3 | None = None
        self.news: list[str] = []
        """Messages to send to everybody at once, by name."""
        self.order: Order | None = None
        """What GUIDED flies; None until a setpoint came."""
        self._order_ms = 0
        self._leg: Leg = Velocity(self._body, p)
        self._told_ms = 0
        """Until when the texts of the boot have been said."""
        self.sticks = StickInput()
        self._counted = (0, 0)
        self._auto_armed = False
        """Whether AUTO may leave the ground: by MISSION_START, a raised throttle, or once flown."""
        self._mission_changes = 0
        self.ground = Ground(p, model)
        self.watch = Watch(p, model, self.battery, self.fence, self.say)
        self._checks = arming.ArmingChecks(p, model, self.battery, self.fence)
        self._pilot = Pilot(
            self._body, p, origin, home=self._ground, flying=lambda: self.flying, set_home=self.set_home
        )

    def _ground(self) -> Vec3:
        return self.home or (0.0, 0.0, 0.0)

    # What a client can ask for

    def arm(self, force: bool = False) -> Result:
        """Start the motors; every arming check that fails is told. Home becomes where the vehicle stands."""
        if self.armed:
            return Result.ACCEPTED
        reasons = () if force else self.why_not_arm()
        if reasons:
            for reason in reasons:
                self.say(f"Arm: {reason}", CRITICAL)
            return Result.FAILED
        self.armed = True
        self.ground.arm(self.now_ms)
        self.set_home(vector(self._body.position))
        self.say("Arming motors")
        self._enter(self.mode)
        return Result.ACCEPTED

    def why_not_arm(self) -> tuple[str, ...]:
        """The arming checks that fail now."""
        return self._checks.why_not(self.mode, self.home, self.now_ms)

    def disarm(self, force: bool = False) -> Result:
        """Stop the motors; in the air only by force."""
        if not self.armed:
            return Result.ACCEPTED
        if self.flying and not force:
            return Result.FAILED
        self._stop()
        return Result.ACCEPTED

    def takeoff(self, altitude: float) -> Result:
        """In GUIDED, armed and standing: up to an altitude above home [m]."""
        if not self.armed or self.flying or self.mode is not Mode.GUIDED or not 0.0 < altitude <= guided.FAR_M:
            return Result.FAILED
        north, east, _ = vector(self._body.position)
        down = self._ground()[2] - altitude
        if self._outside((north, east, down)):
            return Result.FAILED
        self.order = None
        self._leg = Takeoff(self._body, self._p, down)
        self.ground.take_off(self.now_ms)
        return Result.ACCEPTED

    def land(self) -> Result:
        return self._choose(Mode.LAND)

    def return_home(self) -> Result:
        return self._choose(Mode.RTL)

    def start_mission(self, first: float, last: float) -> Result:
        """MISSION_START: AUTO, which takes off if armed. Part of a mission is DENIED."""
        if first != 0.0 or last != 0.0:
            return Result.DENIED
        taken = self._choose(Mode.AUTO)
        self._auto_armed = self._auto_armed or (taken is Result.ACCEPTED and self.armed)
        return taken

    def set_mode(self, custom_mode: int) -> Result:
        """FAILED for a number that is no mode, and for AUTO without a mission."""
        mode = mode_of(custom_mode)
        if mode is None:
            self.say(f"No such mode {custom_mode}", WARNING)
            return Result.FAILED
        return self._choose(mode)

    def _choose(self, mode: Mode) -> Result:
        if mode is Mode.AUTO and not self.plans.flyable:
            self.say("Mode change to AUTO failed: init failed", WARNING)
            return Result.FAILED
        if mode is Mode.AUTO and self.armed and not self.flying and not self._begins_with_takeoff():
            self.say("Auto: Missing Takeoff Cmd", CRITICAL)
            return Result.FAILED
        if self.armed and mode not in failsafes.WITHOUT_POSITION and not self._model.estimator.valid:
            self.say(f"Mode change to {mode.name} failed: requires position", WARNING)
            return Result.FAILED
        self.failsafe = ""
        if mode is not self.mode:
            self._enter(mode)
        return Result.ACCEPTED

    def _begins_with_takeoff(self) -> bool:
        """Whether the first place of the mission is a takeoff."""
        places = [item.command for item in self.plans.mission[self.plans.current :] if item.command in PLACES]
        return places[:1] == [TAKEOFF]

    def receive_attitude(self, target: AttitudeTarget) -> None:
        """SET_ATTITUDE_TARGET for GUIDED."""
        setpoint = attitude_setpoint(target, self._p)
        if self.mode is Mode.GUIDED and setpoint is not None:
            self._order_ms = self.now_ms
            self.ground.stay()
            self.order = None
            self._leg = Attitude(setpoint)

    def pilot(self, sticks: Sticks | None, radio: bool) -> None:
        """Sticks of any source; without them those of the simulated radio stand in the middle."""
        if sticks is None:
            self.sticks.give_back()
        else:
            self.sticks.receive(sticks, self.now_ms)

    def receive(self, target: PositionTarget) -> None:
        """A setpoint for GUIDED; what means nothing stops the vehicle. It ends a takeoff, and starts none."""
        if self.mode is not Mode.GUIDED:
            return
        order = understood(target, vector(self._body.position), heading(self._body.attitude))
        if order.position is not None and self._outside(order.position):
            return
        self._follow(order)

    def _follow(self, order: Order) -> None:
        """Fly an order of GUIDED."""
        self._order_ms = self.now_ms
        self.ground.stay()
        if order.position is None or order.velocity is not None:
            if not isinstance(self._leg, Velocity):
                self._leg = Velocity(self._body, self._p)
            self._leg.place = order.position
            self._leg.yaw_goal, self._leg.yaw_rate = order.yaw, order.yaw_rate
        elif self.order is None or self.order.position != order.position:
            before = self._leg.reference if isinstance(self._leg, Destination) else None
            self._leg = Destination(self._body, self._p, order.position, order.yaw, nose_first=False)
            self._leg.reference = before or self._leg.reference
        self.order = order

    def reposition(self, goal: Goal) -> Result:
        """DO_REPOSITION: to a place in GUIDED, DENIED outside the fence; without the flag only when in GUIDED."""
        if not self.flying or (self.mode is not Mode.GUIDED and not goal.flags & 1):
            return Result.DENIED
        here = vector(self._body.position)
        north, east, down = (a if math.isfinite(a) else b for a, b in zip(goal.place, here, strict=True))
        if self._outside((north, east, down)):
            return Result.DENIED
        self._choose(Mode.GUIDED)
        self.order = Order((north, east, down), None, goal.yaw, 0.0)
        self._leg = Destination(self._body, self._p, (north, east, down), goal.yaw, speed_cms=goal.speed * 100.0)
        return Result.ACCEPTED

    def change_speed(self, kind: float, speed: float) -> Result:
        """DO_CHANGE_SPEED: of the mission under way, horizontal."""
        if kind not in (0.0, 1.0) or not speed > 0.0:
            return Result.DENIED
        self.plans.speed = speed
        if isinstance(self._leg, MissionFlight):
            self._leg.set_speed(speed)
        return Result.ACCEPTED

    def pause(self, hold: bool) -> Result:
        """DO_PAUSE_CONTINUE: AUTO stays AUTO and brakes, and goes on."""
        if not isinstance(self._leg, MissionFlight):
            return Result.FAILED
        self._leg.pause(hold, self._body)
        return Result.ACCEPTED

    def enable_fence(self, on: bool) -> Result:
        self._p.set("FENCE_ENABLE", float(on))
        return Result.ACCEPTED

    def set_home(self, position_ned: Vec3) -> None:
        self.home = position_ned
        self.news += ["GPS_GLOBAL_ORIGIN", "HOME_POSITION"]

    # What telemetry shows

    @property
    def ready(self) -> bool:
        return self.armed or not self.why_not_arm()

    @property
    def in_mission(self) -> bool:
        return self.mode is Mode.AUTO

    @property
    def system_status(self) -> State:
        if self.now_ms < arming.READY_MS:
            return State.BOOT
        if self.failsafe:
            return State.CRITICAL
        return State.ACTIVE if self.flying else State.STANDBY

    @property
    def base_mode(self) -> int:
        booting = 0x08 if self.now_ms < arming.READY_MS else 0
        return base_mode(self.mode, self.armed) | booting

    @property
    def custom_mode(self) -> int:
        return int(self.mode)

    @property
    def intended_custom_mode(self) -> int:
        return int(self.mode)

    @property
    def destination(self) -> Vec3 | None:
        """The place flown to, if there is one."""
        if isinstance(self._leg, MissionFlight):
            return self._leg.place
        return self._leg.target if isinstance(self._leg, Takeoff | Destination) else None

    @property
    def target(self) -> tuple[Vec3 | None, Vec3]:
        """The place and the velocity that GUIDED flies to."""
        if isinstance(self._leg, Takeoff):
            return self._leg.target, guided.STILL
        if self.order is None:
            return None, guided.STILL
        return self.order.position, self.order.velocity or guided.STILL

    def say(self, text: str, severity: int = INFO) -> None:
        self._say(text, severity)

    # One tick

    def step(self, dt: float) -> Setpoint:
        """Decide what is flown for the coming tick of dt [s]; `flying` tells whether at all."""
        self._boot()
        self._count_plans()
        if self.armed:
            self._watch_failsafes()
            self._watch_fence()
            self._watch_mission()
            self._watch_sticks()
        if self.armed:  # still: a crash or a failsafe may just have stopped the motors
            self._watch_ground()
        setpoint = NOTHING
        if self.armed:
            if isinstance(self._leg, Velocity):
                self._leg.velocity = self._off_the_fence(self._velocity_asked())
            setpoint = self._leg.step(self._body, dt)
        return setpoint

    def _boot(self) -> None:
        """What happens by itself after power-on."""
        now, before = self.now_ms, self._told_ms
        self._told_ms = now
        if now < arming.GPS_MS + 1000:
            for text in arming.texts_between(before, now):
                self.say(text, arming.TEXT_SEVERITY)
            if before < arming.READY_MS <= now and not self.armed:
                self._enter(Mode.STABILIZE)
        if self.home is None and now >= arming.HOME_MS:
            self.set_home(vector(self._body.position))
            self.say(f"Field Elevation Set: {self._origin.altitude:.0f}m")
        since = (now - arming.PREARM_MS) // arming.PREARM_PERIOD_MS
        if not self.armed and since >= 0 and since != (before - arming.PREARM_MS) // arming.PREARM_PERIOD_MS:
            for reason in self.why_not_arm():
                if not reason.endswith("mode not armable"):
                    self.say(f"PreArm: {reason}", CRITICAL)

    def _velocity_asked(self) -> Vec3:
        """What GUIDED was last asked for; zero once GUID_TIMEOUT has passed without a setpoint."""
        if self.order is None or self.order.velocity is None:
            return guided.STILL
        old = self.now_ms - self._order_ms > self._p["GUID_TIMEOUT"] * 1000.0
        return guided.STILL if old else self.order.velocity

    # Modes

    def _enter(self, mode: Mode) -> None:
        if mode is not self.mode:
            self.mode = mode
            self.news.append("HEARTBEAT")
        body, p = self._body, self._p
        self.ground.stay()
        self.order = None
        if mode is Mode.LAND and not self._model.estimator.valid:
            self._leg = BlindLand(body, p, self._ground()[2])
        elif mode is Mode.LAND:
            self._leg = Land(body, p, self._ground()[2])
        elif mode is Mode.RTL:
            self._leg = Return(body, p, self._ground())
        elif mode is Mode.AUTO and self.armed:
            self._mission_changes = self.plans.mission_changes
            self._leg = MissionFlight(body, self.plans, manners(p), self._pilot)
            self.ground.take_off(self.now_ms)
        elif mode in (Mode.STABILIZE, Mode.ALT_HOLD):
            self._leg = Level(body)
        else:
            self._leg = Velocity(body, p)

    def _stop(self) -> None:
        self.armed = False
        self._auto_armed = False
        self.ground.stop()
        self.failsafe = ""
        self.say("Disarming motors")

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
        """AUTO stands on the ground until MISSION_START or a raised throttle."""
        waits = self.mode is Mode.AUTO and not self._auto_armed
        if self.ground.watch(self._leg, self.mode, waits, self.now_ms):
            self._stop()

    # Failsafes and fences

    def _outside(self, place: Vec3) -> bool:
        """Whether a destination is outside the fence."""
        return self.fence.now().breach(place, self._ground()) is not Breach.NONE

    def _off_the_fence(self, velocity: Vec3) -> Vec3:
        """Velocities are bent along the fence (AVOID_ENABLE bit 0)."""
        now = self.fence.now()
        if not now.there or not int(self._p["AVOID_ENABLE"]) & 1:
            return velocity
        limits = shape(self._p)
        place = vector(self._body.position)
        margin, gain = self._p["FENCE_MARGIN"], self._p["PSC_POSXY_P"]
        braking = 0.5 * limits.acceleration_xy  # the other half is kept for what the jerk limit takes
        return bent(velocity, place, self._ground(), now, margin, gain, braking)

    def _watch_fence(self) -> None:
        if not self.watch.fence(self._ground(), self.flying, self.now_ms):
            return
        mode = fence.FLOWN.get(int(self._p["FENCE_ACTION"]))
        if mode is not None and self.mode not in (Mode.RTL, Mode.LAND):
            self.failsafe = "fence"
            self._enter(mode)

    def _watch_mission(self) -> None:
        """A mission that changes under way is begun anew; one that is done or gone leaves the vehicle where it is."""
        if self.mode is Mode.AUTO and self.plans.mission_changes != self._mission_changes:
            self._mission_changes = self.plans.mission_changes
            self._enter(Mode.AUTO if self.plans.flyable else Mode.LOITER)

    def _count_plans(self) -> None:
        """MIS_TOTAL, home included, and FENCE_TOTAL follow what is uploaded."""
        changes = (self.plans.mission_changes, self.plans.fence_changes)
        if changes != self._counted:
            self._counted = changes
            self._p.set("MIS_TOTAL", max(len(self.plans.mission), 1))
            self._p.set("FENCE_TOTAL", len(self.plans.fence))

    def _watch_sticks(self) -> None:
        """Modes for sticks are flown by them while they are there (RC_OVERRIDE_TIME); AUTO waits for the throttle."""
        there = self.sticks.alive(self.now_ms, self._p["RC_OVERRIDE_TIME"])
        raised = there and self.sticks.now.throttle > RAISED
        if raised or self.flying or int(self._p["AUTO_OPTIONS"]) & ALLOW_TAKEOFF:
            self._auto_armed = True
        if isinstance(self._leg, Attitude) and self.now_ms - self._order_ms > self._p["GUID_TIMEOUT"] * 1000.0:
            self._leg = Velocity(self._body, self._p)
        by_sticks = isinstance(self._leg, LoiterSticks | LeanSticks)
        if there and not by_sticks and self.mode in (Mode.LOITER, Mode.POSHOLD):
            self._leg = LoiterSticks(self._body, self._p, self.sticks)
        elif there and not by_sticks and self.mode in (Mode.ALT_HOLD, Mode.STABILIZE):
            self._leg = LeanSticks(self._body, self._p, self.sticks, by_thrust=self.mode is Mode.STABILIZE)
        elif by_sticks and not there:
            self.sticks.give_back()
            self._enter(self.mode)

    def hear_ground(self, system: int, kind: int) -> None:
        """A heartbeat; who has the id MAV_GCS_SYSID is the ground station, whatever `kind` it says."""
        self.watch.hear_ground(system, self.now_ms)

    def _watch_failsafes(self) -> None:
        """What has gone wrong in this tick, and what is done then: BATT_FS_*_ACT, FS_GCS_ENABLE, FS_EKF_ACTION."""
        watch, p, now = self.watch, self._p, self.now_ms
        level = watch.battery()
        if level:
            self._obey("Battery", failsafes.battery(level, p, self._situation()))
        if watch.ground_station(now):
            self._obey("GCS", failsafes.ground_station(p, self._situation()))
        if watch.estimator(now):
            if isinstance(self._leg, Land):
                self._enter(Mode.LAND)
            self._obey("EKF", failsafes.estimator(p, self._situation()))
        if watch.crash(now):
            self._stop()

    def _situation(self) -> failsafes.Situation:
        return failsafes.Situation(self.mode, self.flying, self._model.estimator.valid, self._leg.landing)

    def _obey(self, name: str, response: failsafes.Response) -> None:
        """Tell of a failsafe and do what it asks for."""
        mode = response.mode
        if not (response.note or response.stop or mode is not None):
            return
        self.say(f"{name} Failsafe{' - ' * bool(response.note)}{response.note}", WARNING)
        self.failsafe = name.lower()
        if response.stop:
            self._stop()
        elif mode is not None and mode is not self.mode:
            self._enter(mode)
