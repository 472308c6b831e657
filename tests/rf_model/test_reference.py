"""The reference's front: what it gives is feasible, never falls, and is what the radio model says it is."""

import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from rf_model.channels import Channels, draw_channels
from rf_model.link import BeamformingError, check_beamforming
from rf_model.mobility import initial_users
from rf_model.reference.elements import Element, elements_of
from rf_model.reference.solve import ReferenceInputError, closed_form, quantised, solve
from rf_model.scenario import preset
from rf_model.star_ris import check_trc
from rf_model.surfaces import surface_of
from rf_model.world import slot_rates

SCENARIO = preset("prototype_s4")
KINDS = ("coupled", "independent", "dual", "conventional")


def random_channels(seed, batch, users, antennas, elements, snr_db=20.0, dtype=torch.complex128):
    """Rayleigh links; `snr_db` is that of one antenna over one element."""
    generator = torch.Generator().manual_seed(seed)
    amplitude = math.sqrt(10 ** (snr_db / 10) * SCENARIO.noise_w / SCENARIO.p_max_w)

    def scattered(*shape):
        return torch.randn(batch, *shape, generator=generator, dtype=torch.complex128).to(dtype)

    return Channels(
        direct=scattered(users, antennas) * amplitude,
        bs_ris=scattered(elements, antennas) * amplitude,
        ris_user=scattered(users, elements),
        transmission=torch.rand(batch, users, generator=generator) < 0.5,
    )


def drawn_channels(scenario, batch=(8,), seed=0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    position = torch.tensor(scenario.start_enu, dtype=dtype).expand(*batch, 3)
    users = initial_users(scenario, batch, generator, dtype)
    return draw_channels(scenario, position, torch.zeros(batch, dtype=dtype), users.position_enu, generator)


def utility_of(scenario, channels, solution, objective):
    """The objective by the equations, coefficients as they are."""
    phi = torch.where(
        channels.transmission.unsqueeze(-1), solution.transmission.unsqueeze(-2), solution.reflection.unsqueeze(-2)
    )
    powers = ((channels.direct + (channels.ris_user * phi) @ channels.bs_ris) @ solution.beamforming).abs() ** 2
    own = powers.diagonal(dim1=-2, dim2=-1)
    rate = scenario.bandwidth_hz * torch.log2(1 + own / (powers.sum(-1) - own + scenario.noise_w))
    return rate.sum(-1) if objective == "sum_rate" else rate.shape[-1] ** 2 / (1 / rate.clamp_min(1.0)).sum(-1)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    users=st.integers(1, 5),
    antennas=st.integers(1, 5),
    elements=st.integers(1, 12),
    kind=st.sampled_from(KINDS),
    objective=st.sampled_from(["harmonic", "sum_rate"]),
    p_max=st.sampled_from(["total", "per_user"]),
    snr_db=st.floats(-80, 80),
    given_start=st.booleans(),
)
def test_utility_never_falls_and_all_it_gives_is_feasible(
    seed, users, antennas, elements, kind, objective, p_max, snr_db, given_start
):
    assume(kind != "dual" or elements > 1)
    sizes = {"users": users, "antennas": antennas, "rows": 1, "columns": elements}
    scenario = preset("prototype_s4", p_max=p_max, surface=kind, **sizes)
    channels = random_channels(seed, 3, users, antennas, elements, snr_db)
    start = None
    if given_start:
        noise = torch.randn(2, 3, elements, generator=torch.Generator().manual_seed(seed), dtype=torch.complex128)
        start = (noise[0], noise[1])
    solution = solve(scenario, channels, 12, objective, coefficients=start)
    history = solution.utility_bps
    assert history.shape == (3, 13)
    assert (history.diff() >= 0).all()
    torch.testing.assert_close(
        history[:, -1], utility_of(scenario, channels, solution, objective), rtol=1e-7, atol=1e-6
    )

    check_beamforming(solution.beamforming, scenario)
    energy = solution.reflection.abs() ** 2 + solution.transmission.abs() ** 2
    torch.testing.assert_close(energy, torch.ones_like(energy), rtol=0, atol=1e-12)
    if kind != "independent":
        beside = (solution.transmission * solution.reflection.conj()).real
        torch.testing.assert_close(beside, torch.zeros_like(beside), rtol=0, atol=1e-12)
        check_trc(solution.trc, elements)
    if kind == "dual":
        assert (solution.transmission[:, ::2] == 0).all()
        assert (solution.reflection[:, 1::2] == 0).all()
    if kind == "conventional":
        assert (solution.transmission == 0).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_radio_model_gives_the_rates_that_the_reference_says(dtype):
    channels = drawn_channels(SCENARIO, dtype=dtype)
    for solution in (closed_form(SCENARIO, channels), solve(SCENARIO, channels, 10)):
        trc = solution.trc
        assert trc.theta_reflection.dtype == dtype
        check_trc(trc, SCENARIO.elements)
        check_beamforming(solution.beamforming, SCENARIO)
        for ours, theirs in zip((solution.reflection, solution.transmission), trc.coefficients(), strict=True):
            torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-6 if dtype == torch.float32 else 1e-12)
        rates = slot_rates(SCENARIO, channels, trc, solution.beamforming)
        tolerance = 1e-3 if dtype == torch.float32 else 1e-9
        torch.testing.assert_close(rates.fair_rate_bps.double(), solution.utility_bps[:, -1], rtol=tolerance, atol=0.0)


