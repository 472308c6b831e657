"""Path loss against TR 38.901's tabulated points, Sionna, the paper's equations by hand, and TR 36.777's limits."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from rf_model import path_loss as pl

DISTANCES = torch.tensor([20.0, 100.0, 1000.0], dtype=torch.float64)
MODELS = {
    ("umi", True): pl.tr38901_umi_los_db,
    ("umi", False): pl.tr38901_umi_nlos_db,
    ("uma", True): pl.tr38901_uma_los_db,
    ("uma", False): pl.tr38901_uma_nlos_db,
}
BASE_HEIGHT = {"umi": 10.0, "uma": 25.0}


@pytest.mark.parametrize(
    ("street", "los", "losses"),
    [
        ("umi", True, [71.3602, 85.3142, 119.1474]),
        ("umi", False, [81.1878, 104.6438, 139.8892]),
        ("uma", True, [71.6476, 83.1382, 109.4065]),
        ("uma", False, [82.6262, 103.0375, 141.666]),
    ],
)
def test_tr38901_at_published_points(street, los, losses):
    computed = MODELS[street, los](3.5e9, DISTANCES, BASE_HEIGHT[street], 1.5)
    assert computed.tolist() == pytest.approx(losses, abs=5e-5)


@pytest.mark.parametrize(("street", "los"), MODELS)
def test_tr38901_agrees_with_sionna_on_both_sides_of_the_breakpoint(street, los):
    from sionna.phy.channel import tr38901 as sionna  # some seconds

    distance = torch.logspace(1, 3.6, 40, dtype=torch.float64)
    carrier, user_height = 6e9, 2.0
    antenna = sionna.PanelArray(
        num_rows_per_panel=1,
        num_cols_per_panel=1,
        polarization="single",
        polarization_type="V",
        antenna_pattern="omni",
        carrier_frequency=carrier,
    )
    model = {"umi": sionna.UMiScenario, "uma": sionna.UMaScenario}[street](
        carrier_frequency=carrier,
        o2i_model="low",
        ut_array=antenna,
        bs_array=antenna,
        direction="downlink",
        precision="double",
    )
    zeros = torch.zeros_like(distance)
    users = torch.stack((distance, zeros, zeros + user_height), -1)[None]
    base = torch.tensor([[[0.0, 0.0, BASE_HEIGHT[street]]]], dtype=torch.float64)
    nothing = torch.zeros_like(users)
    outdoors = torch.zeros(1, len(distance), dtype=torch.bool)
    model.set_topology(users, base, nothing, torch.zeros_like(base), nothing, outdoors, los=los)
    expected = model.basic_pathloss.flatten().tolist()
    assert MODELS[street, los](carrier, distance, BASE_HEIGHT[street], user_height).tolist() == pytest.approx(expected)


def test_paper_line_of_sight_by_hand():
    assert pl.paper_los_db(5e9, torch.tensor(100.0)).item() == pytest.approx(20 * math.log10(5) + 28 + 44, abs=1e-4)


def test_paper_without_line_of_sight_by_hand_and_never_less_than_with():
    loss = pl.paper_nlos_db(5e9, torch.tensor([1.0, 100.0]), 60.0)
    by_hand = 36.7 * 2 - 0.3 * (60 - 1.5) + 26 * math.log10(5) + 22.7
    assert loss[1].item() == pytest.approx(by_hand, abs=1e-4)
    assert loss[0].item() == pytest.approx(20 * math.log10(5) + 28, abs=1e-4)


def test_free_space_at_a_kilometre():
    assert pl.free_space_db(2.4e9, torch.tensor(1000.0)).item() == pytest.approx(100.05, abs=0.01)


def test_amplitude_of_20_db_is_a_tenth():
    assert pl.amplitude(torch.tensor(20.0)).item() == pytest.approx(0.1)


HEIGHTS = st.floats(22.6, 300.0)
AERIAL_D1 = {  # TR 36.777 table B-1
    "tr36777_uma_av": lambda h: max(460 * math.log10(h) - 700, 18),
    "tr36777_umi_av": lambda h: max(294.05 * math.log10(h) - 432.94, 18),
}


def f64(*values: float) -> torch.Tensor:
    return torch.tensor(values, dtype=torch.float64)


@pytest.mark.parametrize("name", pl.AERIAL)
@given(height=HEIGHTS)
def test_aerial_line_of_sight_is_certain_within_d1_and_continuous_there(name, height):
    d1, probability = AERIAL_D1[name](height), pl.AERIAL[name].los_probability
    near = probability(f64(1.0, d1 / 2, d1), f64(height))
    assert near.tolist() == pytest.approx([1.0, 1.0, 1.0], abs=1e-12)
    assert probability(f64(d1 * (1 + 1e-9)), f64(height)).item() == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("name", pl.AERIAL)
@given(height=HEIGHTS)
def test_aerial_line_of_sight_only_falls_with_distance_and_is_a_probability(name, height):
    probability = pl.AERIAL[name].los_probability(torch.logspace(0, 4, 400, dtype=torch.float64), f64(height))
    assert ((probability > 0) & (probability <= 1)).all()
    assert (probability.diff() <= 1e-12).all()


def test_aerial_line_of_sight_by_hand():
    """TR 36.777 table B-1 at 1 km: UMa-AV at 50 m, UMi-AV at 50 m; certain above 100 m in UMa-AV only."""
    for name, d1, p1 in (
        ("tr36777_uma_av", 460 * math.log10(50) - 700, 4300 * math.log10(50) - 3800),
        ("tr36777_umi_av", 294.05 * math.log10(50) - 432.94, 233.98 * math.log10(50) - 0.95),
    ):
        by_hand = d1 / 1000 + math.exp(-1000 / p1) * (1 - d1 / 1000)
        assert pl.AERIAL[name].los_probability(f64(1000.0), f64(50.0)).item() == pytest.approx(by_hand)
    assert pl.tr36777_uma_av_los_probability(f64(4000.0), f64(101.0)).item() == 1.0
    assert pl.tr36777_umi_av_los_probability(f64(4000.0), f64(101.0)).item() < 1.0


def test_aerial_path_loss_by_hand():
    """TR 36.777 table B-2 at 2 GHz, 1 km and 50 m."""
    distance, height = f64(1000.0), f64(50.0)
    log_h, carrier_db = math.log10(50), 20 * math.log10(2)
    uma_los, umi_los = 28 + 66 + carrier_db, 30.9 + (22.25 - 0.5 * log_h) * 3 + carrier_db
    by_hand = {
        "tr36777_uma_av": (uma_los, -17.5 + (46 - 7 * log_h) * 3 + 20 * math.log10(40 * math.pi * 2 / 3)),
        "tr36777_umi_av": (umi_los, 32.4 + (43.2 - 7.6 * log_h) * 3 + carrier_db),
    }
    for name, (los, nlos) in by_hand.items():
        assert pl.AERIAL[name].los_db(2e9, distance, height).item() == pytest.approx(los)
        assert pl.AERIAL[name].nlos_db(2e9, distance, height).item() == pytest.approx(nlos)


@pytest.mark.parametrize("name", pl.AERIAL)
@given(height=HEIGHTS)
def test_aerial_losses_rise_with_distance_and_blocked_never_loses_less(name, height):
    distance = torch.logspace(0, 3.6, 200, dtype=torch.float64)
    model = pl.AERIAL[name]
    los, nlos = (loss(3.5e9, distance, f64(height)) for loss in (model.los_db, model.nlos_db))
    assert (los.diff() > 0).all()
    assert (nlos.diff() > 0).all()
    assert (nlos >= los).all()
    if name == "tr36777_umi_av":
        assert (los >= pl.free_space_db(3.5e9, distance) - 1e-9).all()


@pytest.mark.parametrize("name", pl.AERIAL)
def test_aerial_models_stay_finite_far_outside_their_heights(name):
    heights = f64(-5.0, 0.0, 1.0, 10.0, 1000.0)
    for value in (
        pl.AERIAL[name].los_db(5e9, f64(500.0), heights),
        pl.AERIAL[name].nlos_db(5e9, f64(500.0), heights),
        pl.AERIAL[name].los_probability(f64(500.0), heights),
    ):
        assert torch.isfinite(value).all()
