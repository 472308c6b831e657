"""The flying vehicle: control law and physics stepped together at 250 Hz or more, in compiled code."""

import math

from sitl.compiled import compiled
from sitl.control import Controller, Gains, Setpoint, control, controller_at_rest, rest
from sitl.physics import Body, Rotorcraft, body_at_rest, heading, step_body

STEP_MS = 4.0
"""Longest physics step [ms]: 250 Hz, PX4's SIH rate."""

NAN3 = (math.nan, math.nan, math.nan)
NOTHING = Setpoint(NAN3, NAN3, NAN3, math.nan, math.nan)
"""Setpoint that controls no axis."""


@compiled
def advance(
    body: Body, c: Controller, setpoint: Setpoint, gains: Gains, craft: Rotorcraft, flying: bool, dt: float, steps: int
) -> None:
    """`steps` steps of dt [s]. Not flying: motors off, the controller forgets."""
    for _ in range(steps):
        if flying:
            control(body, c, setpoint, gains, dt)
        else:
            rest(c, heading(body.attitude))
        step_body(body, c.commands, craft, dt)


class FlightModel:
    """A vehicle at rest at the local origin, to be advanced tick by tick."""

    def __init__(self, gains: Gains, craft: Rotorcraft) -> None:
        self.body = body_at_rest()
        self.controller = controller_at_rest()
        self.gains = gains
        self.craft = craft

    def advance(self, setpoint: Setpoint, flying: bool, tick_ms: int) -> None:
        """Move by tick_ms of vehicle time in the fewest equal steps of at most 4 ms."""
        steps = math.ceil(tick_ms / STEP_MS)
        dt = tick_ms / 1000.0 / steps
        advance(self.body, self.controller, setpoint, self.gains, self.craft, flying, dt, steps)


def compile_now(gains: Gains, craft: Rotorcraft) -> None:
    """Compile (or load from the disk cache) before the clock starts."""
    FlightModel(gains, craft).advance(NOTHING, True, 4)
