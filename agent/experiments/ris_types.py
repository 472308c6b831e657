"""The four surfaces in the same worlds under the model-based reference (paper fig. "RIS type vs efficiency")."""

from dataclasses import dataclass
from typing import get_args

from torch import Tensor

from rf_model.reference.elements import SurfaceKind
from rf_model.reference.episode import Flight, Position, fly
from rf_model.reference.solve import Objective, closed_form, solve
from rf_model.reward import reward
from rf_model.scenario import preset
from rf_model.seeding import generator_of
from rf_model.world import slot_rates

POSITIONS: tuple[Position, ...] = get_args(Position)
SURFACES: tuple[SurfaceKind, ...] = get_args(SurfaceKind)
SCENARIO = "prototype_s4"
ITERATIONS = (None, 0, 1, 3, 10, 40)
"""None: the closed form."""


@dataclass(frozen=True)
class Outcome:
    """What one surface brings over each of E episodes."""

    surface: SurfaceKind
    position: Position
    objective: Objective
    iterations: int | None
    sum_rate_bps: Tensor
    """[E] mean over the slots."""
    fair_rate_bps: Tensor
    """[E] mean over the slots."""
    reward: Tensor
    """[E] sum over the slots."""
    efficiency_bit_per_j: Tensor
    """[E] sum of the rates over sum of the power."""


def outcomes(episodes: int, seed: int) -> list[Outcome]:
    """Every surface, hovering at the start and moved greedily, after each of `ITERATIONS` on the fair rate.

    And, hovering, after the last of them on the sum of rates.
    """
    found = []
    for position in POSITIONS:
        flown = flight(position, episodes, seed)
        found += [
            outcome(flown, surface, position, "harmonic", iterations)
            for surface in SURFACES
            for iterations in ITERATIONS
        ]
        if position == "hovering":
            found += [outcome(flown, surface, position, "sum_rate", ITERATIONS[-1]) for surface in SURFACES]
    return found


def flight(position: Position, episodes: int, seed: int) -> Flight:
    """Fly episodes of `SCENARIO`: the same for all surfaces, since the greedy mover knows large-scale gains only."""
    return fly(preset(SCENARIO), position, episodes, generator_of(seed, 0))


def outcome(
    flown: Flight, surface: SurfaceKind, position: Position, objective: Objective, iterations: int | None
) -> Outcome:
    """Optimise every slot of a flight for a surface; `iterations` None: the closed form."""
    scenario = preset(SCENARIO, surface=surface)
    known = flown.known
    solution = closed_form(scenario, known) if iterations is None else solve(scenario, known, iterations, objective)
    rates = slot_rates(scenario, flown.rated, solution.trc, solution.beamforming)
    return Outcome(
        surface=surface,
        position=position,
        objective=objective,
        iterations=iterations,
        sum_rate_bps=rates.sum_rate_bps.mean(0),
        fair_rate_bps=rates.fair_rate_bps.mean(0),
        reward=reward(scenario, rates.fair_rate_bps, flown.power_w).sum(0),
        efficiency_bit_per_j=rates.sum_rate_bps.sum(0) / flown.power_w.sum(0),
    )
