"""A slot's action as a profile that stays in the scenario's box and can still stop inside it."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain

import numpy as np

from airframe.pulse import Triple
from airframe.search import largest_share
from airframe.slot_profile import Agility, SlotProfile, Vector, brake, reach
from autopilot_bridge.config import Limits
from autopilot_bridge.fence import TOUCH_M, Box

INSTANTS = 12
"""Of a pulse, at which a straight stop is checked against the box; after it the stops' ends lie on a line."""
HOLDS = 3
"""Instants from the slot's end to the next action's deadline at which a hold may begin, as far as it is checked."""
NEAR_M = 0.05
"""A blend this near to the box is near enough."""

Out = tuple[float, float, float]
"""How far outside the box something gets along each axis [m]; 0 inside."""


@dataclass(frozen=True)
class Planned:
    """The profile to fly, and what kept it from the commanded displacement."""

    profile: SlotProfile
    reasons: tuple[str, ...]


def plan_slot(
    position: Vector,
    velocity: Vector,
    displacement: Vector,
    slot_s: float,
    limits: Limits,
    box: Box,
    reaction_s: float,
    acceleration: Vector | None = None,
) -> Planned:
    """Plan `displacement` [m] from the reference (`position`, `velocity`, `acceleration`) over `slot_s`.

    The profile must lie inside `box` up to the next action's deadline (`reaction_s` past the slot's end), and so must a
    hold that begins between the two. A displacement that does not allow that is drawn towards the one of the hold:
    along the axes in the way, so that the vehicle slides along the wall, or as a whole. The hold itself is always
    allowed, since the last slot's plan has kept room for it. A vehicle that cannot stop inside any more (blown or taken
    out) may go no further out.
    """
    agility, speeds = limits.agility, limits.speeds
    until_s = slot_s + reaction_s
    hold = brake(position, velocity, agility, acceleration)
    jerky = limits.jerk_mps3 is not None
    corners = hold.extent(hold.duration_s) if jerky else [_stop(hold.position, hold.velocity, limits, reaction_s)]
    for corner in corners:
        box = box.hull(corner)
    low, high = zip(*box.spans, strict=True)

    def profile_of(candidate: Vector) -> SlotProfile:
        return reach(position, velocity, candidate, slot_s, agility, speeds, acceleration)

    def gets_out(candidate: Vector, wholly: bool) -> Out:
        profile = profile_of(candidate)
        stops = _holds(profile, slot_s, until_s, agility) if jerky else _stops(profile, until_s, limits)
        out = [0.0, 0.0, 0.0]
        for corner in chain(stops, profile.extent(until_s)):
            for axis, place in enumerate(corner):
                out[axis] = max(out[axis], low[axis] - place, place - high[axis])
            if not wholly and max(out) > TOUCH_M:
                break
        return out[0], out[1], out[2]

    held = hold.displacement(slot_s)
    allowed = nearest_inside(displacement, held, gets_out)
    if allowed is held:
        return Planned(hold, ("box",))
    profile = profile_of(allowed)
    return Planned(profile, (*profile.limited_by, *(("box",) if allowed is not displacement else ())))


def nearest_inside(wanted: Vector, fallback: Vector, gets_out: Callable[[Vector, bool], Out]) -> Vector:
    """`wanted` itself when nothing is in the way; else blended with `fallback`, as little as needed.

    Only along the axes in the way if that helps, else along all. `gets_out(candidate, wholly)` tells how far, per axis,
    of all there is, or of the first that does. When even `fallback` gets out it is returned all the same: there is
    nothing better.
    """
    out = gets_out(wanted, True)
    if max(out) <= TOUCH_M:
        return wanted
    for target in (np.where(np.array(out) > TOUCH_M, fallback, wanted), fallback):
        if max(gets_out(target, False)) > TOUCH_M:
            continue
        way = wanted - target
        tolerance = NEAR_M / max(float(np.abs(way).max()), NEAR_M)

        def beyond_m(share: float, to: Vector = target, way: Vector = way) -> float:
            return max(gets_out(to + share * way, False)) - TOUCH_M

        return target + largest_share(beyond_m, max(out), tolerance) * way
    return fallback


def _stops(profile: SlotProfile, until_s: float, limits: Limits) -> Iterator[Triple]:
    """Where straight stops end that begin on the profile. What is between them and it, a box holds too."""
    for number in range(INSTANTS + 1):
        position, velocity, _ = profile.state(profile.duration_s * number / INSTANTS)
        yield _stop(position, velocity, limits, 0.0)
    position, velocity, _ = profile.state(until_s)
    yield _stop(position, velocity, limits, 0.0)


def _holds(profile: SlotProfile, slot_s: float, until_s: float, agility: Agility) -> Iterator[Triple]:
    """The corners of what holds need that begin between the slot's end and `until_s`, the last one first.

    When the vehicle only coasts by then, all of them are alike: the first and the last tell.
    """
    count = 2 if profile.duration_s <= slot_s else HOLDS
    for number in reversed(range(count)):
        position, velocity, acceleration = profile.state(slot_s + (until_s - slot_s) * number / (count - 1))
        hold = brake(position, velocity, agility, acceleration)
        yield from hold.extent(hold.duration_s)


def _stop(position: Triple, velocity: Triple, limits: Limits, reaction_s: float) -> Triple:
    """Where a vehicle comes to rest that brakes straight after `reaction_s`."""
    (x, y, z), (vx, vy, vz) = position, velocity
    needed_s = reaction_s + math.hypot(math.hypot(vx, vy) / limits.acceleration_mps2, vz / limits.vertical_mps2) / 2
    return x + vx * needed_s, y + vy * needed_s, z + vz * needed_s
