"""The whole radio model against what the design's prototypes found."""

import math
from dataclasses import replace

import pytest
import torch

from airframe.displacement import spherical
from airframe.power import drag_force
from rf_model.channels import draw_channels
from rf_model.geometry import panel_frame
from rf_model.mobility import initial_users, move_users
from rf_model.reward import reward
from rf_model.scenario import preset
from rf_model.star_ris import Trc
from rf_model.world import slot_power, slot_rates, steady_tilt

F64 = torch.float64


def uniform(shape, low, high, generator, dtype):
    return low + (high - low) * torch.rand(shape, generator=generator, dtype=dtype)


def random_trc(scenario, batch, generator, dtype):
    shape = (batch, scenario.elements)
    return Trc(
        uniform(shape, -math.pi, math.pi, generator, dtype),
        uniform(shape, 0, math.pi / 2, generator, dtype),
        torch.randint(0, 2, shape, generator=generator).to(dtype) * 2 - 1,
    )


def random_beams(scenario, batch, generator, dtype):
    re_im = uniform((batch, scenario.antennas, scenario.users, 2), -1, 1, generator, dtype)
    beams = torch.view_as_complex(re_im)
    return beams * math.sqrt(scenario.p_max_w) / beams.abs().square().sum((-2, -1), keepdim=True).sqrt()


def test_random_policy_on_the_prototype_scenario_earns_what_the_prototype_did():
    scenario, batch, dtype = preset("prototype_s4"), 3000, torch.float32
    generator = torch.Generator().manual_seed(1)
    low, high = torch.tensor(scenario.box_enu, dtype=dtype).T
    position = torch.tensor(scenario.start_enu, dtype=dtype).expand(batch, 3)
    yaw = torch.zeros(batch, dtype=dtype)
    users = initial_users(scenario, (batch,), generator, dtype)
    episode = torch.zeros(batch)
    for slot in range(scenario.slots):
        if slot:
            users = move_users(scenario, users, generator)
        channels = draw_channels(scenario, position, yaw, users.position_enu, generator)
        trc = random_trc(scenario, batch, generator, dtype)
        rates = slot_rates(scenario, channels, trc, random_beams(scenario, batch, generator, dtype))
        move = spherical(
            uniform((batch,), 0, 10, generator, dtype),
            uniform((batch,), -math.pi / 2, math.pi / 2, generator, dtype),
            uniform((batch,), 0, 2 * math.pi, generator, dtype),
        )
        moved = (position + torch.stack(move, -1)).clamp(low, high)
        episode += reward(scenario, rates.fair_rate_bps, slot_power(scenario, moved - position, yaw))
        position = moved
    standard_error = episode.std().item() / math.sqrt(batch)
    assert episode.mean().item() == pytest.approx(-0.4, abs=0.02 + 3 * standard_error)


def best_gain(name, steps=150, batch=24):
    """Mean sum rate with the surface's coefficients climbed by gradient, over that without a surface; beams random."""
    scenario = preset(name)
    generator = torch.Generator().manual_seed(3)
    users = initial_users(scenario, (batch,), generator, F64)
    start = torch.tensor(scenario.start_enu, dtype=F64).expand(batch, 3)
    channels = draw_channels(scenario, start, torch.zeros(batch, dtype=F64), users.position_enu, generator)
    beams = random_beams(scenario, batch, generator, F64)
    trc = random_trc(scenario, batch, generator, F64)
    without = slot_rates(scenario, replace(channels, ris_user=0 * channels.ris_user), trc, beams).sum_rate_bps.mean()
    theta, split = trc.theta_reflection.requires_grad_(), trc.split_angle.requires_grad_()
    optimiser = torch.optim.Adam([theta, split], lr=0.05)
    for _ in range(steps):
        optimiser.zero_grad()
        best = slot_rates(scenario, channels, Trc(theta, split.clamp(0, math.pi / 2), trc.sign), beams).sum_rate_bps
        (-1e-6 * best.sum()).backward()
        optimiser.step()
    return (best.mean() / without).item()


def test_the_surface_hardly_matters_when_the_paper_is_taken_literally():
    assert 1.0002 < best_gain("paper_literal") < 1.01


def test_the_surface_carries_the_traffic_in_the_physical_scenarios():
    assert best_gain("physical_small") > 100


@pytest.mark.parametrize("yaw", [0.0, 0.8, -2.5])
def test_a_vehicle_leans_so_that_its_thrust_holds_weight_and_drag(yaw):
    scenario = preset("physical_1km", wind_enu=(2.0, 1.0, 0.0))
    heading = torch.tensor(yaw, dtype=torch.float64)
    roll, pitch = steady_tilt(scenario, torch.tensor([8.0, -5.0, 1.0], dtype=torch.float64), heading)
    east, north = drag_force(scenario.wing, scenario.panel, 6.0, -6.0, math.cos(yaw), math.sin(yaw))
    thrust = panel_frame(heading, roll, pitch)[2]  # the body's up axis
    assert (thrust * (25.0 / thrust[2])).tolist() == pytest.approx([east, north, 25.0])