def test_iterations_help_and_three_beam_steps_beat_zero_forcing():
    channels = drawn_channels(SCENARIO, (32,))
    plain = closed_form(SCENARIO, channels).utility_bps[:, -1]
    history = solve(SCENARIO, channels, 40).utility_bps
    assert (history[:, 0] >= plain).all()
    assert history[:, -1].mean() > 1.2 * history[:, 0].mean() > 1.2 * plain.mean()


def test_a_row_depends_on_no_other_and_on_no_batch():
    channels = drawn_channels(SCENARIO, (5,), seed=1)
    others = drawn_channels(SCENARIO, (5,), seed=2)
    mixed = Channels(
        *(
            torch.cat((getattr(others, name)[:2], getattr(channels, name)[2:]))
            for name in ("direct", "bs_ris", "ris_user", "transmission")
        )
    )
    alone = Channels(*(getattr(channels, name)[3] for name in ("direct", "bs_ris", "ris_user", "transmission")))
    whole, exchanged, single = (solve(SCENARIO, c, 5) for c in (channels, mixed, alone))
    assert torch.equal(whole.utility_bps[2:], exchanged.utility_bps[2:])
    assert torch.equal(whole.beamforming[2:], exchanged.beamforming[2:])
    assert single.utility_bps.shape == (6,)
    assert single.beamforming.shape == (4, 4)
    torch.testing.assert_close(single.utility_bps, whole.utility_bps[3], rtol=1e-9, atol=0.0)


def test_numpy_channels_serve_as_well():
    channels = drawn_channels(SCENARIO, (2,))
    arrays = Channels(*(getattr(channels, name).numpy() for name in ("direct", "bs_ris", "ris_user", "transmission")))
    assert torch.equal(solve(SCENARIO, arrays, 3).utility_bps, solve(SCENARIO, channels, 3).utility_bps)


@pytest.mark.parametrize("objective", ["harmonic", "sum_rate"])
def test_independent_phases_started_at_the_coupled_solution_are_never_worse(objective):
    channels = drawn_channels(SCENARIO, (24,))
    coupled = solve(SCENARIO, channels, 20, objective)
    independent = solve(
        preset("prototype_s4", surface="independent"),
        channels,
        20,
        objective,
        coefficients=(coupled.reflection, coupled.transmission),
        beamforming=coupled.beamforming,
    )
    reached = coupled.utility_bps[:, -1]
    torch.testing.assert_close(independent.utility_bps[:, 0], reached, rtol=1e-9, atol=0.0)
    assert (independent.utility_bps[:, -1] >= reached * (1 - 1e-6)).all()
    assert independent.utility_bps[:, -1].mean() > reached.mean()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bits", [None, 1, 2, 3])
def test_solutions_are_what_the_scenarios_surface_can_show(kind, bits):
    scenario = preset("prototype_s4", surface=kind, phase_bits=bits)
    channels = drawn_channels(scenario)
    free = solve(scenario, channels, 10)
    solution = quantised(scenario, channels, free)
    surface_of(scenario).check(solution.trc)
    check_beamforming(solution.beamforming, scenario)
    rates = slot_rates(scenario, channels, solution.trc, solution.beamforming)
    torch.testing.assert_close(rates.fair_rate_bps, solution.utility_bps[:, -1], rtol=1e-6, atol=1e-3)
    if bits is None:
        assert solution is free


def test_finer_phases_lose_less():
    coarse, fine, free = (
        quantised(scenario, channels, solve(scenario, channels, 20)).utility_bps[:, -1].mean()
        for scenario in (preset("prototype_s4", phase_bits=bits) for bits in (1, 3, None))
        for channels in (drawn_channels(scenario, (64,)),)
    )
    assert coarse < fine < free


def test_surfaces_come_in_the_order_that_their_freedom_gives():
    channels = drawn_channels(SCENARIO, (48,))
    mean = {kind: solve(preset("prototype_s4", surface=kind), channels, 40).utility_bps[:, -1].mean() for kind in KINDS}
    assert mean["independent"] > mean["coupled"] > 1.1 * mean["dual"] > mean["conventional"]


