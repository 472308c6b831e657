"""A slot's action as a profile that stays in the scenario's box and can still stop inside it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from airframe.slot_profile import SlotProfile, SpeedLimits, Vector, brake, reach
from autopilot_bridge.config import Box, Limits
from autopilot_bridge.envelope import nearest_inside, outside, stopping_point

SAMPLES = 21
"""Instants of a slot at which the profile is checked against the box."""


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
) -> Planned:
    """Plan `displacement` [m] from the reference (`position`, `velocity`) over `slot_s`.

    At every instant up to the next action's deadline (`reaction_s` past the slot's end) the planned hold must come to
    rest inside `box`. A displacement that does not allow that is drawn towards the one of the hold: along the axes in
    the way, so that the vehicle slides along the wall, or as a whole. A vehicle that cannot stop inside any more (blown
    or taken out) may go no further out.
    """
    speeds = SpeedLimits(limits.horizontal_mps, limits.up_mps, limits.down_mps)
    times = np.linspace(0.0, slot_s + reaction_s, SAMPLES)

    def profile_of(candidate: Vector) -> SlotProfile:
        return reach(position, velocity, candidate, slot_s, limits.acceleration_mps2, speeds)

    def in_the_way(candidate: Vector) -> NDArray[np.bool_]:
        track = profile_of(candidate).at(times)
        return outside(box, stopping_point(track.position, track.velocity, limits.acceleration_mps2))

    hold = brake(position, velocity, limits.acceleration_mps2)
    x, y, z = stopping_point(position, velocity, limits.acceleration_mps2, reaction_s).tolist()
    box = box.hull((x, y, z))
    allowed = nearest_inside(displacement, hold.displacement(slot_s), in_the_way)
    profile = profile_of(allowed)
    return Planned(profile, (*profile.limited_by, *(("box",) if allowed is not displacement else ())))
