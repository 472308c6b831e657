"""The slot profile: how far of a commanded displacement the vehicle can really fly in one slot.

The paper moves the UAV by up to V_max * slot at each slot as if by teleport. A multicopter changes its velocity at a
limited rate, and that rate at a limited rate again. So a slot starts with the velocity v0 and the acceleration a0 that
the last one ended with, and the profile turns the commanded displacement d over the slot T into one pulse:

    a(t): from a0 to a1 in a straight line at the jerk limit, a1 held, from a1 to zero at the jerk limit; then coasting

with a1 as large as the acceleration limit lets it and the pulse as short as it can be, such that it ends in p0 + d at
T when that is within reach. The way back to zero begins at T at the latest, so that no profile gathers more speed than
its own slot has use for. Without a jerk limit this is a constant acceleration a along d - v0 T for s / a seconds, with

    s T - s^2 / (2 a) = |d - v0 T|,      s <= a T.

Position, velocity and (with a jerk limit) acceleration are continuous from slot to slot by construction, since each
slot starts where the last one's profile ended. The limits of acceleration and jerk are spheres, or ellipsoids whose
vertical half-axis is `vertical_share` of the horizontal one; all sums are done with the vertical axis stretched.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from airframe.pulse import NOTHING, Pulse, Start, Triple
from airframe.search import largest_share

Vector = NDArray[np.float64]
"""Shape (3,) or (..., 3): east, north, up."""

AXES = (0, 1, 2)
PIECES = 8
CALM = 0.01
"""So exact is the share to which a turn is taken back that would be too fast on its way."""


class SpeedLimits(NamedTuple):
    """Largest horizontal speed, climb rate and descent rate, all positive [m/s]."""

    horizontal: float
    up: float
    down: float


class Agility(NamedTuple):
    """How fast a velocity may change."""

    acceleration: float
    """Horizontal [m/s2]."""
    jerk: float = math.inf
    """Horizontal [m/s3]."""
    vertical_share: float = 1.0
    """Both limits' vertical half-axis as a share of the horizontal one."""


class Reference(NamedTuple):
    """What the vehicle should be doing at some instant: shape (..., 3) each; m, m/s, m/s2."""

    position: Vector
    velocity: Vector
    acceleration: Vector


class Piece(NamedTuple):
    """Of a profile, with one jerk: where and how it begins."""

    begins_s: float
    position: Triple
    velocity: Triple
    acceleration: Triple
    jerk: Triple

    def after(self, t: float) -> tuple[Triple, Triple, Triple]:
        """Position, velocity and acceleration `t` after its beginning."""
        (px, py, pz), (vx, vy, vz), (ax, ay, az), (jx, jy, jz) = self[1:]
        half, sixth = t / 2, t / 3
        return (
            (
                px + t * (vx + half * (ax + sixth * jx)),
                py + t * (vy + half * (ay + sixth * jy)),
                pz + t * (vz + half * (az + sixth * jz)),
            ),
            (vx + t * (ax + half * jx), vy + t * (ay + half * jy), vz + t * (az + half * jz)),
            (ax + t * jx, ay + t * jy, az + t * jz),
        )

    def turns(self, axis: int, within_s: float) -> list[float]:
        """Where it turns back along an axis."""
        p, v, a, j = self.position[axis], self.velocity[axis], self.acceleration[axis], self.jerk[axis]
        squared = a * a - 2 * j * v
        if squared < 0.0:
            return []
        q = -(a + math.copysign(squared**0.5, a))  # v + a t + j t^2 / 2 is zero at q / j and at 2 v / q
        times = [above / below for above, below in ((q, j), (2 * v, q)) if below != 0.0]
        return [p + t * (v + t / 2 * (a + t / 3 * j)) for t in times if 0.0 < t < within_s]


