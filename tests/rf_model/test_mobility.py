"""Users start in their sectors, walk at their speed and stay where they should."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rf_model.mobility import in_sector, initial_users, move_users
from rf_model.scenario import preset

F64 = torch.float64


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_users_start_evenly_over_half_discs_reflection_side_first():
    scenario = preset("physical_small")
    position = initial_users(scenario, (5000,), generator(1), F64).position_enu
    radius = position[..., :2].norm(dim=-1)
    assert ((radius >= 20) & (radius <= 100)).all()
    assert (position[:, :2, 0] < 0).all()  # the base station is in the west
    assert (position[:, 2:, 0] > 0).all()
    assert (position[..., 2] == 1.5).all()
    share = (radius[:, 0] ** 2 - 20**2) / (100**2 - 20**2)
    assert stats.kstest(share.numpy(), "uniform").pvalue > 1e-3


def test_reflection_side_follows_panel_and_base_station():
    scenario = preset("physical_small", panel_heading_rad=math.pi / 2, base_station_enu=(0, 900, 25))
    position = initial_users(scenario, (500,), generator(1), F64).position_enu
    assert (position[:, :2, 1] > 0).all()
    assert (position[:, 2:, 1] < 0).all()


def test_prototype_users_walk_one_way_about_their_own_centre():
    scenario = preset("prototype_s4")
    users = initial_users(scenario, (200,), generator(1), F64)
    assert (users.heading_rad == users.heading_rad[:, :1]).all()
    offset = users.position_enu[..., :2] - torch.tensor([0.0, 50.0], dtype=F64)
    angle = torch.atan2(offset[..., 1], offset[..., 0].abs())
    assert angle.abs().max() <= 0.45 * math.pi


@given(
    seed=st.integers(0, 2**31),
    mobility=st.sampled_from(["random", "directional"]),
    heading=st.floats(-math.pi, math.pi),
    half_angle=st.floats(0.3, math.pi / 2),
)
@settings(max_examples=40, deadline=None)
def test_users_stay_in_their_sectors(seed, mobility, heading, half_angle):
    scenario = preset(
        "physical_small",
        mobility=mobility,
        panel_heading_rad=heading,
        user_half_angle_rad=half_angle,
        user_speed_mps=6.0,
    )
    drawn = generator(seed)
    users = initial_users(scenario, (3,), drawn, F64)
    assert in_sector(scenario, users.position_enu).all()
    for _ in range(40):
        before, users = users, move_users(scenario, users, drawn)
        assert in_sector(scenario, users.position_enu).all()
        step = (users.position_enu - before.position_enu).norm(dim=-1)
        assert torch.isclose(step, torch.tensor(6.0, dtype=F64)).logical_or(step == 0).all()


@pytest.mark.parametrize(("mobility", "noise"), [("random", 0.5), ("directional", 0.05)])
def test_unbounded_users_walk_straight_but_for_their_noise(mobility, noise):
    scenario = preset("physical_small", mobility=mobility, user_bounds="none")
    users = initial_users(scenario, (4000,), generator(2), F64)
    moved = move_users(scenario, users, generator(3))
    turn = (moved.heading_rad - users.heading_rad).flatten().numpy()
    assert stats.kstest(turn / noise, "norm").pvalue > 1e-3
    step = moved.position_enu - users.position_enu
    assert torch.allclose(step.norm(dim=-1), torch.tensor(1.5, dtype=F64))
    assert torch.allclose(torch.atan2(step[..., 1], step[..., 0]).cos(), moved.heading_rad.cos(), atol=1e-9)


def test_turned_back_users_walk_on():
    """Nobody stays stuck at a boundary."""
    scenario = preset("physical_small", mobility="directional")
    drawn = generator(4)
    users = initial_users(scenario, (50,), drawn, F64)
    stays = torch.zeros(50, 4)
    for _ in range(300):
        before, users = users, move_users(scenario, users, drawn)
        stays += (users.position_enu == before.position_enu).all(-1)
    assert stays.max() < 150
