"""Gradients of the reward through the decoding of raw actions, against finite differences in double precision."""

from dataclasses import replace

import pytest
import torch

from agent.decoding import action_size, continuous_size, decode
from agent.environment import Environment
from rf_model.reward import reward
from rf_model.scenario import preset
from rf_model.world import slot_power, slot_rates


@pytest.mark.parametrize("name", ["physical_small", "prototype_s4"])
def test_the_environments_gradient_is_that_of_the_reward(name):
    scenario = preset(name)
    environment = Environment(scenario, batch=1, seed=0)
    environment.reset()
    world = environment.world
    single = (torch.rand(1, action_size(scenario), generator=torch.Generator().manual_seed(2)) * 1.8 - 0.9) * 0.5
    double = single.double().requires_grad_()
    channels = replace(
        world.channels,
        direct=world.channels.direct.to(torch.complex128),
        bs_ris=world.channels.bs_ris.to(torch.complex128),
        ris_user=world.channels.ris_user.to(torch.complex128),
    )
    yaw = torch.tensor([scenario.panel_heading_rad], dtype=torch.float64)

    def of(raw):
        action = decode(raw, scenario)
        rates = slot_rates(scenario, channels, action.trc, action.beamforming)
        return reward(
            scenario, rates.fair_rate_bps, slot_power(scenario, action.displacement_enu / scenario.slot_s, yaw)
        )

    assert torch.autograd.gradcheck(of, double, eps=1e-6, atol=1e-7, rtol=1e-4)
    (expected,) = torch.autograd.grad(of(double).sum(), double)
    single.requires_grad_()
    (got,) = torch.autograd.grad(environment.step(single).reward.sum(), single)
    torch.testing.assert_close(got.double(), expected, rtol=2e-3, atol=2e-4 * expected.abs().max().item())
    continuous = continuous_size(scenario)
    assert (expected[:, 3:continuous] != 0).all()
    assert expected[:, :3].abs().max() > 0
    assert (expected[:, continuous:] == 0).all()
