"""Whole episodes flown by the reference, for comparison with what was learned."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal, TypeAlias

import torch
from torch import Tensor

from rf_model.channels import Channels, draw_fading, faded_channels
from rf_model.csi import Observed
from rf_model.geometry import panel_frame
from rf_model.mobility import initial_users, move_users
from rf_model.reference.position import greedy_move
from rf_model.reference.solve import closed_form, quantised, solve
from rf_model.reward import reward
from rf_model.scenario import Scenario
from rf_model.world import slot_power, slot_rates, steady_tilt

Position: TypeAlias = Literal["hovering", "greedy"]


@dataclass(frozen=True)
class Flight:
    """E episodes of T slots, flown without regard to what the surface does in them."""

    known: Channels
    """[T, E] as observed at each slot's opening."""
    rated: Channels
    """[T, E] as they are, those that the slot's rates are of (`timing`)."""
    power_w: Tensor
    """[T, E]"""


def fly(scenario: Scenario, position: Position, episodes: int, generator: torch.Generator) -> Flight:
    """Fly `episodes` side by side by teleport, hovering at the start or moved greedily by large-scale gains.

    The same state of the generator and number of episodes give the same worlds, whatever the surface.
    """
    observed = Observed(scenario)
    yaw = torch.full((episodes,), scenario.panel_heading_rad, dtype=torch.float64)

    def opened(position_enu: Tensor, velocity_enu: Tensor, users_enu: Tensor) -> tuple[Channels, Channels]:
        """Channels of a slot as they are and as they are observed."""
        tilt = steady_tilt(scenario, velocity_enu, yaw) if scenario.attitude == "flown" else ()
        fading = draw_fading(scenario, (episodes,), generator, torch.float64)
        channels = faded_channels(scenario, position_enu, panel_frame(yaw, *tilt), users_enu, fading)
        return channels, observed.of(channels, generator)

    place = torch.tensor(scenario.start_enu, dtype=torch.float64).expand(episodes, 3)
    still = torch.zeros_like(place)
    users = initial_users(scenario, (episodes,), generator, torch.float64)
    opening = [opened(place, still, users.position_enu)]
    powers = []
    for slot in range(scenario.slots):
        move = greedy_move(scenario, place, yaw, users.position_enu, slot) if position == "greedy" else still
        velocity = move / scenario.slot_s
        place = place + move
        users = move_users(scenario, users, generator)
        opening.append(opened(place, velocity, users.position_enu))
        powers.append(slot_power(scenario, velocity, yaw))
    actual, known = zip(*opening, strict=True)
    rated = actual[:-1] if scenario.timing == "pre" else actual[1:]
    return Flight(known=_stacked(known[:-1]), rated=_stacked(rated), power_w=torch.stack(powers))


def episode_rewards(scenario: Scenario, episodes: int, seed: int, iterations: int | None) -> Tensor:
    """Sum of rewards over an episode [episodes], with greedy moves and the harmonic reference in every slot.

    `iterations` None: the closed form. The reference takes the channels as they are observed for the truth. The same
    seed and number of episodes give the same worlds whatever the surface does in them.
    """
    flown = fly(scenario, "greedy", episodes, torch.Generator().manual_seed(seed))
    known = flown.known
    solution = closed_form(scenario, known) if iterations is None else solve(scenario, known, iterations)
    solution = quantised(scenario, known, solution)
    rates = slot_rates(scenario, flown.rated, solution.trc, solution.beamforming)
    return reward(scenario, rates.fair_rate_bps, flown.power_w).sum(0)


def _stacked(slots: Sequence[Channels]) -> Channels:
    links = (part.name for part in fields(Channels))
    return Channels(**{link: torch.stack([getattr(slot, link) for slot in slots]) for link in links})
