"""One flight, from the first heartbeat to the ground.

Phases:

    connecting -> preflight -> ready -> arming -> takeoff -> transit -> slots -> returning | landing -> ended

    transit | slots <-> holding      `hold` and `resume`; in the slots also whenever there is no action to fly
    takeoff .. slots -> yielded      a mode change by autopilot or pilot: no setpoints until `resume`, which takes
                                     control again, or `return`, `land`, or the ground

The phases are plain sequential code on one thread. Every wait in them is `_step`: hear the bus, judge, steer, tell, let
one step of vehicle time pass. What ends a phase early is raised from there.
"""

import contextlib
import queue
import time
from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np

from airframe.slot_profile import Reference, SlotProfile, Vector, brake
from autopilot_bridge import preflight
from autopilot_bridge.clock import Clock
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.deadman import SILENCE_WALL_S, Rung, Silence
from autopilot_bridge.energy import Endurance
from autopilot_bridge.envelope import Envelope, Sent
from autopilot_bridge.fence import Fence, lowered, outside_m
from autopilot_bridge.flight_parameters import FlightParameters
from autopilot_bridge.ground import Ground
from autopilot_bridge.link import LinkError
from autopilot_bridge.parameter_journal import JournalError, ParameterJournal, journal_name, state_folder
from autopilot_bridge.separation import Track
from autopilot_bridge.slots import SAMPLE_S, Slots, vec3
from autopilot_bridge.tracker import follow, heading_to, track
from autopilot_bridge.transit import Transit
from autopilot_bridge.vehicle import Mode, SilentError, Vehicle, VehicleError
from bus import messages as m

AS_PLANNED, ERROR, FAILSAFE = 0, 1, 3
"""Exit codes."""
ARRIVED_M, ARRIVED_MPS = 0.3, 0.2
SETTLE_S = 20.0
"""Vehicle time that the vehicle may need to arrive once its reference has."""
BREACH_M = 1.0
"""This far outside the fence the vehicle is sent home."""
COME_DOWN_S = 900.0
PUT_BACK_S = 5.0
"""Vehicle time after the disarming in which the autopilot must say that it is on the ground."""
DISARM_S = 10.0
"""Vehicle time on the ground after which we disarm if the autopilot has not."""
LINK_BACK_WALL_S = 60.0
PEERS = ("agent", "rf")
"""Nodes without which no action comes."""
TELLING = ("fence", "altitude", "home distance", "energy", "separation", "not finite")
"""Clips of setpoints that change what becomes of an action; the others only slow the tracking."""


class _End(Exception):  # noqa: N818  not an error: the flight's last decision
    """Come down by `mode` (None: as the vehicle does by itself) and exit with `code`."""

    def __init__(self, mode: Mode | None, code: int, why: str) -> None:
        super().__init__(why)
        self.mode, self.code = mode, code


