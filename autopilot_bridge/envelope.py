"""The envelope: nothing reaches the autopilot that it does not let through, whatever planned or asked for it.

Every setpoint passes, in this order: finite; speed limits; acceleration (no command asks for a change of velocity that
takes longer than `RESPONSE_S` at the acceleration limit); then whatever the vehicle must stay inside of: fence and
altitude band, distance to home, the energy to return, its side of the gap to every other vehicle.

These are kept by looking one step ahead with the vehicle's stop as a backup. A state is *safe* when the vehicle,
reacting after `reaction_s` and then braking straight at the acceleration limit, stops inside, and its whole way there
lies inside. A command is let through when the state that it leads to in one step is safe, and so is that step's way,
and a vehicle that had reached the command by then could stop inside too: so commands shrink towards a wall and do not
jump. Else what is in the way is taken out, the part against the wall first, so that the vehicle slides along, then
as little of the whole as is needed. Zero, which is braking, always leads from a safe state to a safe one: its way, and
the stop after it, are parts of the stop that was safe before, and a shape that holds a line, convex or not, holds its
parts.

A step's way bends: while the velocity changes from v to v' the vehicle flies a parabola from p to q, inside the
triangle of p, q and p + v t/2, where its tangents meet. All three sides are looked at. A polygon that holds them holds
the whole triangle, since it has no holes.

Vehicles differ in how they share out acceleration between level and vertical: some turn the velocity straight to the
command, some do both axes at once and are there sooner. Both are looked at; stops are the straight one's, the longer.

A vehicle that is outside already may do what brings its stop back. One that cannot stop inside any more (wind, or an
autopilot slower than its limits) is called back, since real velocity loops are slow to forget what they held against.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from airframe.slot_profile import Vector
from autopilot_bridge.config import Limits
from autopilot_bridge.energy import Endurance
from autopilot_bridge.fence import TOUCH_M, Cylinder, Fence, Plan
from autopilot_bridge.separation import Track, own_side

RESPONSE_S = 1.5
"""A command may be ahead of the measured velocity by this long at the acceleration limit."""
BISECTIONS = 14
HOME = (0.0, 0.0)
CALL_BACK = 1.0
"""[1/s] Speed inward for each metre that a stop would end outside."""
WALLS = 3
"""A command slides along so many walls at most before all of it is shortened."""


class Bound(Protocol):
    """What in plan must not be left."""

    def holds(self, path: Plan) -> bool:
        """Whether all of a polyline (n, 2) is inside."""

    def beyond_m(self, path: Plan) -> float:
        """How far its furthest vertex is outside [m]."""

    def wall(self, path: Plan) -> Plan:
        """Outward unit normal of what is in the way of it, (2,)."""


@dataclass(frozen=True)
class Sent:
    """What was really sent, and why it is not what was wanted."""

    velocity: Vector
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Envelope:
    """The last gate before the autopilot; `transmit(velocity_enu, yaw_enu)` puts a setpoint on the wire."""

    limits: Limits
    fence: Fence
    reaction_s: float
    step_s: float
    transmit: Callable[[Vector, float], None]
    home_distance_m: float | None = None
    endurance: Endurance | None = None
    separation_m: float = 0.0

    def send(
        self,
        wanted: Vector,
        yaw: float,
        position: Vector,
        velocity: Vector,
        others: Sequence[Track] = (),
        energy_j: float | None = None,
    ) -> Sent:
        """Clip `wanted` [m/s, ENU] for a vehicle at `position`, `velocity`; transmit it; say what was sent and why.

        `others` are the vehicles to keep `separation_m` from; `energy_j` is left in the pack, None: unknown.
        """
        sent = self.clip(wanted, position, velocity, others, energy_j)
        self.transmit(sent.velocity, yaw)
        return sent

    def clip(
        self,
        wanted: Vector,
        position: Vector,
        velocity: Vector,
        others: Sequence[Track] = (),
        energy_j: float | None = None,
    ) -> Sent:
        """What `send` would transmit."""
        if not (np.isfinite(wanted).all() and np.isfinite(position).all() and np.isfinite(velocity).all()):
            return Sent(np.zeros(3), ("not finite",))
        reasons: list[str] = []

        slower = self.limit_speed(wanted)
        if not np.array_equal(slower, wanted):
            reasons.append("speed")

        gentler = self.within_response(slower, velocity)
        if gentler is not slower:
            reasons.append("acceleration")

        step = _Step(self, position, velocity, others, energy_j)
        safe, blocked = step.nearest_safe(gentler)
        return Sent(safe, () if np.array_equal(safe, wanted) else (*reasons, *blocked))

    def stop(self, position: Vector, velocity: Vector) -> Vector:
        """Where a vehicle comes to rest that brakes straight after the reaction; shapes (..., 3)."""
        return stopping_point(position, velocity, self.limits, self.reaction_s)

    def bounds(self, position: Vector, velocity: Vector, others: Sequence[Track]) -> Iterator[tuple[str, Bound]]:
        """What the vehicle must stay inside of in plan, and what it is called."""
        yield "fence", self.fence
        if self.home_distance_m is not None:
            yield "home distance", Cylinder(centre=HOME, radius=self.home_distance_m, altitude=self.fence.altitude)
        if self.separation_m > 0:
            own = np.array([position, self.stop(position, velocity)])[:, :2]
            for other in others:
                end = other.stop if other.stop is not None else self.stop(other.position, other.velocity)
                theirs = np.array([other.position, end])[:, :2]
                apart_m = self.separation_m + 2 * other.age_s * self.limits.horizontal_mps
                yield "separation", own_side(own, theirs, apart_m)

    def within_response(self, command: Vector, velocity: Vector) -> Vector:
        """`command`, no further ahead of the `velocity` now than `RESPONSE_S` at the acceleration limit."""
        change = command - velocity
        needed_s = float(self.limits.time_to_change(change))
        return command if needed_s <= RESPONSE_S else self.limit_speed(velocity + change * (RESPONSE_S / needed_s))

    def limit_speed(self, velocity: Vector) -> Vector:
        """`velocity`, shortened sideways and clipped vertically to the limits."""
        horizontal = float(np.hypot(velocity[0], velocity[1]))
        vertical = min(max(float(velocity[2]), -self.limits.down_mps), self.limits.up_mps)
        if horizontal <= self.limits.horizontal_mps and vertical == velocity[2]:
            return velocity
        shorter = min(1.0, self.limits.horizontal_mps / horizontal) if horizontal > 0 else 1.0
        return np.array([velocity[0] * shorter, velocity[1] * shorter, vertical])


class _Step:
    """One step ahead of a vehicle."""

    def __init__(
        self, envelope: Envelope, position: Vector, velocity: Vector, others: Sequence[Track], energy_j: float | None
    ) -> None:
        self._envelope, self._position, self._velocity, self._energy_j = envelope, position, velocity, energy_j
        self._bounds = tuple(envelope.bounds(position, velocity, others))

    def nearest_safe(self, wanted: Vector) -> tuple[Vector, tuple[str, ...]]:
        """`wanted` itself when it is safe; else what is nearest to it of what is tried, and what was in the way."""
        target, blocked = wanted, self._in_the_way(wanted)
        if not blocked:
            return wanted, ()
        told = dict.fromkeys(blocked)
        for _ in range(WALLS):
            if blocked:
                target = self._without(target, blocked)
                blocked = self._in_the_way(target)
                told |= dict.fromkeys(blocked)
        if blocked:
            target = np.zeros(3)
            if self._in_the_way(target):
                return self._envelope.within_response(self._call_back(), self._velocity), tuple(told)
        good, bad = 0.0, 1.0
        for _ in range(BISECTIONS):
            share = (good + bad) / 2
            if self._in_the_way(target + share * (wanted - target)):
                bad = share
            else:
                good = share
        return target + good * (wanted - target), tuple(told)

    def _call_back(self) -> Vector:
        """Braking, and more: inward as fast as the stop is far outside."""
        envelope = self._envelope
        stop = envelope.stop(self._position, self._velocity)
        inward = np.zeros(3)
        for _, bound in self._bounds:
            path = np.array([self._position, stop])[:, :2]
            inward[:2] -= CALL_BACK * bound.beyond_m(path[-1:]) * bound.wall(path)
        low, high = envelope.fence.altitude
        inward[2] = CALL_BACK * (min(max(float(stop[2]), low), high) - stop[2])
        return envelope.limit_speed(inward)

    def _in_the_way(self, command: Vector) -> dict[str, Plan]:
        """What does not let `command` through: its name, and the wall's normal (zero: not in plan)."""
        envelope = self._envelope
        blocked: dict[str, Plan] = {}
        low, high = envelope.fence.altitude
        here = max(low - self._position[2], self._position[2] - high)
        for way in _ways(self._position, self._velocity, command, envelope):
            path, stop = way[:, :2], way[-1]
            for name, bound in self._bounds:
                if name not in blocked and not self._kept(bound, path):
                    blocked[name] = bound.wall(path[-3:])
            over = max(low - way[:, 2].min(), way[:, 2].max() - high)
            if over > TOUCH_M and (here <= TOUCH_M or max(low - stop[2], stop[2] - high) > here):
                blocked["altitude"] = np.zeros(2)
            if envelope.endurance is not None and self._energy_j is not None and self._spends_too_much(stop):
                blocked["energy"] = stop[:2] / max(float(np.hypot(stop[0], stop[1])), 1e-9)
        return blocked

    def _kept(self, bound: Bound, path: Plan) -> bool:
        if bound.holds(path):
            return True
        here = bound.beyond_m(self._position[None, :2])
        return here > TOUCH_M and bound.beyond_m(path[-1:]) <= here  # on its way back

    def _spends_too_much(self, stop: Vector) -> bool:
        """Whether the way home from `stop` costs more than is left, and more than from here."""
        endurance, envelope = self._envelope.endurance, self._envelope
        assert endurance is not None
        needed = endurance.needed_j(stop)
        if self._energy_j is None or needed <= self._energy_j:
            return False
        return needed > endurance.needed_j(envelope.stop(self._position, self._velocity))

    def _without(self, command: Vector, blocked: dict[str, Plan]) -> Vector:
        """`command` less its part against each wall in its way."""
        slid = command.copy()
        for name, outward in blocked.items():
            slid[:2] -= max(0.0, float(slid[:2] @ outward)) * outward
            if name == "altitude" or (name == "energy" and slid[2] > 0):
                slid[2] = 0.0
        return slid


