"""One flight, from the first heartbeat to the ground.

Phases:

    connecting -> preflight -> ready -> arming -> takeoff -> transit -> slots -> returning | landing -> ended

    transit | slots <-> holding      `hold` and `resume`; in the slots also whenever there is no action to fly
    takeoff .. slots -> yielded      a mode change by autopilot or pilot: no setpoints until `resume`, which takes
                                     control again, or `return`, `land`, or the ground

The phases are plain sequential code on one thread. Every wait in them is a step of the `Loop`; what ends a phase early
is raised from there.
"""

import contextlib
import time
from collections.abc import Callable, Sequence

import numpy as np

from airframe.slot_profile import brake
from autopilot_bridge import preflight
from autopilot_bridge.clock import Clock
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.deadman import Rung
from autopilot_bridge.endings import AS_PLANNED, ERROR, FAILSAFE, End, Yielded, in_our_code
from autopilot_bridge.flight_parameters import FlightParameters
from autopilot_bridge.ground import Ground
from autopilot_bridge.link import LinkError
from autopilot_bridge.loop import Loop, rounded
from autopilot_bridge.parameter_journal import JournalError, ParameterJournal, journal_name, state_folder
from autopilot_bridge.separation import Track
from autopilot_bridge.slots import Slots, vec3
from autopilot_bridge.takeoff import Takeoff
from autopilot_bridge.transit import Transit
from autopilot_bridge.vehicle import Mode, SilentError, Vehicle, VehicleError

ARRIVED_M, ARRIVED_MPS = 0.3, 0.2
SETTLE_S = 20.0
"""Vehicle time that the vehicle may need to arrive once its reference has."""
COME_DOWN_S = 600.0
"""Vehicle time that coming down may take besides the return."""
AGAIN_S = 10.0
"""Vehicle time after which a landing that did not come about is asked for again."""
PUT_BACK_S = 5.0
"""Vehicle time after the disarming in which the autopilot must say that it is on the ground."""
DISARM_S = 10.0
"""Vehicle time on the ground after which we disarm if the autopilot has not."""
LINK_BACK_WALL_S = 60.0


