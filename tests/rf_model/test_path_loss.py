"""Path loss against TR 38.901's tabulated points, the paper's equations by hand, and Sionna."""

import math

import pytest
import torch

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
