"""Energy to return: what the way home costs by the airframe's power model, against what the battery still holds.

The autopilot's return is taken to be: brake, climb to the return altitude, fly straight home level, come straight down.

    E = P(0, climb) dh_up / climb + P(cruise) d / cruise + P(0) dh_down / descent

with P of `airframe.power`, and d, h where the vehicle comes to rest. The margin is for what that leaves out: wind,
braking, the autopilot's hovering before it descends and lands.
"""

import math
from functools import cached_property
from typing import Annotated

from pydantic import Field

from airframe.power import NO_PANEL, Panel, RotaryWing, total_power
from airframe.pulse import Triple
from airframe.slot_profile import Vector, triple
from autopilot_bridge.fence import Strict

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Endurance(Strict):
    """The pack, and how the autopilot returns."""

    pack_j: Positive
    """The full pack's energy [J] (1 Wh = 3600 J); the autopilot tells what share of it remains."""
    margin: Annotated[float, Field(ge=0, le=5, allow_inf_nan=False)] = 0.3
    """This share is added to the energy that the way home needs."""
    cruise_mps: Positive = 5.0
    """PX4 MPC_XY_CRUISE."""
    climb_mps: Positive = 3.0
    descent_mps: Positive = 0.7
    """PX4 MPC_LAND_SPEED, all the way: more than a return takes."""
    return_altitude_m: Annotated[float, Field(ge=0, le=1000)] = 30.0
    """Above home; PX4 RTL_RETURN_ALT."""
    wing: RotaryWing = RotaryWing()
    panel: Panel = NO_PANEL

    def needed_j(self, position: Vector | Triple) -> float:
        """Energy [J], margin included, to be home and down from a standstill at `position` [m, ENU about home]."""
        east, north, up = triple(position)
        height = max(up, 0.0)
        top = max(height, self.return_altitude_m)
        climb, way, descent = self._per_metre_j
        return (1 + self.margin) * (climb * (top - height) + way * math.hypot(east, north) + descent * top)

    @cached_property
    def _per_metre_j(self) -> tuple[float, float, float]:
        """Of climb, of the way home, and of descent."""
        climb = self._power(0.0, self.climb_mps) / self.climb_mps
        way = self._power(self.cruise_mps, 0.0) / self.cruise_mps
        return climb, way, self._power(0.0, 0.0) / self.descent_mps

    def _power(self, forward_mps: float, climb_mps: float) -> float:
        """[W], the panel broadside to the way."""
        return float(total_power(self.wing, self.panel, forward_mps, 0.0, climb_mps, 1.0, 0.0))

    def left_j(self, battery_remaining: float | None) -> float:
        """What the pack holds [J]; an autopilot that does not tell is taken to be empty."""
        return self.pack_j * battery_remaining if battery_remaining is not None else -math.inf
