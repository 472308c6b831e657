"""The closed form in tensors is the compiled one."""

import math

import pytest
import torch

from rf_model.channels import Channels, draw_channels
from rf_model.link import check_beamforming
from rf_model.mobility import initial_users
from rf_model.reference import solve, uncompiled
from rf_model.scenario import preset
from rf_model.surfaces import surface_of
from rf_model.world import slot_rates


def drawn(scenario, batch, seed=0):
    generator = torch.Generator().manual_seed(seed)
    position = torch.tensor(scenario.start_enu, dtype=torch.float64).expand(*batch, 3)
    users = initial_users(scenario, batch, generator, torch.float64)
    return draw_channels(scenario, position, torch.zeros(batch, dtype=torch.float64), users.position_enu, generator)


@pytest.mark.parametrize("p_max", ["total", "per_user"])
@pytest.mark.parametrize("surface", ["coupled", "independent", "dual", "conventional"])
def test_it_gives_the_coefficients_and_rates_of_the_compiled_one(surface, p_max):
    """The other one's strongest mode comes from 30 power iterations, so not to the last digit."""
    scenario = preset("physical_small", surface=surface, p_max=p_max)
    channels = drawn(scenario, (2, 6))
    trc, beams = uncompiled.closed_form(scenario, channels)
    theirs = solve.closed_form(scenario, channels)
    for ours, other in zip(trc.coefficients(), (theirs.reflection, theirs.transmission), strict=True):
        torch.testing.assert_close(ours, other, rtol=0, atol=1e-6)
    surface_of(scenario).check(trc)
    check_beamforming(beams, scenario)
    rates = slot_rates(scenario, channels, trc, beams)
    torch.testing.assert_close(rates.fair_rate_bps, theirs.utility_bps[..., -1], rtol=1e-5, atol=0.0)


@pytest.mark.parametrize("bits", [1, 2, 3])
@pytest.mark.parametrize("surface", ["coupled", "independent", "dual", "conventional"])
def test_phases_of_few_bits_are_the_nearest_and_beams_are_made_for_them(surface, bits):
    scenario = preset("physical_small", surface=surface, phase_bits=bits)
    channels = drawn(scenario, (6,))
    free, _ = uncompiled.closed_form(preset("physical_small", surface=surface), channels)
    trc, beams = uncompiled.closed_form(scenario, channels)
    surface_of(scenario).check(trc)
    check_beamforming(beams, scenario)
    off = torch.remainder(trc.theta_reflection - free.theta_reflection + math.pi, 2 * math.pi) - math.pi
    assert off.abs().max() <= math.pi / 2**bits + 1e-9
    forced = uncompiled.zero_forcing(scenario, _effective(channels, trc))
    torch.testing.assert_close(beams, forced)


def test_a_user_with_no_channel_at_all_is_given_up_and_nobody_else():
    scenario = preset("physical_small")
    channels = drawn(scenario, ())
    dead = torch.arange(scenario.users) == 2
    cut = Channels(
        direct=torch.where(dead[:, None], 0.0, channels.direct),
        bs_ris=channels.bs_ris,
        ris_user=torch.where(dead[:, None], 0.0, channels.ris_user),
        transmission=channels.transmission,
    )
    trc, beams = uncompiled.closed_form(scenario, cut)
    rates = slot_rates(scenario, cut, trc, beams).rate_bps
    assert (rates == 0).tolist() == dead.tolist()


def _effective(channels, trc):
    """Eq. 12 element by element."""
    sides = torch.stack(trc.coefficients(), dim=-2)
    phi = sides.gather(-2, channels.transmission.long()[..., None].expand(channels.ris_user.shape))
    return channels.direct + torch.einsum("...jn,...nm->...jm", channels.ris_user * phi, channels.bs_ris)
