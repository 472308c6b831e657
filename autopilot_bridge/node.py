"""The bridge node: flies one vehicle through its slots, between the bus and the autopilot.

Phases:

    connecting -> preflight -> ready -> arming -> takeoff -> transit -> slots -> returning | landing -> ended
                                                                ^          ^
                                              hold, resume:  holding    holding
                    a mode change by autopilot or pilot:     yielded -- until `resume`, `return`, `land` or the ground

One thread flies. It runs the phases as plain sequential code, and every wait in it is `_step`: hear the bus, judge,
steer, tell, let one step of vehicle time pass. What ends a phase early is raised from there. Zenoh's threads only put
what they receive into queues.
"""

import contextlib
import queue
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import zenoh

from airframe.slot_profile import Reference, Vector, brake
from autopilot_bridge.clock import Clock, Lockstep, Paced
from autopilot_bridge.config import Box, BridgeConfig, Limits, LockstepClock
from autopilot_bridge.deadman import Deadman, Rung, Silence
from autopilot_bridge.dialects import Dialect
from autopilot_bridge.dialects.px4 import PX4
from autopilot_bridge.envelope import Envelope
from autopilot_bridge.link import Link, LinkError
from autopilot_bridge.pymavlink_vehicle import PymavlinkVehicle
from autopilot_bridge.slots import SAMPLE_S, Slots, vec3
from autopilot_bridge.tracker import track
from autopilot_bridge.transit import Transit
from autopilot_bridge.vehicle import Mode, SilentError, Vehicle, VehicleError
from bus import messages as m
from bus import topics

DIALECTS = {"px4": PX4}
AS_PLANNED, ERROR, FAILSAFE = 0, 1, 3
"""Exit codes."""
SETTLE_S = 20.0
"""Vehicle time that the arrival at the start position may take."""
ARRIVED_M, ARRIVED_MPS = 0.5, 0.3
BREACH_M = 1.0
"""This far outside the fence the vehicle is sent home."""
COME_DOWN_S = 900.0
DISARM_S = 10.0
"""Vehicle time on the ground after which we disarm if the autopilot has not."""
LINK_BACK_WALL_S = 60.0
TRACKING_HEADROOM = 1.25
"""A vehicle that is behind its plan may be this much faster than plans are, if the autopilot lets it."""
PEERS = ("agent", "rf")
EXPLAINED = ("fence", "altitude", "not finite")
"""Clips of setpoints that change what became of an action; the others only slow the tracking."""


class _End(Exception):  # noqa: N818  not an error: the flight's last decision
    """The flight is over: come down by `mode` (None: as the vehicle already does) and exit with `code`."""

    def __init__(self, mode: Mode | None, code: int, why: str) -> None:
        super().__init__(why)
        self.mode, self.code = mode, code


class _Yielded(Exception):  # noqa: N818
    """Somebody else flies the vehicle now."""


def run(config: BridgeConfig, vehicle: str, session: zenoh.Session, tlog: Path | None) -> int:
    """Fly `config` on bus name `vehicle`; the exit code: 0 as planned, 3 ended safely early, 1 error.

    `tlog` is the flight log to write. The caller closes the session.
    """
    bridge = _Bridge(config, vehicle, session)
    with bridge.served(), _land_on_interrupt(bridge.land):
        return bridge.run(tlog)


