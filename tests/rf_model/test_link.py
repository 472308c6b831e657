"""SINR, rates, fairness and reward against the paper's equations written out user by user."""

import cmath
import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from airframe.power import drag_force, total_power
from rf_model.channels import Channels
from rf_model.fairness import fair_rate_bps, hfi, jfi
from rf_model.geometry import panel_frame
from rf_model.link import BeamformingError, check_beamforming, identity_beamforming, rate_bps, sinr
from rf_model.reward import reward
from rf_model.scenario import preset
from rf_model.star_ris import Trc
from rf_model.world import slot_power, slot_rates, steady_tilt, track_power

SCENARIO = preset("physical_small", users=3, antennas=2, rows=2, columns=3)
BATCH, J, M, N = 4, 3, 2, 6
rates_of_users = st.lists(st.floats(0, 1e8), min_size=1, max_size=8)


def complex_normal(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / math.sqrt(2)


@pytest.fixture
def drawn():
    rng = np.random.default_rng(7)
    channels = Channels(
        direct=torch.from_numpy(1e-6 * complex_normal(rng, BATCH, J, M)),
        bs_ris=torch.from_numpy(1e-3 * complex_normal(rng, BATCH, N, M)),
        ris_user=torch.from_numpy(1e-3 * complex_normal(rng, BATCH, J, N)),
        transmission=torch.from_numpy(rng.random((BATCH, J)) < 0.5),
    )
    trc = Trc(
        torch.from_numpy(rng.uniform(-math.pi, math.pi, (BATCH, N))),
        torch.from_numpy(rng.uniform(0, math.pi / 2, (BATCH, N))),
        torch.from_numpy(rng.choice([-1.0, 1.0], (BATCH, N))),
    )
    beams = torch.from_numpy(0.3 * complex_normal(rng, BATCH, M, J))
    return channels, trc, beams


def rates_by_loops(channels, trc, beams, b, noise_w, reading):
    """Eq. 2, 12, 13 and 14 for one world, element by element and user by user."""
    h_b, H, h_s = (x[b].numpy() for x in (channels.direct, channels.bs_ris, channels.ris_user))
    W = beams[b].numpy()
    rates = []
    for j in range(J):
        g = [h_b[j, m] for m in range(M)]
        for n in range(N):
            theta, x, sign = (float(field[b, n]) for field in (trc.theta_reflection, trc.split_angle, trc.sign))
            if channels.transmission[b, j]:
                phi = math.cos(x) * cmath.exp(1j * (theta + sign * math.pi / 2))
            else:
                phi = math.sin(x) * cmath.exp(1j * theta)
            for m in range(M):
                g[m] += h_s[j, n] * phi * H[n, m]
        streams = [sum(g[m] * W[m, k] for m in range(M)) for k in range(J)]
        others = [streams[k] for k in range(J) if k != j]
        if reading == "power":
            gamma = abs(streams[j]) ** 2 / (sum(abs(other) ** 2 for other in others) + noise_w)
        else:
            gamma = abs(streams[j]) / (abs(sum(others)) + noise_w)
        rates.append(SCENARIO.bandwidth_hz * math.log2(1 + gamma))
    return rates


@pytest.mark.parametrize("reading", ["power", "amplitude"])
def test_rates_are_those_of_the_equations(drawn, reading):
    scenario = SCENARIO.model_copy(update={"sinr": reading})
    rates = slot_rates(scenario, *drawn)
    for b in range(BATCH):
        expected = rates_by_loops(*drawn, b, scenario.noise_w, reading)
        assert rates.rate_bps[b].tolist() == pytest.approx(expected, rel=1e-9)
        assert rates.sum_rate_bps[b].item() == pytest.approx(sum(expected), rel=1e-9)
        assert rates.fair_rate_bps[b].item() == pytest.approx(J**2 / sum(1 / r for r in expected), rel=1e-9)


def test_float32_rates_agree_with_double(drawn):
    channels, trc, beams = drawn
    single = slot_rates(
        SCENARIO,
        Channels(
            channels.direct.to(torch.complex64),
            channels.bs_ris.to(torch.complex64),
            channels.ris_user.to(torch.complex64),
            channels.transmission,
        ),
        Trc(trc.theta_reflection.float(), trc.split_angle.float(), trc.sign.float()),
        beams.to(torch.complex64),
    )
    assert torch.allclose(single.rate_bps.double(), slot_rates(SCENARIO, *drawn).rate_bps, rtol=1e-4)


def test_a_row_does_not_depend_on_what_other_rows_do(drawn):
    channels, trc, beams = drawn
    before = slot_rates(SCENARIO, channels, trc, beams).rate_bps
    changed = Trc(trc.theta_reflection.clone(), trc.split_angle, trc.sign)
    changed.theta_reflection[0] += 1
    other_beams = beams.clone()
    other_beams[0] *= 0.1
    after = slot_rates(SCENARIO, channels, changed, other_beams).rate_bps
    assert torch.equal(before[1:], after[1:])
    assert not torch.equal(before[0], after[0])


def test_rates_are_differentiable_in_coefficients_and_beams(drawn):
    channels, trc, beams = drawn

    def total(theta, split, W):
        return slot_rates(SCENARIO, channels, Trc(theta, split, trc.sign), W).sum_rate_bps.sum() * 1e-6

    inputs = (trc.theta_reflection, trc.split_angle, beams)
    assert torch.autograd.gradcheck(total, tuple(x.clone().requires_grad_() for x in inputs), atol=1e-5)


def test_one_user_alone_has_the_signal_to_noise_ratio():
    received = torch.tensor([[3e-7 + 4e-7j]], dtype=torch.complex128)
    assert sinr(received, 1e-14).item() == pytest.approx(25.0)
    assert rate_bps(torch.tensor([3.0]), 1e6).item() == pytest.approx(2e6)


def test_strong_signal_does_not_wash_out_weak_interference_in_float32():
    received = torch.tensor([[1.0, 1e-5], [1e-5, 1.0]], dtype=torch.complex64)
    assert sinr(received, 1e-14).tolist() == pytest.approx([1e10, 1e10], rel=1e-4)


@given(rates_of_users)
@settings(deadline=None)
def test_indices_stay_in_their_ranges(rates):
    rate = torch.tensor(rates, dtype=torch.float64)
    harmonic, jain = hfi(rate).item(), jfi(rate).item()
    assert 0 <= harmonic <= 1
    assert 0 <= jain <= 1 + 1e-12
    if max(rates) > 0:
        assert jain >= 1 / len(rates) - 1e-12


@given(st.lists(st.floats(1, 1e8), min_size=2, max_size=8))
@settings(deadline=None)
def test_fair_rate_is_hfi_times_sum_rate(rates):
    rate = torch.tensor(rates, dtype=torch.float64)
    arithmetic = sum(rates) / len(rates)
    harmonic = len(rates) / sum(1 / r for r in rates)
    assert fair_rate_bps(rate).item() == pytest.approx(len(rates) ** 2 / sum(1 / r for r in rates), rel=1e-9)
    if sum(rates) > len(rates):
        assert hfi(rate).item() == pytest.approx(harmonic / arithmetic, rel=1e-9)
        assert (hfi(rate) * rate.sum()).item() == pytest.approx(fair_rate_bps(rate).item(), rel=1e-9)


def test_equal_rates_are_perfectly_fair():
    rate = torch.full((4,), 3e5)
    assert (hfi(rate).item(), jfi(rate).item()) == (pytest.approx(1.0), pytest.approx(1.0))
    assert fair_rate_bps(rate).item() == pytest.approx(1.2e6)


def test_one_rich_user_of_eight():
    rate = torch.tensor([10.0] + [1.0] * 7) * 1e6
    assert (hfi(rate).item(), jfi(rate).item()) == (pytest.approx(0.53, abs=5e-3), pytest.approx(0.34, abs=5e-3))


def test_starved_user_takes_the_harmonic_index_to_zero_without_a_jump():
    index = [hfi(torch.tensor([1e6, r], dtype=torch.float64)).item() for r in (10.0, 1.0, 0.1, 0.0)]
    assert index[:2] == pytest.approx([4e-5, 4e-6], rel=1e-3)
    assert index[1:] == pytest.approx([index[1]] * 3, rel=1e-5)
    silent = torch.zeros(3)
    assert (hfi(silent).item(), jfi(silent).item()) == (0.0, 0.0)


def test_reward_in_megabits_and_hovering_powers():
    scenario = preset("physical_small", alpha=2.0, beta=0.3)
    value = reward(scenario, torch.tensor(1.5e6), torch.tensor(2 * scenario.hover_power_w))
    assert value.item() == pytest.approx(2.0 * 1.5 - 0.3 * 2)


def test_slot_power_knows_the_panels_heading():
    scenario = preset("physical_1km")
    velocity = torch.tensor([[10.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    power = slot_power(scenario, velocity, torch.tensor([0.0, math.pi / 2, 0.0]))
    # 401 W face-on with lambda = 6 cm; it is 59.96 mm here
    assert power.tolist() == pytest.approx([400.6, 140.5, 192.5], abs=0.1)


def test_identity_beamforming_is_at_the_limit():
    for users, antennas in ((4, 4), (3, 8), (6, 4)):
        scenario = preset("physical_small", users=users, antennas=antennas)
        beams = identity_beamforming(scenario, torch.complex128)
        assert beams.abs().square().sum().item() == pytest.approx(scenario.p_max_w)
        check_beamforming(beams, scenario)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda W: W * 1.001, r"W in all is above p_max \(0.794328 W\)"),
        (lambda W: W[:3], r"shape \[3, 4\], must be M x J = 4 x 4"),
        (lambda W: W * math.nan, "not finite"),
    ],
)
def test_beams_that_cannot_be_sent_are_refused(change, words):
    scenario = preset("physical_small")
    with pytest.raises(BeamformingError, match=words):
        check_beamforming(change(identity_beamforming(scenario, torch.complex128)), scenario)


def test_power_limit_per_user():
    scenario = preset("physical_small", p_max="per_user")
    beams = identity_beamforming(scenario, torch.complex128)
    check_beamforming(beams * 2, scenario)
    with pytest.raises(BeamformingError, match="for a user"):
        check_beamforming(beams * 2.01, scenario)


@pytest.mark.parametrize("velocity", [(0.0, 0.0, 0.0), (7.0, -3.0, 1.0)])
def test_power_is_that_of_the_velocity_through_the_air(velocity):
    windy = preset("physical_small", wind_enu=(2.0, -5.0, 0.5))
    through_air = [v - w for v, w in zip(velocity, windy.wind_enu, strict=True)]
    expected = total_power(windy.wing, windy.panel, *through_air, math.cos(0.3), math.sin(0.3))
    yaw = torch.tensor(0.3, dtype=torch.float64)
    assert slot_power(windy, torch.tensor(velocity, dtype=torch.float64), yaw).item() == pytest.approx(expected)


def test_track_power_is_the_time_mean():
    time = torch.tensor([0.0, 0.25, 1.0], dtype=torch.float64)
    velocity = torch.tensor([[0.0, 0, 0], [4.0, 0, 0], [8.0, 0, 0]], dtype=torch.float64)
    yaw = torch.tensor(0.0, dtype=torch.float64)
    p = slot_power(SCENARIO, velocity, yaw).tolist()
    expected = 0.25 * (p[0] + p[1]) / 2 + 0.75 * (p[1] + p[2]) / 2
    assert track_power(SCENARIO, time, velocity, yaw).item() == pytest.approx(expected)


@given(st.floats(-12, 12), st.floats(-12, 12), st.floats(-math.pi, math.pi))
@settings(deadline=None)
def test_thrust_at_the_steady_tilt_holds_weight_and_drag(x, y, heading):
    """The body's up axis, by its rotation, points along the drag to overcome plus the weight."""
    scenario = preset("physical_small", wind_enu=(1.0, 2.0, 0.0))
    yaw = torch.tensor(heading, dtype=torch.float64)
    roll, pitch = steady_tilt(scenario, torch.tensor([x, y, 0.0], dtype=torch.float64), yaw)
    up = panel_frame(yaw, roll, pitch)[2].numpy()
    normal = (math.cos(heading), math.sin(heading))
    force = np.array([*drag_force(scenario.wing, scenario.panel, x - 1.0, y - 2.0, *normal), scenario.wing.weight_n])
    np.testing.assert_allclose(up, force / np.linalg.norm(force), atol=1e-6)


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (3.0, -2.0, 0.5)])
def test_a_single_velocity_takes_the_power_that_it_takes_among_others(wind):
    scenario = preset("physical_small", wind_enu=wind)
    velocity = torch.tensor([[4.0, -3.0, 1.0], [0.0, 0.0, 0.0], [-9.0, 2.0, -1.5]])
    yaw = torch.tensor([0.3, -1.0, 2.0])
    together = slot_power(scenario, velocity, yaw)
    one_by_one = [slot_power(scenario, velocity[row : row + 1], yaw[row : row + 1]) for row in range(3)]
    torch.testing.assert_close(torch.cat(one_by_one), together, rtol=1e-6, atol=0)
    assert slot_power(scenario, velocity[0], yaw[0]).shape == ()