@dataclass(frozen=True)
class SlotProfile:
    """One pulse of acceleration, constant velocity after it."""

    position: Triple
    velocity: Triple
    acceleration: Triple
    """At the start."""
    peak: Triple
    """The acceleration that is held."""
    ramp_up_s: float
    hold_s: float
    ramp_down_s: float
    limited_by: tuple[str, ...] = ()
    """What kept the profile from the commanded displacement: `speed`, `climb`, `acceleration` (or the jerk)."""

    @property
    def duration_s(self) -> float:
        """Until the velocity no longer changes."""
        return self.ramp_up_s + self.hold_s + self.ramp_down_s

    def at(self, time_s: float | Vector) -> Reference:
        """The reference at times [s] since the profile's start; `time_s` of shape (...) gives vectors (..., 3)."""
        if isinstance(time_s, float):
            position, velocity, acceleration = self.state(time_s)
            return Reference(np.array(position), np.array(velocity), np.array(acceleration))
        times = np.asarray(time_s, dtype=float)
        states = np.array([self.state(t) for t in times.ravel().tolist()])
        position, velocity, acceleration = np.moveaxis(states.reshape(*times.shape, 3, 3), -2, 0)
        return Reference(position, velocity, acceleration)

    def state(self, time_s: float) -> tuple[Triple, Triple, Triple]:
        """Position, velocity and acceleration at one time, in plain numbers."""
        t = max(time_s, 0.0)
        for piece in reversed(self.pieces):
            if t >= piece.begins_s:
                break
        return piece.after(t - piece.begins_s)

    def displacement(self, slot_s: float) -> Vector:
        """Planned displacement [m] after `slot_s`."""
        return np.subtract(self.state(slot_s)[0], self.position)

    def extent(self, until_s: float) -> tuple[Triple, Triple]:
        """The least and the greatest coordinates of the way until `until_s`."""
        lows, highs = [*self.position], [*self.position]
        ends = [*[piece.begins_s for piece in self.pieces[1:]], math.inf]
        for piece, end_s in zip(self.pieces, ends, strict=True):
            left_s = (end_s if end_s < until_s else until_s) - piece.begins_s
            if left_s <= 0.0:
                continue
            _, _, velocity, acceleration, jerk = piece
            places, paces, _ = piece.after(left_s)
            for axis in AXES:
                reached = [places[axis]]
                a, j = acceleration[axis], jerk[axis]
                if velocity[axis] * paces[axis] <= 0.0 or a * (a + left_s * j) < 0.0:
                    reached += piece.turns(axis, left_s)
                for place in reached:
                    if place < lows[axis]:
                        lows[axis] = place
                    elif place > highs[axis]:
                        highs[axis] = place
        return (lows[0], lows[1], lows[2]), (highs[0], highs[1], highs[2])

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """Both ramps, what is held between them, and the coasting; none of no duration."""
        pieces = []
        begins_s, position, velocity = 0.0, self.position, self.velocity
        for duration_s, before, after in (
            (self.ramp_up_s, self.acceleration, self.peak),
            (self.hold_s, self.peak, self.peak),
            (self.ramp_down_s, self.peak, NOTHING),
        ):
            if duration_s > 0.0:
                (ax, ay, az), (bx, by, bz) = before, after
                jerk = ((bx - ax) / duration_s, (by - ay) / duration_s, (bz - az) / duration_s)
                pieces.append(Piece(begins_s, position, velocity, before, jerk))
                position, velocity, _ = pieces[-1].after(duration_s)
                begins_s += duration_s
        return (*pieces, Piece(begins_s, position, velocity, NOTHING, NOTHING))


def reach(
    position: Vector,
    velocity: Vector,
    displacement: Vector,
    slot_s: float,
    acceleration: float | Agility,
    limits: SpeedLimits,
    initial_acceleration: Vector | None = None,
) -> SlotProfile:
    """The profile from (`position`, `velocity`) towards `displacement` [m] over `slot_s`, as far as the limits let it.

    `acceleration` is a limit [m/s2] of any direction, or an `Agility`. `velocity`, and where the jerk limit lets it
    settle from `initial_acceleration`, should lie within the speed limits: then so does every velocity of the profile.
    """
    axes = _Axes(position, velocity, acceleration, initial_acceleration)
    commanded = triple(displacement)
    wanted = _within_speed(commanded, slot_s, limits)
    limited_by = []
    if wanted[:2] != commanded[:2]:
        limited_by.append("speed")
    if wanted[2] != commanded[2]:
        limited_by.append("climb")

    start = axes.start
    pulse, reached = start.to_place(axes.stretched(wanted), slot_s)
    if not reached:
        limited_by.append("acceleration")
    settled, end = axes.real(start.settled_velocity), axes.real(start.end_velocity(pulse))
    size = math.dist(end, settled)
    if size > 1e-9:
        direction = (end[0] - settled[0]) / size, (end[1] - settled[1]) / size, (end[2] - settled[2]) / size
        room = _speed_room(settled, direction, limits)
        if room < size - 1e-9:
            limited_by.append("speed")
            end = _between(settled, end, room / size)
            pulse = start.to_velocity(axes.stretched(end))
        if not start.straight(pulse) and (excess := _too_fast(axes.profile(pulse), limits)) > 0.0:  # on its way

            def too_fast(share: float) -> float:
                return _too_fast(axes.profile(start.to_velocity(axes.stretched(_between(settled, end, share)))), limits)

            limited_by.append("speed")
            share = largest_share(too_fast, excess, CALM)
            pulse = start.to_velocity(axes.stretched(_between(settled, end, share)))
    return axes.profile(pulse, tuple(dict.fromkeys(limited_by)))


