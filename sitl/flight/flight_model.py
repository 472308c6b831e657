"""The flying vehicle: control law and physics stepped together at 250 Hz or more, in compiled code, in its world."""

import math

import numpy as np
from numpy.typing import NDArray

from airframe.power import Panel
from sitl.flight.battery import propulsion_power
from sitl.flight.compiled import compiled
from sitl.flight.constants import packed, unpacked_craft, unpacked_gains
from sitl.flight.control import Controller, Gains, Setpoint, control, controller_at_rest, rest
from sitl.flight.physics import Body, Rotorcraft, body_at_rest, heading, step_body
from sitl.flight.sensors import Estimator, Faults, Loss
from sitl.flight.wind import Gusts
from sitl.flight.world import World

STEP_MS = 4.0
"""Longest physics step [ms]: 250 Hz, PX4's SIH rate."""
OVERTURNED = math.sin(math.radians(45.0) / 2.0) ** 2
"""sin^2 of half the tilt: what meets the ground tilted by more than 45 degrees does not fly again."""

POWER_MS = 50
STILL_AIR = World()
WHOLE = [1.0, 1.0, 1.0, 1.0]
NAN3 = (math.nan, math.nan, math.nan)
NOTHING = Setpoint(NAN3, NAN3, NAN3, math.nan, math.nan)
"""Setpoint that controls no axis."""


@compiled
def advance(
    body: Body,
    c: Controller,
    setpoint: Setpoint,
    constants: NDArray[np.float64],
    flying: bool,
    dt: float,
    steps: int,
) -> None:
    """`steps` steps of dt [s]. Not flying: motors off, the controller forgets."""
    gains, craft = unpacked_gains(constants), unpacked_craft(constants)
    for _ in range(steps):
        if flying:
            control(body, c, setpoint, gains, dt)
        else:
            rest(c, heading(body.attitude))
        step_body(body, c.commands, craft, dt)


class FlightModel:
    """A vehicle at rest at the local origin, to be advanced tick by tick."""

    def __init__(self, gains: Gains, craft: Rotorcraft, world: World = STILL_AIR, seed: int = 0) -> None:
        self.truth = body_at_rest()
        """Where the vehicle is."""
        self.estimator = Estimator(world.estimator_error_m, seed)
        self.body = self.truth if self.estimator.perfect else believed(self.truth)
        """Where it believes to be: what the autopilot sees; the same object when the estimator is perfect."""
        self.controller = controller_at_rest()
        self.gains = gains
        self.craft = craft
        self.world = world
        self.faults = Faults()
        self.wrecked = False
        """Whether it fell on its back; it does not fly again."""
        self._overturned = False
        self.power_w = 0.0
        """What flying takes [W]."""
        self._power_due_ms = 0
        self._packed: tuple[Gains, Rotorcraft, NDArray[np.float64]] | None = None
        self._gusts = Gusts(seed)

    def sense(self, now_ms: int) -> None:
        """Look at what the sensors give at a time, and at times at the power that flying takes."""
        if now_ms >= self._power_due_ms:
            self._power_due_ms = now_ms + POWER_MS
            panel = Panel(self.world.panel_area_m2, self.world.panel_drag_coefficient)
            self.power_w = propulsion_power(self.truth, panel)
        faults, world = self.faults, self.world
        gps = world.gps_fix and not faults.lost(Loss.GPS, now_ms)
        self.estimator.step(now_ms, gps, not faults.lost(Loss.ESTIMATOR, now_ms), world.dead_reckoning_s)

    def repair(self) -> None:
        """All motors whole again, and the frame too."""
        self.faults.motors[:] = WHOLE
        self.wrecked = False

    def advance(self, setpoint: Setpoint, flying: bool, tick_ms: int) -> None:
        """Move by tick_ms of vehicle time in the fewest equal steps of at most 4 ms."""
        steps = math.ceil(tick_ms / STEP_MS)
        dt = tick_ms / 1000.0 / steps
        wind = self.world.wind
        self.truth.air[:] = wind.mean if wind.w20 == 0.0 else self._gust(tick_ms / 1000.0)
        if not self.estimator.perfect:
            setpoint = self._seen(setpoint, tick_ms / 1000.0)
        advance(self.truth, self.controller, setpoint, self._constants(), flying, dt, steps)
        q = self.truth.attitude
        if self._overturned and self.truth.contact_s[0] > 0.0:
            self.wrecked = True
        self._overturned = bool(q[1] * q[1] + q[2] * q[2] > OVERTURNED)
        if not self.estimator.perfect:
            self.body.position[:] = self.truth.position + self.estimator.position_error
            self.body.velocity[:] = self.truth.velocity + self.estimator.velocity_error

    def _constants(self) -> NDArray[np.float64]:
        """Gains and craft as they are now, packed anew only when they changed."""
        gains, craft = self.gains, self._whole()
        if self._packed is None or self._packed[0] is not gains or self._packed[1] is not craft:
            self._packed = (gains, craft, packed(gains, craft))
        return self._packed[2]

    def _whole(self) -> Rotorcraft:
        """The craft as its faults leave it."""
        if self.wrecked:
            return self.craft._replace(health=(0.0, 0.0, 0.0, 0.0))
        if self.faults.motors == WHOLE:
            return self.craft
        a, b, c, d = (left * given for left, given in zip(self.faults.motors, self.craft.health, strict=True))
        return self.craft._replace(health=(a, b, c, d))

    def _gust(self, dt: float) -> tuple[float, float, float]:
        vn, ve, vd = self.truth.velocity.tolist()
        an, ae, ad = self.truth.air.tolist()
        airspeed = math.hypot(vn - an, ve - ae, vd - ad)
        return self._gusts.step(self.world.wind, -float(self.truth.position[2]), airspeed, dt)

    def _seen(self, setpoint: Setpoint, dt: float) -> Setpoint:
        """The setpoint that makes of the truth what the control law would make of the estimate."""
        self.estimator.wander(dt)
        px, py, pz = self.estimator.position_error.tolist()
        vx, vy, vz = self.estimator.velocity_error.tolist()
        x, y, z = setpoint.position
        u, v, w = setpoint.velocity
        return setpoint._replace(position=(x - px, y - py, z - pz), velocity=(u - vx, v - vy, w - vz))


def believed(truth: Body) -> Body:
    """A body with a position and a velocity of its own; all else is the true body's."""
    return truth._replace(position=truth.position.copy(), velocity=truth.velocity.copy())


def compile_now(gains: Gains, craft: Rotorcraft) -> None:
    """Compile (or load from the disk cache) before the clock starts."""
    FlightModel(gains, craft).advance(NOTHING, True, 4)
