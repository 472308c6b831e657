"""Channels against per-element loops in plain Python, and their statistics against theory."""

import cmath
import math

import numpy as np
import pytest
import torch
from scipy import stats

from rf_model import path_loss
from rf_model.arrays import literal_response, planar_response
from rf_model.channels import draw_channels, draw_fading, faded_channels, line_of_sight_probability, link_gains
from rf_model.geometry import panel_frame
from rf_model.scenario import preset
from rf_model.world import reference_gains

F64 = torch.float64


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def vector(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=F64)


def draw(scenario, position=(10.0, -20.0, 70.0), yaw=0.3, users=None, batch=(), seed=0):
    users = torch.tensor(
        users or [(-40.0, 30.0, 1.5), (-20.0, -60.0, 1.5), (50.0, 10.0, 1.5), (90.0, -5.0, 1.5)], dtype=F64
    )
    return draw_channels(
        scenario,
        vector(*position).expand(*batch, 3),
        vector(yaw)[0].expand(batch),
        users.expand(*batch, *users.shape),
        generator(seed),
    )


def los_only(**overrides):
    """A scenario whose scattering vanishes, so that the drawn channels are the array responses."""
    return preset("physical_small", kappa=1e6, ris_user="los", ris_gain_db=0.0, **overrides)


def element_position(n: int, scenario, yaw: float) -> np.ndarray:
    spacing = scenario.group * scenario.wavelength_m / scenario.mu
    row, column = divmod(n, scenario.columns)
    return column * spacing * np.array([-math.sin(yaw), math.cos(yaw), 0.0]) + row * spacing * np.array([0, 0, 1.0])


@pytest.mark.parametrize(("rows", "columns", "group"), [(4, 4, 1), (2, 5, 4)])
def test_surface_to_user_phases_are_the_path_lengths_in_the_far_field(rows, columns, group):
    scenario = los_only(rows=rows, columns=columns, group=group)
    yaw, position = 0.7, np.array([10.0, -20.0, 70.0])
    user = np.array([55.0, 31.0, 1.5])
    h = draw(scenario, tuple(position), yaw, [tuple(user)] * 4).ris_user[0].numpy()
    towards = (user - position) / np.linalg.norm(user - position)
    loss_db = 20 * math.log10(5) + 28 + 22 * math.log10(np.linalg.norm(user - position))
    for n in range(scenario.elements):
        nearer = element_position(n, scenario, yaw) @ towards
        expected = 10 ** (-loss_db / 20) * cmath.exp(2j * math.pi * nearer / scenario.wavelength_m)
        assert abs(h[n] - expected) < 5e-3 * abs(expected)  # scattering at kappa 1e6 is 1e-3 of the amplitude


def test_base_station_to_surface_is_the_outer_product_of_eq_4():
    scenario = los_only()
    yaw, position, base = 0.3, np.array([10.0, -20.0, 70.0]), np.array(scenario.base_station_enu)
    H = draw(scenario, tuple(position), yaw).bs_ris.numpy()
    distance = np.linalg.norm(base - position)
    arrival = (base - position) / distance
    sine = (position - base)[1] / distance
    loss_db = 20 * math.log10(5) + 28 + 22 * math.log10(distance)
    for n in range(scenario.elements):
        for m in range(scenario.antennas):
            phase = 2 * math.pi * (element_position(n, scenario, yaw) @ arrival) / scenario.wavelength_m
            expected = 10 ** (-loss_db / 20) * cmath.exp(1j * (phase - math.pi * m * sine))
            assert abs(H[n, m] - expected) < 5e-3 * abs(expected)


def test_literal_array_is_eq_6_with_its_quadratic_phase():
    azimuth, elevation, columns, spacing = 0.4, -0.6, 4, 0.5
    normal, column, row = (
        math.cos(elevation) * math.cos(azimuth),
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
    )
    response = literal_response(vector(normal)[0], vector(column)[0], vector(row)[0], 16, columns, spacing).numpy()
    for n in range(1, 17):
        first = math.floor(n / columns) * math.sin(azimuth) * math.sin(elevation)
        second = (n - math.floor(n / columns) * columns) * math.sin(azimuth) * math.cos(elevation)
        assert response[n - 1] == pytest.approx(cmath.exp(2j * math.pi * (n - 1) * spacing * (first + second)))


