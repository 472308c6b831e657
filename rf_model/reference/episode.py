"""Whole episodes flown by the reference, for comparison with what was learned."""

import torch
from torch import Tensor

from rf_model.channels import draw_channels
from rf_model.mobility import initial_users, move_users
from rf_model.reference.position import greedy_move
from rf_model.reference.solve import closed_form, solve
from rf_model.reward import reward
from rf_model.scenario import Scenario
from rf_model.world import slot_power


def episode_rewards(
    scenario: Scenario, episodes: int, seed: int, iterations: int | None, elements: Tensor | None = None
) -> Tensor:
    """Sum of rewards over an episode [episodes], with greedy moves and the harmonic reference in every slot.

    `iterations` None: the closed form. `elements` as for `solve`. The same seed and number of episodes give the same
    worlds whatever the surface does in them, since it acts on nothing but the rates.
    """
    generator = torch.Generator().manual_seed(seed)
    position = torch.tensor(scenario.start_enu, dtype=torch.float64).expand(episodes, 3)
    yaw = torch.full((episodes,), scenario.panel_heading_rad, dtype=torch.float64)
    users = initial_users(scenario, (episodes,), generator, torch.float64)
    total = torch.zeros(episodes, dtype=torch.float64)
    for slot in range(scenario.slots):
        channels = draw_channels(scenario, position, yaw, users.position_enu, generator)
        if iterations is None:
            fair_rate_bps = closed_form(scenario, channels, elements).utility_bps[:, -1]
        else:
            fair_rate_bps = solve(scenario, channels, iterations, elements=elements).utility_bps[:, -1]
        move = greedy_move(scenario, position, yaw, users.position_enu, slot)
        total += reward(scenario, fair_rate_bps, slot_power(scenario, move / scenario.slot_s, yaw))
        position = position + move
        users = move_users(scenario, users, generator)
    return total
