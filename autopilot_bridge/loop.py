"""One step of vehicle time, of which every wait of a flight is made: hear, judge, keep the slots, steer, tell."""

import contextlib
import queue
import time
from collections import Counter
from collections.abc import Callable, Sequence

from airframe.slot_profile import Vector
from autopilot_bridge.clock import Clock
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.deadman import HEARTBEAT_WALL_S, NEVER, SILENCE_WALL_S, Attention, Moment, Rung, Silence
from autopilot_bridge.endings import ERROR, FAILSAFE, End, Yielded
from autopilot_bridge.fence import outside_m
from autopilot_bridge.ground import Ground
from autopilot_bridge.helm import Helm
from autopilot_bridge.separation import Track
from autopilot_bridge.slots import SAMPLE_S, Slots, vec3
from autopilot_bridge.takeoff import Takeoff
from autopilot_bridge.vehicle import CARRIED_S, Mode, SilentError, Vehicle
from bus import messages as m

BREACH_M = 1.0
"""This far outside the fence the vehicle is sent home."""
PEERS = ("agent", "rf")
"""Nodes without which no action comes."""
LISTENED_S = 0.02
"""Having listened so short a time ago, we need not listen again before we send."""
BEAT_S = 1.0
"""Between two HEARTBEATs of ours, however slow the steps are: ArduCopter's failsafe acts after 5 s without."""
EARLY_S = 0.02
"""A state may be told this much before its time is due: telemetry does not come to the millisecond."""