def test_broadside_of_a_planar_array_is_in_phase():
    assert torch.allclose(planar_response(vector(0.0), vector(0.0), 3, 5, 0.5).real, torch.ones(1, 15, dtype=F64))


@pytest.fixture(scope="module")
def many():
    """Twenty thousand draws at one geometry."""
    return draw(preset("physical_small", ris_user="los", direct_extra_db=0.0), batch=(20_000,), seed=5)


def test_direct_link_is_rayleigh_at_its_path_loss(many):
    h = many.direct[:, 0, 0].numpy()
    distance = math.dist((-1000, 0, 25), (-40, 30, 1.5))
    power = 10 ** (-(36.7 * math.log10(distance) + 26 * math.log10(5) + 22.7) / 10)
    assert stats.kstest(np.abs(h) ** 2 / power, "expon").pvalue > 1e-3
    assert stats.kstest((np.angle(h) + math.pi) / (2 * math.pi), "uniform").pvalue > 1e-3


def test_antennas_and_users_fade_independently(many):
    flat = many.direct.flatten(1).numpy()
    correlation = np.corrcoef(flat.T)
    assert np.abs(correlation - np.eye(len(correlation))).max() < 0.04


@pytest.mark.parametrize("link", ["bs_ris", "ris_user"])
def test_rician_links_have_the_k_factor(many, link):
    h = getattr(many, link)[:, 0, 0].numpy()
    mean_power = (np.abs(h) ** 2).mean()
    kappa = np.abs(h.mean()) ** 2 / (mean_power - np.abs(h.mean()) ** 2)
    assert kappa == pytest.approx(5.0, rel=0.05)
    kurtosis = (np.abs(h) ** 4).mean() / mean_power**2
    assert kurtosis == pytest.approx((2 + 4 * 5 + 5**2) / (1 + 5) ** 2, rel=0.03)


def test_line_of_sight_comes_as_often_as_its_probability():
    scenario = preset("physical_small", kappa=1e6)
    position = (0.0, 0.0, 60.0)
    users = [(-30.0, 0.0, 1.5), (60.0, 0.0, 1.5), (0.0, 120.0, 1.5), (400.0, 0.0, 1.5)]
    channels = draw(scenario, position, 0.0, users, batch=(8000,))
    for j, user in enumerate(users):
        elevation = math.degrees(math.atan2(60.0 - 1.5, math.hypot(user[0], user[1])))
        expected = 1 / (1 + 9.61 * math.exp(-0.16 * (elevation - 9.61)))
        loss_db = 20 * math.log10(5) + 28 + 22 * math.log10(math.dist(position, user))
        power = channels.ris_user[:, j].abs().square().mean(-1) / 10 ** (-loss_db / 10)
        clear = (power > 0.5).double().mean().item()
        assert clear == pytest.approx(expected, abs=0.02)
        blocked = power[power <= 0.5]
        if len(blocked) > 500:
            assert blocked.mean().item() == pytest.approx(0.01, rel=0.1)  # Rayleigh at LoS + 20 dB


def test_line_of_sight_probability_at_the_zenith():
    assert line_of_sight_probability(vector(1.0)).item() == pytest.approx(1.0, abs=1e-4)


def test_literal_links_are_rayleigh_at_the_vehicles_height():
    scenario = preset("paper_literal")
    position, user = (10.0, -20.0, 70.0), (-40.0, 30.0, 1.5)
    channels = draw(scenario, position, batch=(20_000,))

    def power(start):
        db = 36.7 * math.log10(math.dist(start, user)) - 0.3 * (70 - 1.5) + 26 * math.log10(5) + 22.7
        return 10 ** (-db / 10)

    los_power = 10 ** (-(20 * math.log10(5) + 28 + 22 * math.log10(math.dist(position, user))) / 10)
    h_s, h_b = channels.ris_user[:, 0, 0].numpy(), channels.direct[:, 0, 0].numpy()
    assert stats.kstest(np.abs(h_s) ** 2 / min(power(position), los_power), "expon").pvalue > 1e-3
    assert stats.kstest(np.abs(h_b) ** 2 / power((-1000.0, 0.0, 25.0)), "expon").pvalue > 1e-3