@contextlib.contextmanager
def _land_on_interrupt(land: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C lands; a second one ends the process and leaves the vehicle to its failsafe."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGINT)

    def on_interrupt(number: int, frame: object) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        land()

    signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class _Bridge:
    def __init__(self, config: BridgeConfig, name: str, session: zenoh.Session) -> None:
        self._config, self._name, self._session = config, name, session
        self._dialect: Dialect = DIALECTS[config.dialect]
        self._state = topics.Publisher(session, name, topics.STATE)
        self._slot = topics.Publisher(session, name, topics.SLOT)
        self._event = topics.Publisher(session, name, topics.EVENT)
        self._health = topics.Publisher(session, name, topics.HEALTH)
        self._refused: Counter[str] = Counter()
        self._actions: queue.SimpleQueue[m.Action] = queue.SimpleQueue()
        self._commands: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._changes: queue.SimpleQueue[tuple[str, bool]] = queue.SimpleQueue()
        self._alive: dict[str, bool] = {}
        self._counters: Counter[str] = Counter()

        self._phase = "connecting"
        self._started = config.autostart
        self._held = False
        self._clock: Clock | None = None
        self._vehicle: Vehicle | None = None
        self._limits: Limits = config.limits
        self._envelope: Envelope | None = None
        self._guide: Callable[[float], Reference] | None = None
        """What to track; None: no setpoints at all."""
        self._slots: Slots | None = None
        self._deadman: Deadman | None = None
        self._expected: set[Mode] = set()
        """Modes that are our doing; empty: any."""
        self._silence = Silence(time.monotonic())
        self._steps = 0
        self._health_at = 0.0

    # What zenoh's threads call: only queues and single reads.

    @contextlib.contextmanager
    def served(self) -> Iterator[None]:
        """On the bus: subscriptions, the command queryable, the liveliness token."""
        session, name = self._session, self._name
        held = (
            topics.subscribe(session, name, topics.ACTION, self._actions.put, self._refused),
            topics.watch_alive(session, name, lambda node, alive: self._changes.put((node, alive))),
            topics.answer_commands(session, name, self._answer, self._refused),
            topics.declare_alive(session, name, "bridge"),
        )
        try:
            yield
        finally:
            for declared in held:
                declared.undeclare()  # type: ignore[attr-defined]  # bus hands them out as opaque objects

    def land(self) -> None:
        """Ask for a landing, from any thread."""
        self._commands.put("land")

    def _answer(self, command: m.Command) -> m.CommandReply:
        reason = self._objection(command.name)
        if not reason:
            self._commands.put(command.name)
        return m.CommandReply(accepted=not reason, reason=reason)

    def _objection(self, name: m.CommandName) -> str:
        """Why a command cannot be taken now; empty when it can."""
        phase = self._phase
        if phase == "ended":
            return "the flight is over"
        if name == "start":
            if self._started:
                return "already started"
            self._started = True
            return ""
        if name == "hold" and phase not in ("transit", "slots"):
            return f"nothing to hold in phase {phase}"
        if name == "resume":
            return self._objection_to_resume(phase)
        return ""

    def _objection_to_resume(self, phase: str) -> str:
        if phase not in ("holding", "yielded"):
            return f"nothing to resume in phase {phase}"
        position = self._vehicle.telemetry.position_enu if self._vehicle else None
        if position is None or not self._fence.contains(vec3(position)):
            return "the vehicle is outside the fence"
        return ""

    # The flight.

    def run(self, tlog: Path | None) -> int:
        over = True
        try:
            self._open(tlog)
            code = self._fly()
        except (LinkError, VehicleError) as error:
            code = ERROR
            self._tell("error", str(error))
        except _End as end:
            code = end.code
            self._tell("error" if end.code == ERROR else "command", str(end))
        if self._vehicle is not None:
            over = not self._vehicle.telemetry.armed
        self._phase = "ended"
        self._publish_health()
        self._tell("ended", f"exit {code}", code)
        if self._clock is not None:
            with contextlib.suppress(LinkError):  # a SITL that is gone needs no farewell
                self._clock.close(over)
        if self._vehicle is not None:
            self._vehicle.close()
        return code

    def _open(self, tlog: Path | None) -> None:
        config = self._config
        self._enter("connecting")
        link = Link(config.autopilot, config.system_id, tlog)
        self._vehicle = PymavlinkVehicle(link, self._dialect, config.system_id, lambda: self._now, self._step)
        if isinstance(config.clock, LockstepClock):
            self._clock = Lockstep(config.clock.control, config.tick_ms)
        else:
            self._clock = Paced(config.clock.speed, config.tick_ms)
        self._vehicle.connect()
        link.stamp_by(lambda: self._now)

    def _fly(self) -> int:
        self._preflight()
        self._await_start()
        try:
            self._fly_slots()
            ending = _End(Mode.RETURN if self._config.at_end == "return" else Mode.LAND, AS_PLANNED, "all slots flown")
        except _End as end:
            ending = end
            self._tell("failsafe" if end.code == FAILSAFE else "end", str(end))
        except SilentError as error:
            ending = self._await_link(error)
        except VehicleError as error:
            ending = _End(Mode.RETURN, FAILSAFE, str(error))
            self._tell("failsafe", f"{error}; going home")
            if not self._the_vehicle.telemetry.armed:
                raise
        return self._come_down(ending)

    def _preflight(self) -> None:
        self._enter("preflight")
        vehicle, dialect = self._the_vehicle, self._dialect
        for name, value in self._config.parameters.items():
            vehicle.set_parameter(name, value)
            self._tell("parameter", f"{name} set to {value:g}")
        self._limits = self._config.limits.within(
            vehicle.parameter(dialect.horizontal_limit),
            vehicle.parameter(dialect.up_limit),
            vehicle.parameter(dialect.down_limit),
        )
        if self._limits != self._config.limits:
            self._tell("limits", f"planning inside the autopilot's limits: {self._limits}")
        action = vehicle.parameter(dialect.offboard_loss_action)
        if action not in dialect.offboard_loss_safe:
            safe = dialect.offboard_loss_safe[0]
            vehicle.set_parameter(dialect.offboard_loss_action, safe)
            self._tell(
                "parameter",
                f"{dialect.offboard_loss_action} was {action:g}, which neither lands nor returns: set to {safe}",
            )
        vehicle.await_armable()

    def _await_start(self) -> None:
        self._enter("ready")
        while not self._started:
            if self._the_clock.frozen_between_steps:  # vehicle time must not depend on how long this takes
                self._hear()
                self._publish_health()
                self._silence.excuse(time.monotonic())
                time.sleep(0.01)
            else:
                self._step()
        self._hear()

    def _fly_slots(self) -> None:
        vehicle = self._the_vehicle
        self._enter("arming")
        vehicle.arm()
        self._enter("takeoff")
        try:
            vehicle.takeoff(self._config.takeoff_altitude_m)
        except _Yielded:
            self._await_resume()
        while True:
            try:
                self._take_control()
                if self._slots is None:
                    self._transit()
                self._run_slots()
                return
            except _Yielded:
                self._await_resume()

    def _take_control(self) -> None:
        """Stream a hold here, then OFFBOARD. PX4 ends its takeoff by HOLD, so that is waited for before (takeoff)."""
        position, velocity = self._here()
        self._envelope = Envelope(
            self._tracking_limits,
            self._fence,
            self._dialect.reaction_s,
            self._config.tick_ms / 1000,
            self._the_vehicle.send_velocity,
        )
        if self._slots is not None:
            self._slots.restart(self._now, position, velocity)
            self._guide = self._slots.reference
        else:
            self._hold_here()
        self._expected = set()
        until = self._now + self._dialect.stream_before_offboard_s
        while self._now < until:
            self._step()
        self._the_vehicle.set_mode(Mode.OFFBOARD)
        self._expected = {Mode.OFFBOARD}

    def _hold_here(self) -> None:
        position, velocity = self._here()
        profile, since_s = brake(position, velocity, self._limits.acceleration_mps2), self._now
        self._guide = lambda time_s: profile.at(time_s - since_s)

    def _transit(self) -> None:
        """To the start position, over any holds."""
        goal = np.array(self._config.start_position_enu)
        self._held = False
        while True:
            self._enter("transit")
            way, departure_s = Transit(self._here()[0], goal, self._limits), self._now
            self._guide = lambda time_s, way=way, since_s=departure_s: way.at(time_s - since_s)  # type: ignore[misc]
            while not self._held:
                position, velocity = self._here()
                if (
                    self._now >= departure_s + way.duration_s
                    and np.linalg.norm(position - goal) < ARRIVED_M
                    and np.linalg.norm(velocity) < ARRIVED_MPS
                ):
                    return
                if self._now > departure_s + way.duration_s + SETTLE_S:
                    raise VehicleError(f"start position {vec3(goal)} not reached, the vehicle is at {vec3(position)}")
                self._step()
            self._enter("holding")
            self._hold_here()
            while self._held:
                self._step()

    def _run_slots(self) -> None:
        if self._slots is None:
            start = np.array(self._config.start_position_enu)
            self._slots = Slots(self._config, self._limits, self._now, start)
            self._deadman = Deadman(self._config.deadline_s, self._config.grace_s, self._now)
            self._envelope = Envelope(
                self._tracking_limits,
                self._fence,
                self._dialect.reaction_s,
                self._config.tick_ms / 1000,
                self._the_vehicle.send_velocity,
            )
            self._guide = self._slots.reference
        self._enter("slots")
        while not self._slots.closed:
            self._step()

    def _await_resume(self) -> None:
        """Obey: no setpoints until an explicit `resume`. The slot clock runs on."""
        self._enter("yielded")
        self._guide, self._held = None, True
        while self._held:
            self._step()

    def _await_link(self, error: SilentError) -> _End:
        """The link is dead: no setpoints, the vehicle is its failsafe's. Raises SilentError when it stays dead."""
        self._guide, self._slots, self._expected = None, None, set()
        self._enter("yielded")
        self._tell("failsafe", f"{error}; no setpoints, the autopilot's own failsafe acts")
        heard, patience = self._the_vehicle.heard, time.monotonic() + LINK_BACK_WALL_S
        while self._the_vehicle.heard == heard:
            if time.monotonic() > patience:
                raise error
            self._the_clock.step(self._the_vehicle)
        return _End(None, FAILSAFE, "the link was lost")

    def _come_down(self, ending: _End) -> int:
        """Return or land, and wait for the ground. Pilots are obeyed here too: nothing is asked for twice."""
        vehicle = self._the_vehicle
        self._guide, self._slots, self._deadman = None, None, None
        code = ending.code
        landed_s: float | None = None
        until = self._now + COME_DOWN_S
        while vehicle.telemetry.armed:
            try:
                if ending.mode is not None:
                    mode, ending.mode = ending.mode, None
                    self._expected = set()
                    self._enter("returning" if mode is Mode.RETURN else "landing")
                    self._command_down(mode)
                    self._expected = {Mode.RETURN, Mode.LAND}
                self._step()
            except _End as end:  # a command on the way down, or the ground
                ending, code = end, max(code, end.code)
            except _Yielded:
                code, self._expected = max(code, FAILSAFE), set()
                self._enter("yielded")
            if not vehicle.telemetry.landed:
                landed_s = None
            elif landed_s is None:
                landed_s = self._now
            elif self._now - landed_s > DISARM_S:
                vehicle.disarm()
            if self._now > until:
                raise VehicleError(f"not on the ground {COME_DOWN_S:g} s after it was told to come down")
        return code

    def _command_down(self, mode: Mode) -> None:
        try:
            self._the_vehicle.set_mode(mode)
        except SilentError:
            raise
        except VehicleError as error:
            self._tell("error", f"{error}; landing instead")
            self._the_vehicle.set_mode(Mode.LAND)

    # One step of vehicle time.

    def _step(self) -> None:
        self._hear()
        self._judge()
        if self._slots is not None:
            self._run_slot_clock(self._slots)
        self._steer()
        self._report()
        self._the_clock.step(self._the_vehicle)
        self._steps += 1

    def _hear(self) -> None:
        """Commands and liveliness. Raises _End."""
        while not self._changes.empty():
            node, alive = self._changes.get()
            known = self._alive.get(node)
            self._alive[node] = alive
            if node in PEERS and known is not None and known != alive:
                self._tell("node_back" if alive else "node_lost", f"{node} node {'is back' if alive else 'is gone'}")
            if node == "mission" and not alive and known and not self._started:
                raise _End(None, ERROR, "the mission is gone before the start")
        while not self._commands.empty():
            self._obey(self._commands.get())

    def _obey(self, command: str) -> None:
        self._tell("command", command)
        match command:
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
        vehicle = self._the_vehicle
        if self._phase != "connecting" and self._silence.over(vehicle.heard, time.monotonic()):
            self._silence.excuse(time.monotonic())
            raise SilentError(f"autopilot at {self._config.autopilot}: no telemetry for 3 s")
        telemetry = vehicle.telemetry
        if self._phase in ("transit", "slots", "holding", "yielded") and not telemetry.armed:
            if self._guide is not None or self._slots is not None:
                raise _End(None, FAILSAFE, f"the vehicle disarmed in mode {telemetry.mode_name}")
        if self._expected and telemetry.mode not in self._expected:
            self._expected, self._guide = set(), None
            self._tell("mode", f"{telemetry.mode_name} was chosen by autopilot or pilot: no setpoints until `resume`")
            raise _Yielded
        if self._guide is None:
            return
        position, _ = self._here()
        if not self._fence.contains(vec3(position), margin=-BREACH_M):
            raise _End(Mode.RETURN, FAILSAFE, f"outside the fence at {vec3(np.round(position, 1))}")
        if self._deadman is not None and self._deadman.rung(self._now) is Rung.RETURN:
            raise _End(Mode.RETURN, FAILSAFE, f"no good action for {self._config.grace_s:g} s")

    def _run_slot_clock(self, slots: Slots) -> None:
        position, velocity = self._here()
        if slots.due(self._now):
            opened = slots.open(position, velocity, self._the_vehicle.telemetry.attitude_rad)
            self._slot.send(opened)
            if opened.flown is not None:
                self._counters[f"slots_{opened.flown.outcome}"] += 1
                if opened.flown.outcome != "flown":
                    self._tell_slot(opened.flown)
            if slots.closed:
                return
            self._the_deadman.opened(slots.opening_s)
            self._refused_before = self._refused[topics.ACTION.name]
            if self._the_clock.frozen_between_steps:
                self._wait_for_action(slots)
        self._take_actions(slots)
        if slots.outcome is None and self._the_deadman.rung(self._now) is Rung.HOLD:
            slots.hold(self._now, "missing", "no action by the deadline")
        slots.sample(self._now, position, velocity)

    def _wait_for_action(self, slots: Slots) -> None:
        """Vehicle time stands still until the slot's action is there, or will not come."""
        patience = time.monotonic() + self._config.action_wait_wall_s
        while slots.outcome is None and time.monotonic() < patience:
            dead = [node for node in PEERS if not self._alive.get(node, True)]
            if dead and not self._config.await_restart:
                break
            with contextlib.suppress(queue.Empty):
                self._take(slots, self._actions.get(timeout=0.02))
            self._take_actions(slots)
            self._hear()
            self._publish_health()
        self._silence.excuse(time.monotonic())
        if slots.outcome is None:
            slots.hold(self._now, "missing", "no action")

    def _take_actions(self, slots: Slots) -> None:
        while not self._actions.empty():
            self._take(slots, self._actions.get())
        if slots.outcome is None and self._refused[topics.ACTION.name] > self._refused_before:
            slots.hold(self._now, "rejected", "malformed action")

    def _take(self, slots: Slots, action: m.Action) -> None:
        held = None
        if self._guide is None:
            held = f"control yielded to {self._the_vehicle.telemetry.mode_name}"
        elif self._held:
            held = "held by command"
        if slots.act(action, held):
            self._the_deadman.acted(self._now)
        elif action.slot != slots.number:
            self._counters["actions_for_other_slots"] += 1

    def _steer(self) -> None:
        if self._guide is None or self._envelope is None:
            return
        position, velocity = self._here()
        wanted = track(self._guide(self._now), position, self._dialect.lead_s)
        sent = self._envelope.send(wanted, self._config.panel_heading_rad, position, velocity)
        self._counters["setpoints"] += 1
        for reason in sent.reasons:
            self._counters[f"setpoints_clipped_{reason.replace(' ', '_')}"] += 1
            if self._slots is not None and reason in EXPLAINED:
                self._slots.clipped(f"envelope: {reason}")

    def _report(self) -> None:
        hz = self._config.setpoint_hz
        if self._steps % hz == 0:
            self._the_vehicle.beat()
        if self._steps % round(hz * SAMPLE_S) == 0:
            self._publish_state()
        for text in self._the_vehicle.status_texts():
            self._tell("statustext", text)
        phase = self._phase
        if phase in ("slots", "holding") and self._slots is not None:
            holding = self._held or self._slots.outcome in ("missing", "late", "rejected")
            if holding != (phase == "holding"):
                self._enter("holding" if holding else "slots")
        self._publish_health()

    # Telling.

    def _enter(self, phase: str) -> None:
        if phase != self._phase or phase == "connecting":
            self._phase = phase
            self._tell("phase", phase)

    def _tell(self, kind: str, text: str, exit_code: int | None = None) -> None:
        now = self._now if self._clock is not None else 0.0
        print(f"{now:9.2f} {kind}: {text}", flush=True)
        self._event.send(m.MissionEvent(time_s=now, source="bridge", kind=kind, text=text, exit_code=exit_code))

    def _tell_slot(self, flown: m.FlownSlot) -> None:
        if flown.outcome in ("missing", "late", "rejected") or "box" in flown.reasons:
            self._tell("slot", f"slot {flown.slot} {flown.outcome}: {', '.join(flown.reasons)}")

    def _publish_state(self) -> None:
        telemetry = self._the_vehicle.telemetry
        if telemetry.position_enu is None or telemetry.velocity_enu is None:
            return
        position, velocity = self._here()
        self._state.send(
            m.VehicleState(
                time_s=self._now,
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

    def _publish_health(self) -> None:
        wall = time.monotonic()
        if wall - self._health_at < 1.0 and self._phase != "ended":
            return
        self._health_at = wall
        counters = self._counters + Counter({f"refused_{name}": n for name, n in self._refused.items()})
        if self._vehicle is not None:
            counters += self._vehicle.counters
        self._health.send(m.NodeHealth(node="bridge", wall_time_s=time.time(), counters=dict(counters)))

    # Views.

    @property
    def _now(self) -> float:
        return self._the_clock.now

    @property
    def _fence(self) -> Box:
        return self._config.flight_fence if self._slots is None else self._config.slot_fence

    @property
    def _tracking_limits(self) -> Limits:
        return self._limits.model_copy(update={"horizontal_mps": self._limits.horizontal_mps * TRACKING_HEADROOM})

    def _here(self) -> tuple[Vector, Vector]:
        return self._the_vehicle.telemetry.at(self._now)

    @property
    def _the_vehicle(self) -> Vehicle:
        assert self._vehicle is not None
        return self._vehicle

    @property
    def _the_clock(self) -> Clock:
        assert self._clock is not None
        return self._clock

    @property
    def _the_deadman(self) -> Deadman:
        assert self._deadman is not None
        return self._deadman
