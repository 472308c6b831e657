"""A slot's action as a profile that stays in the scenario's box and can still stop inside it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airframe.slot_profile import SlotProfile, Vector, brake, reach
from autopilot_bridge.config import Limits
from autopilot_bridge.envelope import stopping_point
from autopilot_bridge.fence import Box

SAMPLES = 21
"""Instants of a slot at which the profile is checked against the box, and of a stop."""
STOPS = 3
"""Instants from the slot's end to the next action's deadline at which a hold may begin, as far as it is checked."""
BISECTIONS = 14


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
    agility = limits.agility
    jerky = limits.jerk_mps3 is not None
    times = np.linspace(0.0, slot_s + reaction_s, SAMPLES)
    begins = np.linspace(slot_s, slot_s + reaction_s, STOPS)
    hold = brake(position, velocity, agility, acceleration)
    for point in _way(hold) if jerky else stopping_point(position, velocity, limits, reaction_s)[None]:
        x, y, z = point.tolist()
        box = box.hull((x, y, z))

    def profile_of(candidate: Vector) -> SlotProfile:
        return reach(position, velocity, candidate, slot_s, agility, limits.speeds, acceleration)

    def in_the_way(candidate: Vector) -> NDArray[np.bool_]:
        profile = profile_of(candidate)
        track = profile.at(times)
        if not jerky:  # stops are straight: their ends tell
            return outside(box, stopping_point(track.position, track.velocity, limits))
        stops = [brake(*instant[:2], agility, instant[2]) for instant in zip(*profile.at(begins), strict=True)]
        return outside(box, np.concatenate([track.position, *map(_way, stops)]))

    held = hold.displacement(slot_s)
    allowed = nearest_inside(displacement, held, in_the_way)
    if allowed is held:
        return Planned(hold, ("box",))
    profile = profile_of(allowed)
    return Planned(profile, (*profile.limited_by, *(("box",) if allowed is not displacement else ())))


def outside(box: Box, points: Vector) -> NDArray[np.bool_]:
    """Per axis, whether any of the `points` (..., 3) is outside; shape (3,)."""
    low, high = np.array(box.spans).T
    flat = points.reshape(-1, 3)
    return np.asarray(((flat < low - 1e-6) | (flat > high + 1e-6)).any(axis=0))


def nearest_inside(wanted: Vector, fallback: Vector, in_the_way: Callable[[Vector], NDArray[np.bool_]]) -> Vector:
    """`wanted` itself when nothing is in the way; else blended with `fallback`, as little as needed.

    Only along the axes in the way if that helps, else along all. `in_the_way(candidate)` tells per axis. When even
    `fallback` is blocked it is returned all the same: there is nothing better.
    """
    blocked = in_the_way(wanted)
    if not blocked.any():
        return wanted
    for target in (np.where(blocked, fallback, wanted), fallback):
        if in_the_way(target).any():
            continue
        good, bad = 0.0, 1.0
        for _ in range(BISECTIONS):
            share = (good + bad) / 2
            if in_the_way(target + share * (wanted - target)).any():
                bad = share
            else:
                good = share
        return target + good * (wanted - target)
    return fallback


def _way(hold: SlotProfile) -> Vector:
    """Points of a hold until it is at rest, shape (SAMPLES, 3)."""
    return hold.at(np.linspace(0.0, hold.duration_s, SAMPLES)).position
