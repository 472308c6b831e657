"""Vehicle time, one step at a time: owned by the bridge (lockstep) or by the autopilot (paced)."""

import time
from collections.abc import Callable
from typing import Protocol

from autopilot_bridge.deadman import Moment
from autopilot_bridge.link import ControlLine
from autopilot_bridge.vehicle import SilentError, Vehicle

TELEMETRY_WALL_S = 0.5
"""How long a lockstep step's telemetry may take to arrive before it counts as lost."""
WENT_BACK_S = 1.0
"""Telemetry this much older than the newest is no late datagram: the autopilot has started anew."""
UNHEARD_S = 0.1
"""Vehicle time is carried on over this long [s of vehicle time] without hearing anything, then it stands still."""


class Clock(Protocol):
    """Steps of vehicle time."""

    @property
    def now(self) -> float:
        """Vehicle time [s] at the last step; while `meanwhile` is called, that of the call."""

    @property
    def moment(self) -> Moment:
        """Now, on both clocks."""

    @property
    def frozen_between_steps(self) -> bool:
        """Whether the vehicle waits for us, so that waiting for something costs no vehicle time."""

    def step(self, vehicle: Vehicle, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Let one step pass and take in the telemetry of it; `meanwhile` is called whenever something has come."""

    def close(self, over: bool) -> None:
        """Let go of vehicle time; `over`: nobody will need it any more."""


class Lockstep:
    """The SITL moves only when told to, by `step_ms` at a time. Raises LinkError when it does not answer.

    Vehicle time stands still while telemetry comes in, so `meanwhile` is never called.
    """

    frozen_between_steps = True

    def __init__(self, control: str, step_ms: int) -> None:
        self._line = ControlLine(control)
        self._step_ms = step_ms
        self.now = self._line.hello()

    @property
    def moment(self) -> Moment:
        return Moment(self.now, self.now)

    def step(self, vehicle: Vehicle, meanwhile: Callable[[], None] = lambda: None) -> None:
        before = vehicle.frames_received
        self.now, sent = self._line.advance(self._step_ms)
        deadline = time.monotonic() + TELEMETRY_WALL_S
        while (missing := before + sent - vehicle.frames_received) > 0:
            if time.monotonic() > deadline:
                vehicle.counters["frames_lost"] += missing
                return
            vehicle.poll(0.05)

    def close(self, over: bool) -> None:
        if over:
            self._line.quit()
        self._line.close()


class Paced:
    """The autopilot's own clock, read from its telemetry, `speed` times as fast as the wall clock.

    A step ends when vehicle time reaches the next multiple of the step, so steps do not drift against it. While the
    autopilot is heard but does not tell its time (PX4 sends no position without an estimate), the wall clock carries
    vehicle time on. When it falls silent, vehicle time stops; steps then take a wall-clock step each, so that silence
    can be noticed. When it goes back, a step raises SilentError, once: the vehicle that we knew is gone, and time goes
    on with the new one's. Every step listens, also one that is over before it has begun.
    """

    frozen_between_steps = False

    def __init__(self, speed: float, step_ms: int) -> None:
        self._speed, self._step_ms = speed, step_ms
        self._telemetry_s = 0.0
        self._told_at = self._heard_at = time.monotonic()
        self._heard = 0
        self._steps = 0
        self.now = 0.0

    @property
    def moment(self) -> Moment:
        return Moment(self.now, time.monotonic() * self._speed)

    def step(self, vehicle: Vehicle, meanwhile: Callable[[], None] = lambda: None) -> None:
        last_s, due_s = self._at(self._steps), self._at(self._steps + 1)
        give_up = time.monotonic() + max(2 * self._step_ms / 1000 / self._speed, UNHEARD_S / self._speed)
        if due_s - self._estimate(vehicle) <= 1e-6:
            vehicle.poll(0.0)
        while (left_s := due_s - self._estimate(vehicle)) > 1e-6:
            wall = time.monotonic()
            if wall >= give_up:
                self.now = last_s
                return
            vehicle.poll(min(left_s / self._speed, give_up - wall))
            self.now = min(max(self._estimate(vehicle), last_s), due_s)
            meanwhile()
        behind = int((self._estimate(vehicle) - due_s) / (self._step_ms / 1000))
        if behind > 0 and self._steps > 0:
            vehicle.counters["steps_skipped"] += behind
        self._steps += 1 + max(behind, 0)
        self.now = self._at(self._steps)

    def close(self, over: bool) -> None:
        """The autopilot's clock goes on without us."""

    def _at(self, steps: int) -> float:
        return steps * self._step_ms / 1000

    def _estimate(self, vehicle: Vehicle) -> float:
        told_s = vehicle.telemetry.time_s
        if told_s < self._telemetry_s - WENT_BACK_S:
            before_s, self._telemetry_s, self._told_at = self._telemetry_s, told_s, time.monotonic()
            self._steps = int(told_s * 1000 / self._step_ms)
            self.now = self._at(self._steps)
            raise SilentError(
                f"the autopilot's clock went back from {before_s:.1f} to {told_s:.1f} s: it has restarted"
            )
        wall = time.monotonic()
        if told_s != self._telemetry_s:
            self._telemetry_s, self._told_at = told_s, wall
        if vehicle.heard != self._heard:
            self._heard, self._heard_at = vehicle.heard, wall
        carried_s, heard_s = (wall - self._told_at) * self._speed, (self._heard_at - self._told_at) * self._speed
        return self._telemetry_s + min(carried_s, max(heard_s, 0.0) + UNHEARD_S)