def test_gains_act_where_the_scenario_says():
    plain = draw(preset("physical_small", direct_extra_db=0.0, ris_gain_db=0.0), seed=3)
    gained = draw(preset("physical_small", direct_extra_db=10.0, ris_gain_db=6.0, bs_gain_db=4.0), seed=3)
    assert torch.allclose(gained.direct, plain.direct * 10 ** ((4 - 10) / 20))
    assert torch.allclose(gained.bs_ris, plain.bs_ris * 10 ** ((6 + 4) / 20))
    assert torch.equal(gained.ris_user, plain.ris_user)
    assert not draw(preset("physical_small", direct="blocked")).direct.any()


def test_users_across_the_panel_from_the_base_station_are_served_by_transmission():
    scenario = preset("physical_small")
    west, east = (-50.0, 0.0, 1.5), (50.0, 0.0, 1.5)
    users = [west, east, (0.0, 80.0, 1.5), (0.0, -80.0, 1.5)]

    def sides(position, yaw):
        return draw(scenario, position, yaw, users).transmission.tolist()

    assert sides((0.0, 0.0, 60.0), 0.0) == [False, True, False, False]  # those on the plane: reflection
    assert sides((0.0, 0.0, 60.0), math.pi - 1e-3)[:2] == [False, True]  # the panel turned round
    assert sides((60.0, 0.0, 60.0), 0.0) == [False, False, False, False]  # it has passed them all
    assert sides((-60.0, 0.0, 60.0), 0.0) == [True, True, True, True]


def test_fixed_regions_do_not_move_with_the_vehicle():
    scenario = preset("physical_small", region="fixed", reflection_users=1)
    assert draw(scenario, (60.0, 0.0, 60.0)).transmission.tolist() == [False, True, True, True]


def test_same_seed_same_channels_and_another_seed_others():
    scenario = preset("physical_small")
    first, again, other = (draw(scenario, batch=(3,), seed=seed) for seed in (1, 1, 2))
    for link in ("direct", "bs_ris", "ris_user"):
        assert torch.equal(getattr(first, link), getattr(again, link))
        assert (getattr(first, link) != getattr(other, link)).all()


def test_a_row_does_not_depend_on_where_other_rows_are():
    scenario = preset("physical_small")
    positions = torch.tensor([[0.0, 0, 60], [10, 5, 70], [-30, 2, 50]], dtype=F64)
    users = torch.tensor([(-40.0, 30.0, 1.5)] * 4, dtype=F64).expand(3, 4, 3)
    yaw = torch.zeros(3, dtype=F64)
    before = draw_channels(scenario, positions, yaw, users, generator(0))
    moved = positions.clone()
    moved[0] = torch.tensor([90.0, 90, 110])
    after = draw_channels(scenario, moved, yaw, users, generator(0))
    for link in ("direct", "bs_ris", "ris_user", "transmission"):
        assert torch.equal(getattr(before, link)[1:], getattr(after, link)[1:])
    assert not torch.equal(before.bs_ris[0], after.bs_ris[0])


def test_vehicle_on_top_of_user_or_base_station_stays_finite():
    scenario = preset("physical_small")
    on_user = draw(scenario, (50.0, 10.0, 1.5))
    on_base = draw(scenario, scenario.base_station_enu)
    for channels in (on_user, on_base):
        for link in (channels.direct, channels.bs_ris, channels.ris_user):
            assert torch.isfinite(torch.view_as_real(link)).all()


@pytest.mark.parametrize("name", ["paper_literal", "physical_1km", "physical_small", "prototype_s4"])
def test_reference_gains_bring_every_link_near_one(name):
    from rf_model.mobility import initial_users

    scenario = preset(name)
    users = initial_users(scenario, (2000,), generator(1), F64)
    start = vector(*scenario.start_enu).expand(2000, 3)
    channels = draw_channels(scenario, start, torch.zeros(2000, dtype=F64), users.position_enu, generator(2))
    reference = reference_gains(scenario)
    for link in ("direct", "bs_ris", "ris_user"):
        scaled = getattr(channels, link).abs().square().mean() / getattr(reference, link) ** 2
        assert scaled.item() == pytest.approx(1.0, rel=0.05)


def test_reference_gain_of_a_blocked_link_divides_by_something():
    blocked = reference_gains(preset("physical_small", direct="blocked"))
    assert blocked == reference_gains(preset("physical_small"))


