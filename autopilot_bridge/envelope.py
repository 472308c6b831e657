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

A vehicle that is outside already may do what takes it, and its stop, no further out. One that cannot stop inside any
more (wind, or an autopilot slower than its limits) is called back, since real velocity loops are slow to forget what
they held against.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from airframe.pulse import NOTHING, Triple
from airframe.slot_profile import Vector, triple
from autopilot_bridge.config import Limits
from autopilot_bridge.energy import Endurance
from autopilot_bridge.fence import TOUCH_M, Bound, Cylinder, Fence, Path, Point, unit
from autopilot_bridge.separation import Track, own_side

RESPONSE_S = 1.5
"""A command may be ahead of the measured velocity by this long at the acceleration limit."""
BISECTIONS = 12
HOME = (0.0, 0.0)
CALL_BACK = 1.0
"""[1/s] Speed inward for each metre that a stop would end outside."""
ROUNDING_M = 1e-9
WALLS = 3
"""A command slides along so many walls at most before all of it is shortened."""


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
        numbers = (*triple(wanted), *triple(position), *triple(velocity))
        if not all(map(math.isfinite, numbers)) or not all(map(_known, others)):
            return Sent(np.zeros(3), ("not finite",))
        asked, here, pace = numbers[:3], numbers[3:6], numbers[6:]
        reasons: list[str] = []

        slower = self.limit_speed(asked)
        if slower != asked:
            reasons.append("speed")

        gentler = self.within_response(slower, pace)
        if gentler is not slower:
            reasons.append("acceleration")

        step = _Step(self, here, pace, gentler, others, energy_j)
        safe, blocked = step.nearest_safe(gentler)
        if not all(map(math.isfinite, safe)):  # of numbers that are no vehicle's
            return Sent(np.zeros(3), ("not finite",))
        return Sent(np.array(safe), () if safe == asked else (*reasons, *blocked))

    def stop(self, position: Vector, velocity: Vector) -> Vector:
        """Where a vehicle comes to rest that brakes straight after the reaction."""
        return stopping_point(position, velocity, self.limits, self.reaction_s)

    @cached_property
    def home_bound(self) -> Cylinder | None:
        """How far from home the vehicle may be."""
        if self.home_distance_m is None:
            return None
        return Cylinder(centre=HOME, radius=self.home_distance_m, altitude=self.fence.altitude)

    @cached_property
    def most_mps2(self) -> tuple[float, float]:
        """The acceleration limits, level and vertical."""
        return self.limits.acceleration_mps2, self.limits.vertical_mps2

    def change_s(self, change: Triple) -> float:
        """How long a straight change of velocity takes."""
        level, vertical = self.most_mps2
        return math.hypot(math.hypot(change[0], change[1]) / level, change[2] / vertical)

    def stop_of(self, position: Triple, velocity: Triple) -> Triple:
        """`stop` in plain numbers."""
        needed_s = self.reaction_s + self.change_s(velocity) / 2
        return (
            position[0] + velocity[0] * needed_s,
            position[1] + velocity[1] * needed_s,
            position[2] + velocity[2] * needed_s,
        )

    def within_response(self, command: Triple, velocity: Triple) -> Triple:
        """`command`, no further ahead of the `velocity` now than `RESPONSE_S` at the acceleration limit."""
        needed_s = self.change_s(_less(command, velocity))
        if needed_s <= RESPONSE_S:
            return command
        return self.limit_speed(_towards(velocity, command, RESPONSE_S / needed_s))

    def limit_speed(self, velocity: Triple) -> Triple:
        """`velocity`, shortened sideways and clipped vertically to the limits."""
        east, north, up = velocity
        limits = self.limits
        horizontal = math.hypot(east, north)
        vertical = min(max(up, -limits.down_mps), limits.up_mps)
        if horizontal <= limits.horizontal_mps:
            return east, north, vertical
        shorter = limits.horizontal_mps / horizontal
        return east * shorter, north * shorter, vertical