class Flight:
    """Flies `config` once. `make_vehicle(wait)` builds the vehicle; it calls `wait` to let vehicle time pass."""

    def __init__(
        self,
        config: BridgeConfig,
        ground: Ground,
        clock: Clock,
        make_vehicle: Callable[[Callable[[], None]], Vehicle],
        others: Callable[[], Sequence[Track]] = tuple,
    ) -> None:
        """`others()` tells where the vehicles are that this one must keep apart from."""
        self._config, self._clock = config, clock
        self._loop = Loop(config, ground, clock, make_vehicle, others)
        self._vehicle, self._helm = self._loop.vehicle, self._loop.helm
        self._parameters: FlightParameters | None = None

    @property
    def down(self) -> bool:
        """Whether the vehicle is on the ground and disarmed, as far as we know."""
        return self._loop.down

    def run(self) -> int:
        """The exit code. Never raises on account of vehicle, link or commands."""
        try:
            code = self._fly()
        except (LinkError, VehicleError, JournalError) as error:
            code = ERROR
            self._loop.tell("error", str(error))
        except End as end:
            code = end.code
            self._loop.tell("error" if code == ERROR else "failsafe", str(end))
        self._put_back()
        self._loop.end()
        return code

    # The phases.

    def _fly(self) -> int:
        self._loop.tell("phase", self._loop.phase)
        self._vehicle.connect()
        self._preflight()
        self._await_start()
        try:
            self._fly_slots()
            ending = End(Mode.RETURN if self._config.at_end == "return" else Mode.LAND, AS_PLANNED, "all slots flown")
            self._loop.tell("slots", str(ending))
        except End as end:
            ending = end
            self._loop.tell("failsafe", str(end))
        except SilentError as error:
            ending = self._await_link(error)
        except VehicleError as error:
            if self.down:
                raise
            ending = End(self._way_down, FAILSAFE, str(error))
            self._loop.tell("failsafe", str(error))
        except LinkError:
            raise
        except Exception as error:  # what nobody thought of must not end it in the air
            if self.down:
                raise
            ending = End(self._way_down, ERROR, in_our_code(error))
            self._loop.tell("error", str(ending))
        code = self._come_down(ending)
        return ERROR if ending.code == ERROR else code

    @property
    def _way_down(self) -> Mode | None:
        """After a mistake; somebody else's vehicle comes down as he likes."""
        return None if self._loop.phase == "yielded" else Mode.RETURN

    def _preflight(self) -> None:
        self._loop.enter("preflight")
        config, vehicle = self._config, self._vehicle
        self._parameters = FlightParameters(vehicle, self._journal(), self._loop.tell)
        self._helm.stay_within(preflight.clear(config, vehicle, self._parameters, self._loop.tell))
        if not vehicle.telemetry.armable:
            self._loop.tell("preflight", f"waiting until it can be armed{self._unwell}")
        vehicle.await_armable()
        preflight.clear_of_uploaded_fence(config, vehicle, self._loop.tell)
        if not vehicle.telemetry.armable:
            self._loop.tell("preflight", f"it cannot be armed{self._unwell}")
        self._check_energy()

    def _journal(self) -> ParameterJournal | None:
        """Raises JournalError."""
        config = self._config
        if not config.put_back:
            return None
        name = journal_name(self._vehicle.hardware_uid, config.autopilot, config.system_id)
        return ParameterJournal((config.state_folder or state_folder()) / name)

    @property
    def _unwell(self) -> str:
        unhealthy = self._vehicle.telemetry.unhealthy
        return f": not well: {', '.join(unhealthy)}" if unhealthy else ""

    def _check_energy(self) -> None:
        """Raises VehicleError when there is none to fly to the start position and home."""
        endurance, battery = self._config.endurance, self._vehicle.telemetry.battery_remaining
        if endurance is None:
            return
        if battery is None:
            raise VehicleError("battery: the autopilot does not tell what remains of it, which `endurance` needs")
        left_j, needed_j = self._helm.left_j(endurance), endurance.needed_j(np.array(self._config.start_position_enu))
        if left_j < needed_j:
            raise VehicleError(
                f"battery: {left_j / 1e3:.1f} kJ are left, the way home from the start needs {needed_j / 1e3:.1f} kJ"
            )

    def _put_back(self) -> None:
        """The parameters set for the flight, if the vehicle is down and heard."""
        parameters = self._parameters
        if parameters is None:
            return
        self._release()
        self._loop.expected = set()
        with contextlib.closing(parameters):
            until = self._clock.now + PUT_BACK_S
            while parameters.outstanding:
                try:
                    while self.down and not self._vehicle.telemetry.landed and self._clock.now < until:
                        self._loop.step()
                    if not (self.down and self._vehicle.telemetry.landed):
                        parameters.leave("the vehicle is not on the ground and disarmed")
                        return
                    parameters.put_back()
                    return
                except End:
                    continue  # a command that came too late
                except (LinkError, SilentError, JournalError) as error:
                    parameters.leave(str(error))
                    return

    def _await_start(self) -> None:
        """Raises VehicleError when somebody else has armed it meanwhile: his flight is not ours to take."""
        self._loop.enter("ready")
        while not self._loop.started:
            if self._clock.frozen_between_steps:  # vehicle time must not depend on how long this takes
                self._loop.idle()
            else:
                self._loop.step()
        self._hear_mode()
        if not self.down:
            raise VehicleError(f"somebody else has armed the vehicle, in mode {self._vehicle.telemetry.mode_name}")

    def _fly_slots(self) -> None:
        self._loop.enter("arming")
        self._vehicle.arm()
        self._loop.flying = True
        try:
            self._loop.enter("takeoff")
            self._take_off()
        except Yielded:
            self._await_resume()
        while True:
            try:
                self._take_control(self._vehicle.telemetry.mode)
                slots = self._helm.slots or self._first_slots()
                self._helm.follow_slots(slots)
                self._loop.enter("slots")
                while not slots.closed:
                    if self._rested() and not slots.closed:
                        self._helm.follow_slots(slots)
                    self._loop.step()
                self._hear_mode()  # who took over in the last moment keeps it
                return
            except Yielded:
                self._await_resume()

    def _take_off(self) -> None:
        """The autopilot's own, to a hover."""
        dialect, altitude_m = self._vehicle.dialect, self._config.takeoff_altitude_m
        self._loop.expected = {dialect.ready, Mode.TAKEOFF}
        self._loop.takeoff = Takeoff(dialect.ready, dialect.takeoff_done * altitude_m)
        self._vehicle.takeoff(altitude_m)
        self._loop.takeoff = None

    def _first_slots(self) -> Slots:
        self._transit()
        return Slots(self._config, self._helm.bounds.limits, self._clock.now, np.array(self._config.start_position_enu))

    def _take_control(self, present: Mode) -> None:
        """Stream a hold at this place, and change from the mode `present` to OFFBOARD."""
        position, velocity = self._helm.here()
        if self._helm.slots is not None:
            self._helm.slots.restart(self._clock.now, position, velocity)
        self._helm.follow(brake(position, velocity, self._helm.bounds.limits.agility))
        self._loop.expected, self._loop.other_mode = {present, Mode.OFFBOARD}, self._vehicle.telemetry.mode_name
        until = self._clock.now + self._vehicle.dialect.stream_before_offboard_s
        while self._clock.now < until:
            self._loop.step()
        self._hear_mode()
        self._vehicle.set_mode(Mode.OFFBOARD)
        self._loop.expected = {Mode.OFFBOARD}

    def _hear_mode(self) -> None:
        """So that nobody's newer choice is overruled unseen."""
        self._loop.get_in_touch()
        self._vehicle.hear_mode()

    def _rested(self) -> bool:
        """Whether the ladder has asked for the autopilot's own hold mode; by now there is something to fly again.

        Unless that was for the rest of the slots: then it still holds.
        """
        loop = self._loop
        if not loop.on(Rung.HOLD_MODE):
            return False
        self._hear_mode()
        self._helm.let_go()
        loop.resting = True
        loop.expected = loop.expected | {Mode.HOLD}
        self._vehicle.set_mode(Mode.HOLD)
        loop.expected = {Mode.HOLD}
        loop.enter("holding")
        while loop.on(Rung.HOLD_MODE):
            loop.step()
            if self._helm.slots is not None and self._helm.slots.closed:
                return True
        loop.resting = False
        self._take_control(Mode.HOLD)
        return True

    def _transit(self) -> None:
        """To the start position, over any holds."""
        goal = np.array(self._config.start_position_enu)
        while True:
            self._loop.enter("transit")
            way, left_s = Transit(self._helm.here()[0], goal, self._helm.bounds.limits), self._clock.now
            self._helm.follow(way, "transit")
            while not self._loop.held and not self._rested():
                position, velocity = self._helm.here()
                late_s = self._clock.now - left_s - way.duration_s
                if (
                    late_s >= 0
                    and np.linalg.norm(position - goal) < ARRIVED_M
                    and np.linalg.norm(velocity) < ARRIVED_MPS
                ):
                    return
                if late_s > SETTLE_S:
                    raise VehicleError(f"start position {vec3(goal)} not reached: still at {rounded(position)}")
                self._loop.step()
            self._hold()

    def _hold(self) -> None:
        """As long as a command wants it."""
        while self._loop.held:
            self._loop.enter("holding")
            self._helm.follow(brake(*self._helm.here(), self._helm.bounds.limits.agility))
            while self._loop.held and not self._rested():
                self._loop.step()

    def _await_resume(self) -> None:
        """Obey: no setpoints until an explicit `resume`. The slot clock runs on."""
        self._loop.enter("yielded")
        self._helm.let_go()
        self._loop.held = True
        while self._loop.held:
            self._loop.step()

    def _await_link(self, error: SilentError) -> End:
        """The link is dead, the vehicle is its failsafe's. Raises SilentError when the link stays dead.

        Once it is back the vehicle's mode is obeyed. If that is still the one we gave it, no failsafe has acted, and
        perhaps none will (ArduCopter's does not know a lost stream): then it is ours to bring down.
        """
        loop, vehicle = self._loop, self._vehicle
        ours = set(loop.expected)
        self._release()
        loop.expected = set()
        loop.enter("yielded")
        loop.tell("failsafe", f"{error}: no setpoints, the autopilot's own failsafe acts")
        heard, patience = vehicle.heard, time.monotonic() + LINK_BACK_WALL_S
        while vehicle.heard == heard:
            if time.monotonic() > patience:
                raise error
            self._listen()
        vehicle.doubt_mode()
        while not vehicle.mode_known():
            if time.monotonic() > patience:
                raise error
            self._listen()
        loop.excuse_silence()
        mode = vehicle.telemetry.mode
        if mode not in ours:
            return End(None, FAILSAFE, "the link was lost")
        loop.expected = {mode}  # who chooses another one from here on is obeyed
        return End(mode if mode is Mode.LAND else Mode.RETURN, FAILSAFE, "the link was lost")

    def _listen(self) -> None:
        with contextlib.suppress(SilentError):  # an autopilot that starts anew has come back, too
            self._clock.step(self._vehicle)

    def _come_down(self, ending: End) -> int:
        """Return or land, and wait for the ground.

        Pilots are obeyed here too: once one has chosen a mode nothing is asked for any more, and what others land is
        for them to disarm. What the autopilot refuses is left to its failsafe, since no setpoints come, and asked for
        again after a while: a landing is final.
        """
        self._release()
        loop, vehicle, code = self._loop, self._vehicle, ending.code
        end: End | None = ending
        began_s = landed_s = asked_s = self._clock.now
        while not self.down:
            try:
                if end is not None:
                    wanted, end, asked_s = end, None, self._clock.now
                    self._bring_down(wanted)
                elif self._landing_is_due and self._clock.now - asked_s > AGAIN_S:
                    asked_s, code = self._clock.now, max(code, FAILSAFE)
                    self._land()
                elif loop.expected and self._clock.now - landed_s > DISARM_S:
                    vehicle.disarm()
                loop.step()
            except End as another:
                end, code = another, max(code, another.code)
            except Yielded:
                code = max(code, FAILSAFE)
                loop.enter("yielded")
            except SilentError as error:
                end = self._await_link(error)
                code = max(code, end.code)
            except VehicleError as error:
                landed_s, code = self._clock.now, max(code, FAILSAFE)
                loop.tell("error", f"{error}: left to the autopilot's own failsafe")
            if not vehicle.telemetry.landed:
                landed_s = self._clock.now
            if self._clock.now - began_s > self._config.return_s + COME_DOWN_S:
                raise VehicleError(
                    f"not on the ground {self._clock.now - began_s:.0f} s after it was told to come down"
                )
        return code

    def _bring_down(self, end: End) -> None:
        """Raises VehicleError when it can do neither."""
        loop, vehicle = self._loop, self._vehicle
        if end.mode is None:
            loop.expected = set()
            return
        if end.mode is Mode.LAND:
            loop.deadman.land(str(end))
        else:
            loop.deadman.sent_home(self._clock.moment, str(end))
        self._hear_mode()
        if not loop.expected:
            loop.expected, loop.other_mode = {vehicle.telemetry.mode}, vehicle.telemetry.mode_name
        loop.expected = loop.expected | {Mode.RETURN, Mode.LAND}
        if end.mode is Mode.LAND:
            self._land()
            return
        loop.enter("returning")
        try:
            vehicle.set_mode(Mode.RETURN)
        except SilentError:
            raise
        except VehicleError as error:
            loop.tell("error", f"{error}; landing instead")
            loop.deadman.land("it cannot return")
            self._land()
        else:
            loop.expected = {Mode.RETURN, Mode.LAND}

    @property
    def _landing_is_due(self) -> bool:
        """By the ladder, and it is not landing."""
        ours = bool(self._loop.expected)
        return ours and self._loop.on(Rung.LAND) and self._vehicle.telemetry.mode is not Mode.LAND

    def _land(self) -> None:
        self._loop.enter("landing")
        self._vehicle.set_mode(Mode.LAND)
        self._loop.expected = {Mode.LAND}

    def _release(self) -> None:
        """No setpoints, no slots."""
        self._helm.let_go()
        self._helm.slots, self._loop.flying, self._loop.resting, self._loop.takeoff = None, False, False, None
