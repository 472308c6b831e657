"""Single slots of many worlds, the vehicle hovering at its start."""

from dataclasses import replace

import torch

from rf_model.channels import Channels, draw_fading, faded_channels
from rf_model.geometry import panel_frame
from rf_model.mobility import initial_users
from rf_model.scenario import Scenario
from rf_model.seeding import generator_of

_USERS, _SIGHTS, _FADING = 0, 1, 2


def snapshots(scenario: Scenario, worlds: int, seed: int) -> Channels:
    """Channels [worlds] of slot 0, double precision.

    Users and their lines of sight are the same whatever the surface's size, so that sizes are compared in pairs.
    """
    position = torch.tensor(scenario.start_enu, dtype=torch.float64).expand(worlds, 3)
    yaw = torch.full((worlds,), scenario.panel_heading_rad, dtype=torch.float64)
    users = initial_users(scenario, (worlds,), generator_of(seed, _USERS), torch.float64)
    fading = draw_fading(scenario, (worlds,), generator_of(seed, _FADING), torch.float64)
    if fading.user_sight is not None:
        sights = torch.rand(fading.user_sight.shape, generator=generator_of(seed, _SIGHTS), dtype=torch.float64)
        fading = replace(fading, user_sight=sights)
    return faded_channels(scenario, position, panel_frame(yaw), users.position_enu, fading)