class _Yielded(Exception):  # noqa: N818  not an error: the pilot's right
    """Somebody else flies the vehicle now."""


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
        self._config, self._ground, self._clock = config, ground, clock
        self._others = others
        self._vehicle = make_vehicle(self._step)
        self._phase = "connecting"
        self._bounds = preflight.unbound(config)
        self._parameters: FlightParameters | None = None
        self._started = config.autostart
        self._held = False
        """No actions are flown: by command, or because somebody else flies."""
        self._yaw = config.panel_heading_rad
        """The last heading asked for [rad, ENU]."""
        self._guide: Callable[[float], Reference] | None = None
        """Vehicle time -> what to track; None: no setpoints at all."""
        self._slots: Slots | None = None
        self._expected: set[Mode] = set()
        """Modes that are our doing; empty: any."""
        self._flying = False
        """Armed by us and not yet told to come down."""
        self._alive: dict[str, bool] = {}
        self._silence = Silence(time.monotonic())
        self._malformed = 0
        self._counters: Counter[str] = Counter()
        self._steps = 0
        ground.objection = self._objection

    @property
    def down(self) -> bool:
        """Whether the vehicle is on the ground and disarmed, as far as we know."""
        return not self._vehicle.telemetry.armed

    def run(self) -> int:
        """The exit code. Never raises on account of vehicle, link or commands."""
        try:
            code = self._fly()
        except (LinkError, VehicleError, JournalError) as error:
            code = ERROR
            self._tell("error", str(error))
        except _End as end:
            code = end.code
            self._tell("error" if code == ERROR else "failsafe", str(end))
        self._put_back()
        self._phase = "ended"
        self._publish_state()
        self._publish_health(final=True)
        return code

    # The phases.

    def _fly(self) -> int:
        self._tell("phase", self._phase)
        self._vehicle.connect()
        self._preflight()
        self._await_start()
        try:
            self._fly_slots()
            ending = _End(Mode.RETURN if self._config.at_end == "return" else Mode.LAND, AS_PLANNED, "all slots flown")
            self._tell("slots", str(ending))
        except _End as end:
            ending = end
            self._tell("failsafe", str(end))
        except SilentError as error:
            ending = self._await_link(error)
        except VehicleError as error:
            if self.down:
                raise
            ending = _End(Mode.RETURN, FAILSAFE, str(error))
            self._tell("failsafe", str(error))
        return self._come_down(ending)

    def _preflight(self) -> None:
        self._enter("preflight")
        config, vehicle = self._config, self._vehicle
        self._parameters = FlightParameters(vehicle, self._journal(), self._tell)
        self._bounds = preflight.clear(config, vehicle, self._parameters, self._tell)
        if not vehicle.telemetry.armable:
            self._tell("preflight", f"waiting until it can be armed{self._unwell}")
        vehicle.await_armable()
        if not vehicle.telemetry.armable:
            self._tell("preflight", f"it cannot be armed{self._unwell}")
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
        left_j, needed_j = self._left_j(endurance), endurance.needed_j(np.array(self._config.start_position_enu))
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
        self._expected = set()
        with contextlib.closing(parameters):
            until = self._clock.now + PUT_BACK_S
            while parameters.outstanding:
                try:
                    while self.down and not self._vehicle.telemetry.landed and self._clock.now < until:
                        self._step()
                    if not (self.down and self._vehicle.telemetry.landed):
                        parameters.leave("the vehicle is not on the ground and disarmed")
                        return
                    parameters.put_back()
                    return
                except _End:
                    continue  # a command that came too late
                except (LinkError, SilentError, JournalError) as error:
                    parameters.leave(str(error))
                    return

    def _await_start(self) -> None:
        self._enter("ready")
        while not self._started:
            if self._clock.frozen_between_steps:  # vehicle time must not depend on how long this takes
                self._hear()
                self._publish_health()
                self._silence.excuse(time.monotonic())
                time.sleep(0.01)
            else:
                self._step()

    def _fly_slots(self) -> None:
        self._enter("arming")
        self._vehicle.arm()
        self._flying = True
        try:
            self._enter("takeoff")
            self._expected = {self._vehicle.telemetry.mode, Mode.TAKEOFF, Mode.HOLD}
            self._vehicle.takeoff(self._config.takeoff_altitude_m)
        except _Yielded:
            self._await_resume()
        while True:
            try:
                self._take_control()
                if self._slots is None:
                    self._transit()
                    self._slots = Slots(
                        self._config, self._bounds.limits, self._clock.now, np.array(self._config.start_position_enu)
                    )
                self._guide = self._slots.reference
                self._enter("slots")
                while not self._slots.closed:
                    self._step()
                self._vehicle.hear_mode()  # who took over in the last moment keeps it
                return
            except _Yielded:
                self._await_resume()

    def _take_control(self) -> None:
        """Stream a hold at this place, and have OFFBOARD."""
        position, velocity = self._here()
        if self._slots is not None:
            self._slots.restart(self._clock.now, position, velocity)
        self._follow(brake(position, velocity, self._bounds.limits.agility))
        self._expected = {self._vehicle.telemetry.mode, Mode.OFFBOARD}
        until = self._clock.now + self._vehicle.dialect.stream_before_offboard_s
        while self._clock.now < until:
            self._step()
        self._vehicle.hear_mode()
        self._vehicle.set_mode(Mode.OFFBOARD)
        self._expected = {Mode.OFFBOARD}

    def _transit(self) -> None:
        """To the start position, over any holds."""
        goal = np.array(self._config.start_position_enu)
        while True:
            self._enter("transit")
            way, left_s = Transit(self._here()[0], goal, self._bounds.limits), self._clock.now
            self._follow(way)
            while not self._held:
                position, velocity = self._here()
                late_s = self._clock.now - left_s - way.duration_s
                if (
                    late_s >= 0
                    and np.linalg.norm(position - goal) < ARRIVED_M
                    and np.linalg.norm(velocity) < ARRIVED_MPS
                ):
                    return
                if late_s > SETTLE_S:
                    raise VehicleError(f"start position {vec3(goal)} not reached: still at {_rounded(position)}")
                self._step()
            self._enter("holding")
            self._follow(brake(*self._here(), self._bounds.limits.agility))
            while self._held:
                self._step()

    def _await_resume(self) -> None:
        """Obey: no setpoints until an explicit `resume`. The slot clock runs on."""
        self._enter("yielded")
        self._guide, self._held = None, True
        while self._held:
            self._step()

    def _await_link(self, error: SilentError) -> _End:
        """The link is dead, the vehicle is its failsafe's. Raises SilentError when the link stays dead."""
        self._release()
        self._expected = set()
        self._enter("yielded")
        self._tell("failsafe", f"{error}: no setpoints, the autopilot's own failsafe acts")
        heard, patience = self._vehicle.heard, time.monotonic() + LINK_BACK_WALL_S
        while self._vehicle.heard == heard:
            if time.monotonic() > patience:
                raise error
            self._clock.step(self._vehicle)
        self._silence.excuse(time.monotonic())
        return _End(None, FAILSAFE, "the link was lost")

    def _come_down(self, ending: _End) -> int:
        """Return or land, and wait for the ground.

        Pilots are obeyed here too: nothing is asked for twice, and what others land is for them to disarm. What the
        autopilot refuses is left to its failsafe, since no setpoints come any more.
        """
        self._release()
        vehicle, code, mode = self._vehicle, ending.code, ending.mode
        ours = mode is not None
        if not ours:
            self._expected = set()
        until, landed_s = self._clock.now + COME_DOWN_S, self._clock.now
        while not self.down:
            try:
                if mode is not None:
                    wanted, mode, ours = mode, None, True
                    self._bring_down(wanted)
                elif ours and self._clock.now - landed_s > DISARM_S:
                    vehicle.disarm()
                self._step()
            except _End as end:
                mode, code = end.mode, max(code, end.code)
            except _Yielded:
                ours, code = False, max(code, FAILSAFE)
                self._enter("yielded")
            except SilentError as error:
                ours, mode, code = False, None, max(code, self._await_link(error).code)
            except VehicleError as error:
                landed_s, code = self._clock.now, max(code, FAILSAFE)
                self._tell("error", f"{error}: left to the autopilot's own failsafe")
            if not vehicle.telemetry.landed:
                landed_s = self._clock.now
            if self._clock.now > until:
                raise VehicleError(f"not on the ground {COME_DOWN_S:g} s after it was told to come down")
        return code

    def _bring_down(self, mode: Mode) -> None:
        self._vehicle.hear_mode()
        self._expected = self._expected | {self._vehicle.telemetry.mode, Mode.RETURN, Mode.LAND}
        self._enter("returning" if mode is Mode.RETURN else "landing")
        try:
            self._vehicle.set_mode(mode)
        except SilentError:
            raise
        except VehicleError as error:
            self._tell("error", f"{error}; landing instead")
            self._enter("landing")
            self._vehicle.set_mode(Mode.LAND)
        self._expected = {Mode.RETURN, Mode.LAND}

    def _release(self) -> None:
        """No setpoints, no slots."""
        self._guide, self._slots, self._flying = None, None, False

    # One step of vehicle time.

    def _step(self) -> None:
        self._hear()
        self._judge()
        if self._slots is not None:
            self._keep_slots(self._slots)
        self._steer()
        self._report()
        self._clock.step(self._vehicle)
        self._steps += 1

    def _hear(self) -> None:
        """Nodes that come and go, and commands. Raises _End."""
        while not self._ground.changes.empty():
            node, alive = self._ground.changes.get()
            known = self._alive.get(node)
            self._alive[node] = alive
            if node in PEERS and known is not None and known != alive:
                self._tell("node_back" if alive else "node_lost", f"{node} node is {'back' if alive else 'gone'}")
            if node == "mission" and known and not alive and not self._started:
                raise _End(None, ERROR, "the mission is gone before the start")
        while not self._ground.commands.empty():
            command = self._ground.commands.get()
            self._tell("command", command)
            match command:
                case "start":
                    self._started = True
                case "hold":
                    self._held = True
                case "resume":
                    self._held = False
                case "return":
                    raise _End(Mode.RETURN, FAILSAFE, "return was commanded")
                case "land":
                    raise _End(Mode.LAND, FAILSAFE, "land was commanded")

    def _judge(self) -> None:
        """Silence, the ground, other hands, the fence, the ladder. Raises SilentError, _End, _Yielded."""
        vehicle, wall = self._vehicle, time.monotonic()
        if self._silence.over(vehicle.heard, wall) and self._phase != "connecting":
            raise SilentError(f"autopilot at {self._config.autopilot}: no telemetry for {SILENCE_WALL_S:g} s")
        telemetry = vehicle.telemetry
        if self._flying and not telemetry.armed:
            raise _End(None, FAILSAFE, f"the vehicle disarmed in mode {telemetry.mode_name}")
        if self._expected and telemetry.mode not in self._expected:
            self._expected, self._guide = set(), None
            self._tell("mode", f"{telemetry.mode_name} was chosen by autopilot or pilot: obeyed")
            raise _Yielded
        if self._guide is None:
            return
        position, velocity = self._here()
        if outside_m(self._fence, position) > BREACH_M:
            raise _End(Mode.RETURN, FAILSAFE, f"outside the fence at {_rounded(position)}")
        if self._config.endurance is not None:
            left_j = self._left_j(self._config.endurance)
            needed_j = self._config.endurance.needed_j(self._envelope.stop(position, velocity))
            if left_j < needed_j:
                raise _End(
                    Mode.RETURN,
                    FAILSAFE,
                    f"the way home needs {needed_j / 1e3:.1f} kJ, the battery holds {max(left_j, 0.0) / 1e3:.1f} kJ",
                )
        if self._slots is not None and self._slots.deadman.rung(self._clock.now) is Rung.RETURN:
            raise _End(Mode.RETURN, FAILSAFE, f"no good action for {self._config.grace_s:g} s")

    def _keep_slots(self, slots: Slots) -> None:
        """Open what is due, take what has come, hold what has not."""
        position, velocity = self._here()
        if slots.due(self._clock.now):
            opened = slots.open(position, velocity, self._vehicle.telemetry.attitude_rad)
            self._malformed = self._ground.malformed_actions
            self._ground.slot.send(opened)
            if opened.flown is not None:
                self._account(opened.flown)
            if self._clock.frozen_between_steps and not slots.closed:
                self._await_action(slots)
        self._take_actions(slots)
        if slots.awaiting and slots.deadman.rung(self._clock.now) is Rung.HOLD:
            slots.hold(self._clock.now, "missing", "no action by the deadline")
        slots.sample(self._clock.now, position, velocity)

    def _await_action(self, slots: Slots) -> None:
        """Vehicle time stands still until the slot's action is there, or will not come."""
        patience = time.monotonic() + self._config.action_wait_wall_s
        while slots.awaiting and time.monotonic() < patience and self._may_come():
            with contextlib.suppress(queue.Empty):
                self._take(slots, self._ground.actions.get(timeout=0.02))
            self._take_actions(slots)
            self._hear()
            self._publish_health()
        self._silence.excuse(time.monotonic())
        if slots.awaiting:
            slots.hold(self._clock.now, "missing", "no action")

    def _may_come(self) -> bool:
        return self._config.await_restart or all(self._alive.get(node, True) for node in PEERS)

    def _take_actions(self, slots: Slots) -> None:
        while not self._ground.actions.empty():
            self._take(slots, self._ground.actions.get())
        if slots.awaiting and self._ground.malformed_actions > self._malformed:
            slots.hold(self._clock.now, "rejected", "malformed action")

    def _take(self, slots: Slots, action: m.Action) -> None:
        if action.slot != slots.number:
            self._counters["actions_for_other_slots"] += 1
        elif self._guide is None:
            slots.act(action, self._clock.now, f"control yielded to {self._vehicle.telemetry.mode_name}")
        else:
            slots.act(action, self._clock.now, "held by command" if self._held else None)

    def _steer(self) -> None:
        if self._guide is None:
            return
        position, velocity = self._here()
        reference = self._guide(self._clock.now)
        if self._config.tracking == "none" and self._slots is not None:
            wanted = follow(reference)
        else:
            wanted = track(reference, position, self._vehicle.dialect.lead_s)
        endurance = self._config.endurance
        energy_j = None if endurance is None else self._left_j(endurance)
        sent = self._envelope.send(wanted, self._heading(position), position, velocity, self._others(), energy_j)
        self._counters["setpoints"] += 1
        self._log_setpoint(wanted, sent)
        for reason in sent.reasons:
            self._counters[f"setpoints_clipped_{reason.replace(' ', '_')}"] += 1
            if self._slots is not None and reason in TELLING:
                self._slots.clipped(f"envelope: {reason}")

    def _log_setpoint(self, wanted: Vector, sent: Sent) -> None:
        """The proof of what was sent and why."""
        slots, now = self._slots, self._clock.now
        order = None if slots is None else slots.order
        self._ground.setpoint.send(
            m.Setpoint(
                time_s=now,
                slot=None if slots is None or slots.number < 0 or slots.closed else slots.number,
                source=order.source if order else "transit" if self._phase == "transit" else "hold",
                action_slot=order.slot if order else None,
                action_age_s=now - order.taken_s if order else None,
                state_age_s=max(0.0, now - self._vehicle.telemetry.time_s),
                wanted_enu=vec3(wanted) if np.isfinite(wanted).all() else None,
                velocity_enu=vec3(sent.velocity),
                yaw_rad=self._yaw,
                reasons=list(sent.reasons),
            )
        )

    def _report(self) -> None:
        hz = self._config.setpoint_hz
        if self._steps % hz == 0:
            self._vehicle.beat()
        if self._steps % round(hz * SAMPLE_S) == 0:
            self._publish_state()
        for text in self._vehicle.status_texts():
            self._tell("statustext", text)
        if self._slots is not None and self._guide is not None and self._slots.decided:
            self._enter("slots" if self._slots.acting else "holding")
        self._publish_health()

    # Commands: on zenoh's thread, so only single reads.

    def _objection(self, name: m.CommandName) -> str:
        """Why a command cannot be taken now; empty when it can."""
        phase = self._phase
        if phase == "ended":
            return "the flight is over"
        match name:
            case "start" if self._started:
                return "already started"
            case "hold" if phase not in ("takeoff", "transit", "slots", "holding"):
                return f"nothing to hold in phase {phase}"
            case "resume" if phase not in ("holding", "yielded") or not self._flying:
                return f"nothing to resume in phase {phase}"
            case "resume":
                position = self._vehicle.telemetry.position_enu
                if position is None or outside_m(self._fence, position) > 0:
                    return "the vehicle is outside the fence"
        return ""

    # Telling.

    def _enter(self, phase: str) -> None:
        if phase != self._phase:
            self._phase = phase
            self._tell("phase", phase)

    def _tell(self, kind: str, text: str) -> None:
        self._ground.tell(kind, text)

    def _account(self, flown: m.FlownSlot) -> None:
        self._counters[f"slots_{flown.outcome}"] += 1
        told = [reason for reason in flown.reasons if reason not in ("acceleration", "speed", "climb")]
        if told:
            self._tell("slot", f"slot {flown.slot} {flown.outcome}: {', '.join(told)}")

    def _publish_state(self) -> None:
        telemetry = self._vehicle.telemetry
        if telemetry.position_enu is None:
            return
        position, velocity = self._here()
        self._ground.state.send(
            m.VehicleState(
                time_s=self._clock.now,
                position_enu=vec3(position),
                velocity_enu=vec3(velocity),
                attitude_rad=telemetry.attitude_rad,
                mode=telemetry.mode_name,
                armed=telemetry.armed,
                landed=telemetry.landed,
                battery_remaining=telemetry.battery_remaining,
                home_lat_lon_alt=telemetry.home_lat_lon_alt,
                phase=self._phase,
            )
        )

    def _publish_health(self, final: bool = False) -> None:
        self._ground.publish_health(self._counters + self._vehicle.counters, final)

    # Views.

    def _here(self) -> tuple[Vector, Vector]:
        """Position and velocity now. Raises VehicleError when there is none."""
        return self._vehicle.telemetry.at(self._clock.now)

    def _left_j(self, endurance: Endurance) -> float:
        """What the battery holds [J] before the autopilot comes down by itself."""
        battery = self._vehicle.telemetry.battery_remaining
        return endurance.left_j(None if battery is None else battery - self._bounds.battery_reserve)

    def _follow(self, way: SlotProfile | Transit) -> None:
        """Track `way`, which starts now."""
        since_s = self._clock.now
        self._guide = lambda time_s: way.at(time_s - since_s)

    @property
    def _envelope(self) -> Envelope:
        return Envelope(
            self._bounds.tracking,
            self._fence,
            self._vehicle.dialect.reaction_s,
            self._config.tick_ms / 1000,
            self._vehicle.send_velocity,
            self._bounds.home_distance_m,
            self._config.endurance,
            self._config.separation_m,
        )

    def _heading(self, position: Vector) -> float:
        """Yaw to fly [rad, ENU]."""
        if self._config.face_enu is not None:
            self._yaw = heading_to(self._config.face_enu, position, self._yaw)
        return self._yaw

    @property
    def _fence(self) -> Fence:
        fence = self._config.flight_fence if self._slots is None else self._config.slot_fence
        return lowered(fence, self._bounds.ceiling_m)


def _rounded(position: Vector) -> str:
    return f"({', '.join(f'{c:.1f}' for c in position.tolist())}) m"