def test_users_all_on_one_side_or_without_any_link():
    channels = drawn_channels(SCENARIO, (4,))
    for everyone in (True, False):
        one_sided = replace(channels, transmission=torch.full((4, 4), everyone))
        history = solve(SCENARIO, one_sided, 5).utility_bps
        assert (history[:, -1] > history[:, 0]).all()
    silent = replace(channels, direct=torch.zeros_like(channels.direct), bs_ris=torch.zeros_like(channels.bs_ris))
    solution = solve(SCENARIO, silent, 5)
    assert torch.isfinite(solution.utility_bps).all()
    check_trc(solution.trc, SCENARIO.elements)
    check_beamforming(solution.beamforming, SCENARIO)


def test_users_whom_the_sum_rate_gives_up_leave_all_else_in_order():
    """With 4 users on 2 antennas some get less power at every step, until it is 0 in floating point."""
    scenario = preset("prototype_s4", p_max="per_user", users=4, antennas=2, rows=1, columns=10)
    channels = random_channels(182, 2, 4, 2, 10, snr_db=17.7)
    solution = solve(scenario, channels, 200, "sum_rate")
    check_beamforming(solution.beamforming, scenario)
    assert ((solution.beamforming.abs() ** 2).sum(-2) == 0).any()
    reached = utility_of(scenario, channels, solution, "sum_rate")
    torch.testing.assert_close(solution.utility_bps[:, -1], reached, rtol=1e-9, atol=0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"iterations": -1}, "iterations: -1"),
        ({"objective": "max_min"}, "objective: 'max_min' is not one of harmonic, sum_rate"),
        ({"beamforming": torch.zeros(8, 4, 4, dtype=torch.complex128)}, "beamforming: given without coefficients"),
        ({"coefficients": (torch.zeros(8, 3), torch.zeros(8, 3))}, "coefficients: shape"),
        ({"coefficients": (torch.full((8, 16), math.nan), torch.zeros(8, 16))}, "coefficients: not finite"),
        ({"scenario": preset("paper_literal")}, "sinr: 'amplitude' is not allowed"),
    ],
)
def test_bad_requests_are_refused_in_one_line(change, message):
    request = {"scenario": SCENARIO, "channels": drawn_channels(SCENARIO), "iterations": 1} | change
    with pytest.raises(ReferenceInputError, match=message) as caught:
        solve(**request)
    assert "\n" not in str(caught.value)


def test_bad_channels_are_refused():
    channels = drawn_channels(SCENARIO)
    with pytest.raises(ReferenceInputError, match=r"ris_user: shape \[8, 4, 9\], must be \[8, 4, 16\]"):
        solve(SCENARIO, replace(channels, ris_user=channels.ris_user[..., :9]), 1)
    with pytest.raises(ReferenceInputError, match="direct: not finite"):
        solve(SCENARIO, replace(channels, direct=channels.direct * math.nan), 1)
    with pytest.raises(ReferenceInputError, match="0 users"):
        closed_form(
            SCENARIO,
            Channels(
                *(getattr(channels, f)[:, :0] for f in ("direct",)),
                channels.bs_ris,
                channels.ris_user[:, :0],
                channels.transmission[:, :0],
            ),
        )


def test_beams_to_start_from_must_keep_the_power_limit():
    channels = drawn_channels(SCENARIO)
    solution = solve(SCENARIO, channels, 1)
    start = (solution.reflection, solution.transmission)
    with pytest.raises(BeamformingError, match="above p_max"):
        solve(SCENARIO, channels, 1, coefficients=start, beamforming=2 * solution.beamforming)


def test_elements_of_a_dual_surface_serve_the_sides_in_turn():
    assert elements_of("dual", 5).tolist() == [Element.REFLECTING, Element.TRANSMITTING] * 2 + [Element.REFLECTING]


def test_importing_the_front_does_not_import_numba():
    code = "import sys, rf_model.reference.solve, rf_model.reference.position; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60, check=False).returncode == 0


def test_an_empty_batch_is_no_error():
    channels = drawn_channels(SCENARIO)
    none = Channels(*(getattr(channels, name)[:0] for name in ("direct", "bs_ris", "ris_user", "transmission")))
    assert solve(SCENARIO, none, 2).utility_bps.shape == (0, 3)


def test_beams_in_single_precision_keep_the_limit_of_each_user():
    scenario = preset("prototype_s4", p_max="per_user")
    solution = solve(scenario, drawn_channels(scenario, dtype=torch.float32), 10)
    powers = (solution.beamforming.abs() ** 2).sum(-2)
    assert (powers <= scenario.p_max_w * (1 + 1e-6)).all()
    assert np.isclose(powers.max().item(), scenario.p_max_w, rtol=1e-5)
