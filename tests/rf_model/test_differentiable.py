"""Gradients of the sum of rates by autograd against finite differences of the same functions, in double precision."""

import math

import pytest
import torch

from rf_model.channels import draw_channels
from rf_model.mobility import initial_users
from rf_model.scenario import preset
from rf_model.star_ris import IndependentTrc, Trc
from rf_model.world import slot_power, slot_rates

SCENARIOS = {
    "physical_small": preset("physical_small"),
    "prototype_s4": preset("prototype_s4"),
    "3gpp": preset("physical_small", path_loss="3gpp", extrapolate=True),
    "no direct link": preset("physical_small", direct="blocked"),
    "eq. 13 as printed": preset("physical_small", sinr="amplitude"),
}


def inputs(scenario):
    """theta, split, beams [M, J, 2], position and displacement of the vehicle, all to be differentiated."""
    generator = torch.Generator().manual_seed(5)

    def uniform(*shape):
        return torch.rand(shape, generator=generator, dtype=torch.float64) * 2 - 1

    N, M, J = scenario.elements, scenario.antennas, scenario.users
    theta, split = math.pi * uniform(N), math.pi / 4 * (1 + 0.9 * uniform(N))
    beams = uniform(M, J, 2) * math.sqrt(scenario.p_max_w / (M * J))
    position = torch.tensor([13.0, -7.0, 64.0], dtype=torch.float64)
    return [values.requires_grad_() for values in (theta, split, beams, position)]


def sum_rate(scenario, trc, beams, position):
    """[Mbit/s], with users and fading of a fixed seed: only the vehicle's place moves the channels."""
    generator = torch.Generator().manual_seed(1)
    users = initial_users(scenario, (), generator, torch.float64)
    yaw = torch.tensor(0.3, dtype=torch.float64)
    channels = draw_channels(scenario, position, yaw, users.position_enu, generator)
    assert channels.transmission.any()
    assert not channels.transmission.all()
    rates = slot_rates(scenario, channels, trc, torch.view_as_complex(beams))
    return rates.sum_rate_bps / 1e6, rates.fair_rate_bps / 1e6


@pytest.mark.parametrize("name", SCENARIOS)
def test_rates_follow_coefficients_beams_and_position(name):
    scenario = SCENARIOS[name]
    sign = torch.where(torch.arange(scenario.elements) % 3 > 0, 1.0, -1.0).double()

    def rates(theta, split, beams, position):
        return sum_rate(scenario, Trc(theta, split, sign), beams, position)

    at = inputs(scenario)
    gradients = torch.autograd.grad(rates(*at)[0], at)
    assert all((gradient.abs() > 0).any() for gradient in gradients)
    assert torch.autograd.gradcheck(rates, at, eps=1e-6, atol=1e-7, rtol=1e-4)


def test_rates_follow_free_phases():
    scenario = SCENARIOS["physical_small"]
    theta, split, beams, position = inputs(scenario)
    other = (theta.detach() * 0.7 + 0.2).requires_grad_()

    def rates(theta, split, other, beams, position):
        return sum_rate(scenario, IndependentTrc(theta, split, other), beams, position)

    assert torch.autograd.gradcheck(rates, (theta, split, other, beams, position), eps=1e-6, atol=1e-7, rtol=1e-4)


def test_power_follows_velocity():
    scenario = SCENARIOS["physical_small"]
    velocity = torch.tensor([4.0, -3.0, 1.0], dtype=torch.float64, requires_grad=True)
    yaw = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v, a: slot_power(scenario, v, a), (velocity, yaw))
