"""The four surfaces in the same worlds under the model-based reference (paper fig. "RIS type vs efficiency")."""

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor

from agent.experiments.snapshots import generator
from rf_model.channels import Channels, draw_fading, faded_channels
from rf_model.geometry import panel_frame
from rf_model.mobility import initial_users, move_users
from rf_model.reference.elements import SurfaceKind
from rf_model.reference.position import greedy_move
from rf_model.reference.solve import Objective, closed_form, solve
from rf_model.reward import reward
from rf_model.scenario import preset
from rf_model.world import slot_power, slot_rates

Position = Literal["hovering", "greedy"]
POSITIONS: tuple[Position, ...] = get_args(Position)
SURFACES: tuple[SurfaceKind, ...] = get_args(SurfaceKind)
SCENARIO = "prototype_s4"
ITERATIONS = (None, 0, 1, 3, 10, 40)
"""None: the closed form."""


@dataclass(frozen=True)
class Flight:
    """E episodes of T slots, flown without regard to the surface: the same for all of them."""

    channels: Channels
    """[T, E]"""
    power_w: Tensor
    """[T, E]"""


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
    """Fly episodes of `SCENARIO`; the greedy mover knows large-scale gains only, whatever the surface's type."""
    scenario = preset(SCENARIO)
    draws = generator(seed, 0)
    yaw = torch.full((episodes,), scenario.panel_heading_rad, dtype=torch.float64)
    place = torch.tensor(scenario.start_enu, dtype=torch.float64).expand(episodes, 3)
    users = initial_users(scenario, (episodes,), draws, torch.float64)
    slots, powers = [], []
    for slot in range(scenario.slots):
        fading = draw_fading(scenario, (episodes,), draws, torch.float64)
        slots.append(faded_channels(scenario, place, panel_frame(yaw), users.position_enu, fading))
        move = torch.zeros_like(place)
        if position == "greedy":
            move = greedy_move(scenario, place, yaw, users.position_enu, slot)
        powers.append(slot_power(scenario, move / scenario.slot_s, yaw))
        place = place + move
        users = move_users(scenario, users, draws)
    return Flight(
        Channels(
            direct=torch.stack([channels.direct for channels in slots]),
            bs_ris=torch.stack([channels.bs_ris for channels in slots]),
            ris_user=torch.stack([channels.ris_user for channels in slots]),
            transmission=torch.stack([channels.transmission for channels in slots]),
        ),
        torch.stack(powers),
    )


def outcome(
    flown: Flight, surface: SurfaceKind, position: Position, objective: Objective, iterations: int | None
) -> Outcome:
    """Optimise every slot of a flight for a surface; `iterations` None: the closed form."""
    scenario = preset(SCENARIO, surface=surface)
    channels = flown.channels
    solution = (
        closed_form(scenario, channels) if iterations is None else solve(scenario, channels, iterations, objective)
    )
    rates = slot_rates(scenario, channels, solution.trc, solution.beamforming)
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
