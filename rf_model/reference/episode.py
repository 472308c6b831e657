"""Whole episodes flown by the reference, for comparison with what was learned."""

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


def episode_rewards(scenario: Scenario, episodes: int, seed: int, iterations: int | None) -> Tensor:
    """Sum of rewards over an episode [episodes], with greedy moves and the harmonic reference in every slot.

    `iterations` None: the closed form. The reference takes the channels as they are observed for the truth. It moves
    as by teleport. The same seed and number of episodes give the same worlds whatever the surface does in them.
    """
    generator = torch.Generator().manual_seed(seed)
    observed = Observed(scenario)
    yaw = torch.full((episodes,), scenario.panel_heading_rad, dtype=torch.float64)

    def opened(position_enu: Tensor, velocity_enu: Tensor, users_enu: Tensor) -> tuple[Channels, Channels]:
        """Channels of a slot as they are and as they are observed."""
        tilt = steady_tilt(scenario, velocity_enu, yaw) if scenario.attitude == "flown" else ()
        fading = draw_fading(scenario, (episodes,), generator, torch.float64)
        channels = faded_channels(scenario, position_enu, panel_frame(yaw, *tilt), users_enu, fading)
        return channels, observed.of(channels, generator)

    position = torch.tensor(scenario.start_enu, dtype=torch.float64).expand(episodes, 3)
    users = initial_users(scenario, (episodes,), generator, torch.float64)
    channels, known = opened(position, torch.zeros_like(position), users.position_enu)
    total = torch.zeros(episodes, dtype=torch.float64)
    for slot in range(scenario.slots):
        solution = closed_form(scenario, known) if iterations is None else solve(scenario, known, iterations)
        solution = quantised(scenario, known, solution)
        move = greedy_move(scenario, position, yaw, users.position_enu, slot)
        velocity = move / scenario.slot_s
        position = position + move
        users = move_users(scenario, users, generator)
        before = channels
        channels, known = opened(position, velocity, users.position_enu)
        rated = before if scenario.timing == "pre" else channels
        rates = slot_rates(scenario, rated, solution.trc, solution.beamforming)
        total += reward(scenario, rates.fair_rate_bps, slot_power(scenario, velocity, yaw))
    return total