def brake(
    position: Vector | Triple,
    velocity: Vector | Triple,
    acceleration: float | Agility,
    initial_acceleration: Vector | Triple | None = None,
) -> SlotProfile:
    """The planned hold: to rest as fast as `acceleration` [m/s2], or an `Agility`, lets it, and there for ever.

    Without a jerk limit that is a straight line.
    """
    axes = _Axes(position, velocity, acceleration, initial_acceleration)
    return axes.profile(axes.start.to_velocity(NOTHING))


class _Axes:
    """A start, and the vertical axis stretched so that the limits are spheres."""

    def __init__(
        self,
        position: Vector | Triple,
        velocity: Vector | Triple,
        acceleration: float | Agility,
        initial_acceleration: Vector | Triple | None,
    ) -> None:
        agility = acceleration if isinstance(acceleration, Agility) else Agility(acceleration)
        settles = initial_acceleration is not None and agility.jerk < math.inf  # without a jerk limit it may jump
        self._share = agility.vertical_share
        self._position, self._velocity = triple(position), triple(velocity)
        self._acceleration = triple(initial_acceleration) if settles and initial_acceleration is not None else NOTHING
        self.start = Start(
            self.stretched(self._velocity), self.stretched(self._acceleration), agility.acceleration, agility.jerk
        )

    def stretched(self, vector: Triple) -> Triple:
        return vector[0], vector[1], vector[2] / self._share

    def real(self, vector: Triple) -> Triple:
        return vector[0], vector[1], vector[2] * self._share

    def profile(self, pulse: Pulse, limited_by: tuple[str, ...] = ()) -> SlotProfile:
        return SlotProfile(
            self._position,
            self._velocity,
            self._acceleration,
            self.real(pulse.peak),
            pulse.ramp_up_s,
            pulse.hold_s,
            pulse.ramp_down_s,
            limited_by,
        )


def triple(vector: Vector | Triple) -> Triple:
    """In plain numbers."""
    x, y, z = vector if isinstance(vector, tuple) else vector.tolist()
    return x, y, z


def _between(a: Triple, b: Triple, share: float) -> Triple:
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])


def _too_fast(track: SlotProfile, limits: SpeedLimits) -> float:
    """By how much a velocity of the pulse may be beyond the limits [m/s]; not above 0 when none is.

    Only on the first ramp do velocities not run straight, but along a parabola, here in `PIECES`: each lies within the
    triangle of its ends and the point where their tangents meet.
    """
    ramp, step_s = track.pieces[0], track.ramp_up_s / PIECES
    velocities = [track.pieces[-1].velocity]
    for number in range(PIECES):
        _, (x, y, z), (ax, ay, az) = ramp.after(number * step_s)
        velocities += [(x, y, z), (x + ax * step_s / 2, y + ay * step_s / 2, z + az * step_s / 2)]
    velocities.append(ramp.after(track.ramp_up_s)[1])
    horizontal = math.sqrt(max([x * x + y * y for x, y, _ in velocities])) - limits.horizontal
    climbs = [z for _, _, z in velocities]
    return max(horizontal, max(climbs) - limits.up, -min(climbs) - limits.down) - 1e-9


def _within_speed(displacement: Triple, slot_s: float, limits: SpeedLimits) -> Triple:
    """Horizontal part shortened to what its limit allows in a slot, vertical part clipped to its own."""
    east, north, up = displacement
    horizontal, furthest = math.hypot(east, north), limits.horizontal * slot_s
    shorter = furthest / horizontal if horizontal > furthest else 1.0
    return east * shorter, north * shorter, min(max(up, -limits.down * slot_s), limits.up * slot_s)


def _speed_room(velocity: Triple, direction: Triple, limits: SpeedLimits) -> float:
    """The largest s for which velocity + s * direction is within the limits; infinite when velocity itself is not."""
    vx, vy, vz = velocity
    ux, uy, uz = direction
    spare = limits.horizontal**2 - vx * vx - vy * vy
    if spare < -1e-9 or not -limits.down - 1e-9 <= vz <= limits.up + 1e-9:
        return math.inf
    room = math.inf
    if uz > 1e-12:
        room = max(0.0, (limits.up - vz) / uz)
    elif uz < -1e-12:
        room = max(0.0, (-limits.down - vz) / uz)
    along, across = vx * ux + vy * uy, ux * ux + uy * uy
    if across > 1e-12:
        room = min(room, (-along + (along * along + across * max(spare, 0.0)) ** 0.5) / across)
    return room