def test_position_gradient_agrees_with_finite_differences():
    scenario = preset("physical_small", ris_user="los")
    users = torch.tensor([(-40.0, 30.0, 1.5)] * 4, dtype=F64)

    def total(position):
        channels = draw_channels(scenario, position, vector(0.2)[0], users, generator(0))
        # Sums of squares of the link to each element; scaled to be of order one.
        return channels.ris_user.abs().square().sum() * 1e8 + channels.bs_ris.abs().square().sum() * 1e6

    assert torch.autograd.gradcheck(total, vector(10.0, 5.0, 60.0).requires_grad_(), atol=1e-6, rtol=1e-4)


def test_base_station_link_of_tr_36777_is_blocked_as_often_as_its_probability():
    scenario = preset("physical_small", path_loss={"bs_ris": "tr36777_umi_av"}, extrapolate=True, kappa=1e6)
    position = (-600.0, 0.0, 40.0)  # 400 m from the base station
    channels = draw(scenario, position, batch=(4000,))
    distance, height = vector(math.dist(position, scenario.base_station_enu)), vector(40.0)
    model = path_loss.AERIAL["tr36777_umi_av"]
    expected = model.los_probability(vector(400.0), height).item()
    assert 0.2 < expected < 0.8
    power = channels.bs_ris.abs().square().mean((-2, -1)) * 10 ** (-scenario.ris_gain_db / 10)
    los, nlos = (10 ** (-loss(5e9, distance, height).item() / 10) for loss in (model.los_db, model.nlos_db))
    clear = power > math.sqrt(los * nlos)
    assert clear.double().mean().item() == pytest.approx(expected, abs=0.03)
    assert power[clear].mean().item() == pytest.approx(los, rel=0.01)
    assert power[~clear].mean().item() == pytest.approx(nlos, rel=0.05)


def test_set_3gpp_is_three_models():
    scenario = preset("physical_small", path_loss="3gpp", ris_gain_db=0.0, direct_extra_db=0.0)
    position, user = vector(0.0, 0.0, 60.0), vector(30.0, 40.0, 1.5)
    gains = link_gains(scenario, position, user.unsqueeze(0))
    base = vector(*scenario.base_station_enu)
    loss_db = {
        "direct": path_loss.tr38901_uma_nlos_db(5e9, (user - base)[:2].norm(), 25.0, 1.5),
        "bs_ris": path_loss.tr36777_uma_av_los_db(5e9, (position - base).norm(), vector(60.0)),
        "bs_ris_blocked": path_loss.tr36777_uma_av_nlos_db(5e9, (position - base).norm(), vector(60.0)),
        "ris_user": path_loss.free_space_db(5e9, (position - user).norm()) + 1.0,
        "ris_user_blocked": path_loss.free_space_db(5e9, (position - user).norm()) + 20.0,
    }
    for link, expected in loss_db.items():
        assert -20 * math.log10(getattr(gains, link).item()) == pytest.approx(expected.item()), link
    assert gains.bs_ris_sight.item() == pytest.approx(
        path_loss.tr36777_uma_av_los_probability(vector(1000.0), vector(60.0)).item()
    )
    elevation = (58.5 / (position - user).norm()).unsqueeze(0)
    assert gains.ris_user_sight.item() == line_of_sight_probability(elevation).item()


def test_element_loss_takes_from_the_cascade_once():
    plain, lossy = (draw(preset("physical_small", element_loss_db=loss), seed=3) for loss in (0.0, 3.0))
    torch.testing.assert_close(lossy.bs_ris, plain.bs_ris * 10 ** (-3 / 20))
    assert torch.equal(lossy.ris_user, plain.ris_user)


def rotation(axis: int, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix = np.eye(3)
    matrix[i, i], matrix[i, j], matrix[j, i], matrix[j, j] = c, -s, s, c
    return matrix


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw"), [(0.0, 0.0, 0.4), (0.3, 0.0, 0.0), (0.0, 0.5, -2.0), (-0.2, 0.4, 1.0)]
)
def test_panel_frame_is_the_bodys_rotation(roll, pitch, yaw):
    """Yaw, then pitch, then roll about the carried axes: forward, left, up; nose up turns against the left axis."""
    body = rotation(2, yaw) @ rotation(1, -pitch) @ rotation(0, roll)
    frame = panel_frame(*(torch.tensor(angle, dtype=F64) for angle in (yaw, roll, pitch)))
    np.testing.assert_allclose(frame.numpy(), body.T, atol=1e-12)