class _Step:
    """One step ahead of a vehicle, whose commands are no longer than `wanted`."""

    def __init__(
        self,
        envelope: Envelope,
        position: Triple,
        velocity: Triple,
        wanted: Triple,
        others: Sequence[Track],
        energy_j: float | None,
    ) -> None:
        self._envelope, self._position, self._velocity, self._energy_j = envelope, position, velocity, energy_j
        self._stop = envelope.stop_of(position, velocity)
        pace = max(math.hypot(velocity[0], velocity[1]), math.hypot(wanted[0], wanted[1]))
        climb = max(abs(velocity[2]), abs(wanted[2]))
        furthest_s = envelope.step_s + envelope.reaction_s + envelope.change_s((pace, 0.0, climb)) / 2
        self._reach_m, (low, high) = pace * furthest_s, envelope.fence.altitude
        """So far away is everything that is looked at."""
        self._level = low + climb * furthest_s <= position[2] <= high - climb * furthest_s
        """Whether neither the top nor the floor is in reach."""
        self._bounds = [(name, bound) for name, bound in self._all_bounds(others) if bound is not None]

    def nearest_safe(self, wanted: Triple) -> tuple[Triple, tuple[str, ...]]:
        """`wanted` itself when it is safe; else what is nearest to it of what is tried, and what was in the way."""
        target, blocked = wanted, self._in_the_way(wanted)
        if not blocked:
            return wanted, ()
        told = dict.fromkeys(blocked)
        for _ in range(WALLS):
            if blocked:
                target = _without(target, blocked)
                blocked = self._in_the_way(target)
                told |= dict.fromkeys(blocked)
        if blocked:
            target = NOTHING
            if self._in_the_way(target):
                return self._envelope.within_response(self._call_back(), self._velocity), tuple(told)
        good, bad = 0.0, 1.0
        for _ in range(BISECTIONS):
            share = (good + bad) / 2
            if any(self._obstacles(_towards(target, wanted, share))):
                bad = share
            else:
                good = share
        return _towards(target, wanted, good), tuple(told)

    def _all_bounds(self, others: Sequence[Track]) -> Iterator[tuple[str, Bound | None]]:
        """What the vehicle must stay inside of in plan, as far as it is in reach, and what it is called."""
        envelope, reach_m = self._envelope, self._reach_m
        place, stop = self._position[:2], self._stop[:2]
        yield "fence", envelope.fence.near(place, reach_m)
        if envelope.home_bound is not None:
            yield "home distance", envelope.home_bound.near(place, reach_m)
        if envelope.separation_m > 0.0:
            for other in others:
                there = triple(other.position)
                end = triple(other.stop) if other.stop is not None else envelope.stop_of(there, triple(other.velocity))
                apart_m = envelope.separation_m + 2 * other.age_s * envelope.limits.horizontal_mps
                theirs = there[:2], end[:2]
                if (
                    math.dist(place, theirs[0]) < apart_m + math.dist(*theirs) + 3 * reach_m
                ):  # else no plane is in reach
                    yield "separation", own_side((place, stop), theirs, apart_m).near(place, reach_m)

    def _call_back(self) -> Triple:
        """Braking, and more: inward as fast as the stop is far outside."""
        place, (east, north, up) = self._position[:2], self._stop
        inward_east = inward_north = 0.0
        for _, bound in self._bounds:
            path = (place, (east, north))
            back, outward = CALL_BACK * bound.beyond_m(path[-1:]), bound.wall(path)
            inward_east, inward_north = inward_east - back * outward[0], inward_north - back * outward[1]
        low, high = self._envelope.fence.altitude
        return self._envelope.limit_speed((inward_east, inward_north, CALL_BACK * (min(max(up, low), high) - up)))

    def _in_the_way(self, command: Triple) -> dict[str, Point]:
        """What does not let `command` through: its name, and the wall's normal (zero: not in plan)."""
        blocked: dict[str, Point] = {}
        for name, outward in self._obstacles(command):
            if name not in blocked:
                blocked[name] = outward()
        return blocked

    def _obstacles(self, command: Triple) -> Iterator[tuple[str, Callable[[], Point]]]:
        """What does not let `command` through, as often as it does not, and how to find its normal."""
        envelope, bounds = self._envelope, self._bounds
        looks_at_energy = envelope.endurance is not None and self._energy_j is not None
        if not bounds and self._level and not looks_at_energy:
            return
        low, high = envelope.fence.altitude
        here = max(low - self._position[2], self._position[2] - high)
        for way in self._ways(command):
            path, (east, north, _) = [(x, y) for x, y, _ in way], way[-1]
            for name, bound in bounds:
                if not self._kept(bound, path):
                    yield name, partial(bound.wall, path[-3:])
            if not self._level:
                heights = [z for _, _, z in way]
                if max(low - min(heights), max(heights) - high) > max(here + ROUNDING_M, TOUCH_M):
                    yield "altitude", lambda: (0.0, 0.0)
            if looks_at_energy and self._spends_too_much(way[-1]):
                yield "energy", partial(unit, east, north)

    def _kept(self, bound: Bound, path: Path) -> bool:
        if bound.holds(path):
            return True
        here = bound.beyond_m([self._position[:2]])
        return here > TOUCH_M and bound.holds(path, here + ROUNDING_M)  # on its way back, and never further out

    def _spends_too_much(self, stop: Triple) -> bool:
        """Whether the way home from `stop` costs more than is left, and more than from here."""
        endurance = self._envelope.endurance
        if endurance is None or self._energy_j is None:
            return False
        needed = endurance.needed_j(stop)
        return needed > self._energy_j and needed > endurance.needed_j(self._stop)

    def _ways(self, command: Triple) -> Iterator[list[Triple]]:
        """Corners of what must lie inside, each ending with a stop: one step's way, for both kinds of vehicles.

        In it q is where the velocity has reached `command`, or the step's end p' if that comes first. And the stop of a
        vehicle that has reached `command` by p': real ones may be nearer to that than the acceleration limit says, and
        commands become smaller towards a wall before they must.
        """
        envelope, p, v = self._envelope, self._position, self._velocity
        step_s, (level, vertical) = envelope.step_s, envelope.most_mps2
        change = _less(command, v)
        level_s, vertical_s = math.hypot(change[0], change[1]) / level, abs(change[2]) / vertical
        straight_s = math.hypot(level_s, vertical_s)
        for needed_s in ((straight_s, straight_s), (level_s, vertical_s)):
            level_ramp, climb_ramp = min(needed_s[0], step_s), min(needed_s[1], step_s)
            done = level_ramp / needed_s[0] if needed_s[0] > 0.0 else 0.0
            climbed = climb_ramp / needed_s[1] if needed_s[1] > 0.0 else 0.0
            reached = v[0] + done * change[0], v[1] + done * change[1], v[2] + climbed * change[2]
            tangents_corner = p[0] + v[0] * level_ramp / 2, p[1] + v[1] * level_ramp / 2, p[2] + v[2] * climb_ramp / 2
            q = (
                p[0] + (v[0] + reached[0]) * level_ramp / 2,
                p[1] + (v[1] + reached[1]) * level_ramp / 2,
                p[2] + (v[2] + reached[2]) * climb_ramp / 2,
            )
            level_rest, climb_rest = step_s - level_ramp, step_s - climb_ramp
            after = q[0] + reached[0] * level_rest, q[1] + reached[1] * level_rest, q[2] + reached[2] * climb_rest
            yield [q, p, tangents_corner, q, after, envelope.stop_of(after, reached)]
        yield [after, envelope.stop_of(after, command)]


def stopping_point(position: Vector, velocity: Vector, limits: Limits, reaction_s: float = 0.0) -> Vector:
    """Where a vehicle comes to rest that brakes straight after `reaction_s`."""
    needed_s = reaction_s + float(limits.time_to_change(velocity)) / 2
    point: Vector = position + velocity * needed_s
    return point


def _known(track: Track) -> bool:
    numbers = (*triple(track.position), *triple(track.velocity), *(() if track.stop is None else triple(track.stop)))
    return all(map(math.isfinite, (*numbers, track.age_s)))


def _without(command: Triple, blocked: dict[str, Point]) -> Triple:
    """`command` less its part against each wall in its way."""
    east, north, up = command
    for name, (out_east, out_north) in blocked.items():
        against = max(0.0, east * out_east + north * out_north)
        east, north = east - against * out_east, north - against * out_north
        if name == "altitude" or (name == "energy" and up > 0):
            up = 0.0
    return east, north, up


def _less(a: Triple, b: Triple) -> Triple:
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _towards(a: Triple, b: Triple, share: float) -> Triple:
    """That share of the way from a to b."""
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])