def stopping_point(position: Vector, velocity: Vector, limits: Limits, reaction_s: float = 0.0) -> Vector:
    """Where a vehicle comes to rest that brakes straight after `reaction_s`; shapes (..., 3)."""
    duration = limits.time_to_change(velocity)
    point: Vector = position + velocity * (reaction_s + np.asarray(duration)[..., None] / 2)
    return point


def _ways(position: Vector, velocity: Vector, command: Vector, envelope: Envelope) -> Iterator[Vector]:
    """Corners (n, 3) of what must lie inside, each ending with a stop: one step's way, for both kinds of vehicles.

    In it q is where the velocity has reached `command`, or the step's end p' if that comes first. And the stop of a
    vehicle that has reached `command` by p': real ones may be nearer to that than the acceleration limit says, and
    commands become smaller towards a wall before they must.
    """
    limits, step_s = envelope.limits, envelope.step_s
    change = command - velocity
    level_s = float(np.hypot(change[0], change[1])) / limits.acceleration_mps2
    straight_s = np.full(3, float(limits.time_to_change(change)))
    by_axes_s = np.array([level_s, level_s, abs(change[2]) / limits.vertical_mps2])
    for needed_s in (straight_s, by_axes_s):
        ramp_s = np.minimum(needed_s, step_s)
        reached = velocity + change * np.where(needed_s > 0, ramp_s / np.maximum(needed_s, 1e-12), 0.0)
        tangents_corner = position + velocity * (ramp_s / 2)
        q = position + (velocity + reached) * (ramp_s / 2)
        after = q + reached * (step_s - ramp_s)
        yield np.array([q, position, tangents_corner, q, after, envelope.stop(after, reached)])
    yield np.array([after, envelope.stop(after, command)])