def test_panel_tilts_as_mavlink_says():
    zero, angle = torch.tensor(0.0), torch.tensor(0.1)
    nose_up, right_down = panel_frame(zero, zero, angle), panel_frame(zero, angle, zero)
    assert nose_up[0, 2] > 0.09  # the normal points forward and up
    assert right_down[1, 2] > 0.09  # the columns, which advance to the left, rise


def test_tilt_turns_the_array_response_and_the_sides():
    scenario = los_only()
    position, user = vector(0.0, 0.0, 60.0), vector(40.0, 0.0, 1.5)
    fading = draw_fading(scenario, (), generator(0), F64)
    angles = [torch.tensor(a, dtype=F64) for a in (0.0, 0.2, -0.4)]
    frame = panel_frame(*angles)
    channels = faded_channels(scenario, position, frame, user.expand(4, 3), fading)
    towards = ((user - position) / (user - position).norm()).numpy()
    spacing = scenario.group / scenario.mu  # wavelengths
    _, along_columns, along_rows = frame.numpy()
    h = channels.ris_user[0].numpy()
    for n in range(scenario.elements):
        row, column = divmod(n, scenario.columns)
        nearer = spacing * (column * along_columns + row * along_rows) @ towards
        assert abs(h[n] / h[0] - cmath.exp(2j * math.pi * nearer)) < 1e-2
    # Nose down by more than the user's elevation: the user comes in front of the panel, the base station stays behind.
    level = faded_channels(scenario, position, panel_frame(angles[0]), user.expand(4, 3), fading)
    behind = vector(-20.0, 0.0, 1.5)
    assert level.transmission[0]
    nose_down = panel_frame(angles[0], angles[0], torch.tensor(-0.9, dtype=F64))
    turned = faded_channels(scenario, position, nose_down, behind.expand(4, 3), fading)
    assert turned.transmission[0]
    assert not faded_channels(scenario, position, panel_frame(angles[0]), behind.expand(4, 3), fading).transmission[0]


def test_position_that_is_no_number_spoils_its_own_row_only():
    scenario = preset("physical_small")
    users = torch.tensor([(-40.0, 30.0, 1.5)] * 4, dtype=F64).expand(2, 4, 3)
    position = torch.tensor([[0.0, 0, 60], [math.nan, 0, 60]], dtype=F64)
    channels = draw_channels(scenario, position, torch.zeros(2, dtype=F64), users, generator(0))
    whole = torch.view_as_real(channels.ris_user)
    assert torch.isfinite(whole[0]).all()
    assert torch.isnan(whole[1]).any()


@pytest.mark.parametrize(
    "fields",
    [
        {"users": 6, "antennas": 2},
        {"rows": 2, "columns": 5},
        {"reflection_users": 0},
        {"reflection_users": 4},
        {"users": 1},
        {"antennas": 1},
    ],
    ids=["M < J", "not square", "P = 0", "Q = 0", "J = 1", "M = 1"],
)
def test_odd_sizes_give_finite_rates(fields):
    from rf_model.link import identity_beamforming
    from rf_model.mobility import initial_users
    from rf_model.surfaces import surface_of
    from rf_model.world import slot_rates

    scenario = preset("physical_small", **fields)
    users = initial_users(scenario, (3,), generator(1), F64)
    start = vector(*scenario.start_enu).expand(3, 3)
    channels = draw_channels(scenario, start, torch.zeros(3, dtype=F64), users.position_enu, generator(2))
    assert channels.transmission.sum(-1).tolist() == [scenario.users - scenario.reflection_count] * 3
    beams = identity_beamforming(scenario, torch.complex128)
    rates = slot_rates(scenario, channels, surface_of(scenario).neutral(F64), beams)
    assert torch.isfinite(rates.rate_bps).all()
    assert (rates.rate_bps > 0).all()
    for index in (rates.hfi, rates.jfi):
        assert ((index >= 0) & (index <= 1 + 1e-9)).all()