class Loop:
    """The bridge's loop about one vehicle. `make_vehicle(wait)` builds it; it calls `wait` to let a step pass."""

    def __init__(
        self,
        config: BridgeConfig,
        ground: Ground,
        clock: Clock,
        make_vehicle: Callable[[Callable[[], None]], Vehicle],
        others: Callable[[], Sequence[Track]],
    ) -> None:
        self._config, self._ground, self._clock = config, ground, clock
        self.vehicle = make_vehicle(self.step)
        self.helm = Helm(config, clock, self.vehicle, ground, others, self._may_send)
        self.deadman = config.deadman
        self._rung = Rung.FLY
        """As last judged."""
        self.phase = "connecting"
        self.started = config.autostart
        self.held = False
        """No actions are flown: by command, or because somebody else flies."""
        self.expected: set[Mode] = set()
        """Modes that are our doing; empty: the vehicle is not ours, any will do."""
        self.other_mode = ""
        """Which one `Mode.OTHER` means in `expected`: they are many."""
        self.takeoff: Takeoff | None = None
        """The one that is being flown."""
        self.resting = False
        """In the autopilot's own hold mode, by our own choice."""
        self.flying = False
        """Armed by us and not yet told to come down."""
        self._silences = (Silence(time.monotonic()), Silence(time.monotonic(), HEARTBEAT_WALL_S))
        """Of all messages, and of HEARTBEATs."""
        self._attention = Attention(clock.moment)
        self._broken_off = False
        self._doubted_at = 0.0
        """Wall clock."""
        self._alive: dict[str, bool] = {}
        self._malformed = 0
        self._counters: Counter[str] = Counter()
        self._steps = 0
        self._beaten = NEVER
        self._heard = self._heartbeats = 0
        self._position_s = self._position_told_s = self._state_told_s = 0.0
        ground.objection = self._objection

    @property
    def down(self) -> bool:
        """Whether the vehicle is on the ground and disarmed, as far as we know."""
        return not self.vehicle.telemetry.armed

    def on(self, rung: Rung) -> bool:
        """Whether this is the ladder's rung."""
        return self._rung is rung

    def enter(self, phase: str) -> None:
        if phase != self.phase:
            self.phase = phase
            self.tell("phase", phase)

    def tell(self, kind: str, text: str) -> None:
        self._ground.tell(kind, text)

    def step(self) -> None:
        """Raises End, Yielded, and what the vehicle raises.

        While the vehicle is ours it returns only in touch, so that no mode is asked for in the dark.
        """
        self._pass()
        if self.expected:
            self.get_in_touch()

    def get_in_touch(self) -> None:
        """Let steps pass until the vehicle's mode is known: as it was told a moment ago. Raises as `step` does."""
        while (dark := self.deadman.dark(self._clock.moment)) or not self.vehicle.mode_known():
            if not dark and time.monotonic() - self._doubted_at > SILENCE_WALL_S:
                raise SilentError(f"autopilot at {self._config.autopilot}: no answer for {SILENCE_WALL_S:g} s")
            self._pass()

    def _pass(self) -> None:
        self._hear()
        self._judge()
        if self.helm.slots is not None:
            self._keep_slots(self.helm.slots)
        self._steer()
        self._report()
        self._clock.step(self.vehicle, self._meanwhile)
        self._steps += 1
        self._attend()

    def idle(self) -> None:
        """Hear the bus while vehicle time stands still. Raises End."""
        self._hear()
        self._publish_health()
        self.excuse_silence()
        time.sleep(0.01)

    def end(self) -> None:
        """The last words."""
        self.phase = "ended"
        self._publish_state()
        self._publish_health(final=True)

    # Hearing and judging.

    def _hear(self) -> None:
        """Nodes that come and go, and commands. Raises End."""
        while not self._ground.changes.empty():
            node, alive = self._ground.changes.get()
            known = self._alive.get(node)
            self._alive[node] = alive
            if node in PEERS and known is not None and known != alive:
                self.tell("node_back" if alive else "node_lost", f"{node} node is {'back' if alive else 'gone'}")
            if node == "mission" and known and not alive and not self.started:
                raise End(None, ERROR, "the mission is gone before the start")
        while not self._ground.commands.empty():
            command = self._ground.commands.get()
            self.tell("command", command)
            match command:
                case "start":
                    self.started = True
                case "hold":
                    self.held = True
                case "resume":
                    self.held = False
                case "return":
                    raise End(Mode.RETURN, FAILSAFE, "return was commanded")
                case "land":
                    raise End(Mode.LAND, FAILSAFE, "land was commanded")

    def _judge(self) -> None:
        """The ladder, the fence, the battery, while the vehicle is ours. Raises End."""
        if not self.expected:
            return
        rung, helm = self.deadman.rung(self._clock.moment), self.helm
        if rung is not self._rung:
            self.tell("ladder", f"{self._rung.name} -> {rung.name}: {self.deadman.why}")
            self._rung = rung
            if rung in (Rung.HOLD_MODE, Rung.RETURN) and self.deadman.stale(self._clock.moment):
                self.vehicle.ask_for_telemetry()
        if rung is Rung.RETURN and not self.deadman.coming_down:
            raise End(Mode.RETURN, FAILSAFE, self.deadman.why)
        if not (helm.steering or self.resting):
            return
        position, velocity = helm.here()
        if outside_m(helm.fence, position) > BREACH_M:
            raise End(Mode.RETURN, FAILSAFE, f"outside the fence at {rounded(position)}")
        self._judge_energy(position, velocity)

    def _attend(self) -> None:
        """What the step has brought: is it news, is there anybody, is the vehicle still ours? Raises SilentError."""
        now, wall, deadman = self._clock.moment, time.monotonic(), self.deadman
        stale = deadman.stale(now)
        if self.vehicle.heard != self._heard:
            self._heard = self.vehicle.heard
            deadman.heard(now)
        if self._attention.stalled(now):
            self.excuse_silence()
            self._doubt(f"{now.wall_s - self._attention.listened.wall_s:.1f} s without listening")
        self._attention.listened = now
        telemetry = self.vehicle.telemetry
        if telemetry.heartbeats != self._heartbeats:
            self._heartbeats = telemetry.heartbeats
            deadman.told_mode(now)
        if telemetry.position_enu is not None and telemetry.position_s != self._position_s:
            self._position_s = telemetry.position_s
            deadman.placed(Moment(telemetry.position_s, now.wall_s))
        if stale and not deadman.stale(now):
            self._doubt("telemetry is back")
        if self.takeoff is not None and telemetry.position_enu is not None:
            self._broken_off = self.takeoff.broken_off(telemetry.mode, float(telemetry.position_enu[2]), now)
        self._judge_silence(wall)
        self._judge_hands()

    def _judge_silence(self, wall_s: float) -> None:
        """Raises SilentError."""
        all_messages, heartbeats = self._silences
        silent = all_messages.over(self.vehicle.heard, wall_s)
        untold = heartbeats.over(self.vehicle.telemetry.heartbeats, wall_s)
        if (silent or untold) and self.phase != "connecting":
            what, limit_s = ("telemetry", SILENCE_WALL_S) if silent else ("HEARTBEAT", HEARTBEAT_WALL_S)
            raise SilentError(f"autopilot at {self._config.autopilot}: no {what} for {limit_s:g} s")

    def excuse_silence(self) -> None:
        """We kept the vehicle waiting, or were not listening."""
        for silence in self._silences:
            silence.excuse(time.monotonic())

    def _doubt(self, why: str) -> None:
        """Somebody else may have taken the vehicle meanwhile; PX4 gives it back to any stream of setpoints."""
        if not self.expected:
            return
        if self.vehicle.mode_known():
            self.tell("stall", f"{why}: nothing is sent before the mode is known anew")
            self._counters["stalls"] += 1
            self._doubted_at = time.monotonic()
        self.vehicle.doubt_mode()

    def _judge_hands(self) -> None:
        """Who flies? Raises End, Yielded."""
        telemetry = self.vehicle.telemetry
        if self.flying and not telemetry.armed:
            raise End(None, FAILSAFE, f"the vehicle disarmed in mode {telemetry.mode_name}")
        if self._taken:
            self.expected, self.resting, self.takeoff, self._broken_off = set(), False, None, False
            self.helm.let_go()
            self.tell("mode", f"{telemetry.mode_name} was chosen by autopilot or pilot: obeyed")
            raise Yielded

    @property
    def _taken(self) -> bool:
        """Whether the vehicle was ours, and a HEARTBEAT has told that it no longer is."""
        telemetry = self.vehicle.telemetry
        ours = telemetry.mode in self.expected and not self._broken_off
        if telemetry.mode is Mode.OTHER:
            ours = ours and telemetry.mode_name == self.other_mode
        return bool(self.expected) and telemetry.armed and not ours

    def _may_send(self) -> bool:
        """Whether a setpoint may go out now: the vehicle is ours for all that we know, and we know it from just now."""
        now = self._clock.moment
        return not (
            self._taken
            or not self.vehicle.telemetry.armed
            or not self.vehicle.mode_known()
            or self._attention.stalled(now)
            or self.deadman.stale(now)
        )

    def _steer(self) -> None:
        """Listens once more when what came before has taken long."""
        if self.helm.steering and self._clock.moment.since(self._attention.listened) > LISTENED_S:
            self.vehicle.poll(0.0)
        self.helm.steer()

    def _judge_energy(self, position: Vector, velocity: Vector) -> None:
        """Raises End."""
        endurance = self._config.endurance
        if endurance is None:
            return
        left_j, needed_j = self.helm.left_j(endurance), endurance.needed_j(self.helm.stop(position, velocity))
        if left_j < needed_j:
            held = f"the battery holds {max(left_j, 0.0) / 1e3:.1f} kJ"
            raise End(Mode.RETURN, FAILSAFE, f"the way home needs {needed_j / 1e3:.1f} kJ, {held}")

    # The slots.

    def _keep_slots(self, slots: Slots) -> None:
        """Open what is due, take what has come, hold what has not."""
        position, velocity = self.helm.here()
        if slots.due(self._clock.now):
            opened = slots.open(position, velocity, self.vehicle.telemetry.attitude_rad)
            self._malformed = self._ground.malformed_actions
            self._ground.slot.send(opened)
            if not slots.closed:
                self.deadman.opened(self._clock.moment._replace(vehicle_s=opened.time_s))
            if opened.flown is not None:
                self._account(opened.flown)
            if self._clock.frozen_between_steps and not slots.closed:
                self._await_action(slots)
        self._take_actions(slots)
        if self.held and self.helm.steering and slots.acting:  # `hold` means now, not after the slot
            slots.hold(self._clock.now, "rejected", "held by command")
        if slots.awaiting and self.deadman.late(self._clock.moment):
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
        self.excuse_silence()
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
        elif slots.act(action, self._clock.now, self._idle_because()):
            self.deadman.acted(self._clock.moment)

    def _idle_because(self) -> str | None:
        """Why a good action is not flown; None: it is."""
        if self.resting:
            return f"the autopilot holds in {self.vehicle.telemetry.mode_name}"
        if not self.helm.steering:
            return f"control yielded to {self.vehicle.telemetry.mode_name}"
        if self.deadman.stale(self._clock.moment):
            return "no position"
        return "held by command" if self.held else None

    def _meanwhile(self) -> None:
        """Between two steps, when something has come: neither an action nor a new state waits for the next step."""
        slots = self.helm.slots
        if slots is not None and slots.awaiting and not self._ground.actions.empty():
            self._take_actions(slots)
            if slots.acting:
                self.helm.steer()
        if abs(self.vehicle.telemetry.position_s - self._position_told_s) >= SAMPLE_S - EARLY_S:
            self._publish_state()

    # Telling.

    def _report(self) -> None:
        hz = self._config.setpoint_hz
        if self._clock.moment.since(self._beaten) > BEAT_S - 1e-6 or self._clock.now < self._beaten.vehicle_s:
            self._beaten = self._clock.moment
            self.vehicle.beat()
        if self._clock.frozen_between_steps:
            if self._steps % round(hz * SAMPLE_S) == 0:
                self._publish_state()
        elif self._clock.now - self._state_told_s >= 1.5 * SAMPLE_S:  # no telemetry came that told it
            self._publish_state()
        for text in self.vehicle.status_texts():
            self.tell("statustext", text)
        for text in self.vehicle.remarks():
            self.tell("vehicle", text)
        slots = self.helm.slots
        if slots is not None and self.helm.steering and slots.decided:
            self.enter("slots" if slots.acting else "holding")
        self._publish_health()

    def _account(self, flown: m.FlownSlot) -> None:
        self._counters[f"slots_{flown.outcome}"] += 1
        told = [reason for reason in flown.reasons if reason not in ("acceleration", "speed", "climb")]
        if told:
            self.tell("slot", f"slot {flown.slot} {flown.outcome}: {', '.join(told)}")

    def _publish_state(self) -> None:
        telemetry = self.vehicle.telemetry
        if telemetry.position_enu is None:
            return
        self._state_told_s, self._position_told_s = self._clock.now, telemetry.position_s
        position, velocity = self.helm.here()
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
                phase=self.phase,
                position_age_s=max(0.0, self._clock.now - telemetry.position_s - CARRIED_S),
                stop_enu=vec3(self.helm.stop(position, velocity)) if telemetry.armed else None,
            )
        )

    def _publish_health(self, final: bool = False) -> None:
        self._ground.publish_health(lambda: self._counters + self.helm.counters + self.vehicle.counters, final)

    # Commands: on zenoh's thread, so only single reads.

    def _objection(self, name: m.CommandName) -> str:
        """Why a command cannot be taken now; empty when it can."""
        phase = self.phase
        if phase == "ended":
            return "the flight is over"
        match name:
            case "start" if self.started:
                return "already started"
            case "start" if self.vehicle.telemetry.armed:
                return f"somebody else has armed the vehicle, in mode {self.vehicle.telemetry.mode_name}"
            case "hold" if phase not in ("takeoff", "transit", "slots", "holding"):
                return f"nothing to hold in phase {phase}"
            case "resume" if phase not in ("holding", "yielded") or not self.flying:
                return f"nothing to resume in phase {phase}"
            case "resume":
                position = self.vehicle.telemetry.position_enu
                if position is None or outside_m(self.helm.fence, position) > 0:
                    return "the vehicle is outside the fence"
        return ""


def rounded(position: Vector) -> str:
    """For people."""
    return f"({', '.join(f'{c:.1f}' for c in position.tolist())}) m"
