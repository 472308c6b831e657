"""Whatever finite numbers the actors give, what is done is feasible; and the mapping is the documented one."""

import math

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.decoding import RawActionError, action_size, continuous_size, decode, encode
from rf_model.scenario import PRESETS, Scenario, preset

SMALL = preset("physical_small")
SCENARIOS = {
    "cartesian": SMALL,
    "spherical": preset("physical_small", motion="spherical"),
    "no climb limits": preset("prototype_s4", motion="spherical"),
    "per user": preset("paper_literal", users=6, antennas=2),
    "odd sizes": preset("physical_small", rows=1, columns=3, users=1, antennas=5, slot_s=0.3, v_max_mps=7.3),
}


def wild(size: int, dtype: np.dtype) -> st.SearchStrategy[np.ndarray]:
    """Any finite floats, denormals and the largest included."""
    width = 32 if dtype == np.float32 else 64
    numbers = st.one_of(
        st.floats(allow_nan=False, allow_infinity=False, width=width),
        st.floats(-1, 1, width=width),
        st.sampled_from([-1.0, 0.0, 1.0]),
    )
    return hnp.arrays(dtype, size, elements=numbers)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=SCENARIOS.keys())
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_every_finite_output_decodes_to_a_feasible_action(scenario: Scenario, dtype, data):
    raw = data.draw(wild(action_size(scenario), np.dtype(dtype)))
    action = decode(torch.from_numpy(raw), scenario)
    # Judged as the bus does: numbers read back in double precision.
    theta = np.array(action.theta_reflection.tolist())
    split = np.array(action.split_angle.tolist())
    sign = np.array(action.sign.tolist())
    power = np.abs(np.array(action.beamforming.tolist())) ** 2
    dx, dy, dz = action.displacement_enu.tolist()

    assert math.sqrt(dx * dx + dy * dy + dz * dz) <= scenario.v_max_mps * scenario.slot_s
    assert -(scenario.climb_down_mps or math.inf) * scenario.slot_s <= dz
    assert dz <= (scenario.climb_up_mps or math.inf) * scenario.slot_s
    assert (np.abs(theta) <= math.pi).all()
    assert ((split >= 0) & (split <= math.pi / 2)).all()
    assert set(sign) <= {-1.0, 1.0}
    np.testing.assert_allclose(np.cos(split) ** 2 + np.sin(split) ** 2, 1, rtol=1e-15)
    np.testing.assert_allclose(np.cos(theta - (theta + sign * math.pi / 2)), 0, atol=1e-15)
    if scenario.p_max == "total":
        assert power.sum() <= scenario.p_max_w
    else:
        assert (power.sum(axis=0) <= scenario.p_max_w).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("index", [0, 5, 82])
def test_what_is_not_finite_is_refused_by_its_place(bad, index):
    raw = torch.zeros(4, action_size(SMALL))
    raw[2, index] = bad
    with pytest.raises(RawActionError, match=f"number {index} is not finite"):
        decode(raw, SMALL)


def test_the_wrong_size_is_refused_with_both_sizes():
    with pytest.raises(RawActionError, match="82 numbers, the scenario takes 83"):
        decode(torch.zeros(82), SMALL)


def test_sizes_are_the_papers():
    assert continuous_size(PRESETS["paper_literal"]) == 67
    assert action_size(PRESETS["paper_literal"]) == 67 + 16


@pytest.mark.parametrize("name", ["physical_small", "paper_literal"])
@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0])
def test_beams_use_all_of_the_power(name, size):
    scenario = preset(name)
    raw = size * torch.rand(action_size(scenario), dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    power = decode(raw, scenario).beamforming.abs().square()
    used = power.sum() if scenario.p_max == "total" else power.sum(0)
    torch.testing.assert_close(used, torch.full_like(used, scenario.p_max_w), rtol=1e-12, atol=0)


def test_silence_is_silent():
    assert decode(torch.zeros(action_size(SMALL)), SMALL).beamforming.abs().max() == 0


def test_layout_by_hand():
    """Motion, theta_R, split, W as [M, J, re/im], signs."""
    raw = torch.linspace(-0.9, 0.9, 83, dtype=torch.float64)
    action = decode(raw, SMALL)
    values = raw.tolist()
    for n in range(16):
        assert action.theta_reflection[n].item() == pytest.approx(math.pi * values[3 + n])
        assert action.split_angle[n].item() == pytest.approx((values[19 + n] + 1) * math.pi / 4)
        assert action.sign[n].item() == (1 if values[67 + n] > 0 else -1)
    norm = math.sqrt(sum(x * x for x in values[35:67]))
    for m in range(4):
        for j in range(4):
            at = 35 + 2 * (4 * m + j)
            expected = complex(values[at], values[at + 1]) * math.sqrt(SMALL.p_max_w) / norm
            assert action.beamforming[m, j].item() == pytest.approx(expected)


def test_spherical_motion_is_distance_elevation_azimuth():
    scenario = preset("prototype_s4", motion="spherical")
    raw = torch.zeros(action_size(scenario), dtype=torch.float64)
    raw[:3] = torch.tensor([0.2, 1 / 3, -0.5])  # 6 m, 30 degrees up, 90 degrees from east
    expected = torch.tensor([0.0, 6 * math.cos(math.pi / 6), 3.0], dtype=torch.float64)
    torch.testing.assert_close(decode(raw, scenario).displacement_enu, expected)


def test_cartesian_motion_is_a_vector_clipped_in_its_norm():
    scenario = preset("prototype_s4", motion="cartesian")
    raw = torch.zeros(2, action_size(scenario), dtype=torch.float64)
    raw[0, :3] = torch.tensor([0.3, -0.4, 0.1])
    raw[1, :3] = torch.tensor([1.0, 1.0, -1.0])
    expected = torch.tensor([[3.0, -4.0, 1.0], [10 / 3**0.5, 10 / 3**0.5, -10 / 3**0.5]], dtype=torch.float64)
    torch.testing.assert_close(decode(raw, scenario).displacement_enu, expected)


def test_a_batch_decodes_as_its_rows_do():
    raw = torch.rand(2, 3, 83, generator=torch.Generator().manual_seed(0)) * 4 - 2
    batched = decode(raw, SMALL)
    for name in ("displacement_enu", "theta_reflection", "split_angle", "sign", "beamforming"):
        for i in range(2):
            for j in range(3):
                torch.testing.assert_close(getattr(batched, name)[i, j], getattr(decode(raw[i, j], SMALL), name))


def test_gradients_are_finite_also_at_rest_and_in_silence():
    raw = torch.zeros(action_size(SMALL), dtype=torch.float64, requires_grad=True)
    action = decode(raw, SMALL)
    total = action.displacement_enu.sum() + action.theta_reflection.sum() + action.split_angle.sum()
    (total + torch.view_as_real(action.beamforming).sum()).backward()
    assert torch.isfinite(raw.grad).all()


@pytest.mark.parametrize("bits", [None, 1, 3])
@pytest.mark.parametrize("surface", ["coupled", "independent", "dual", "conventional"])
@settings(max_examples=15, deadline=None)
@given(data=st.data())
def test_what_was_decoded_encodes_to_a_raw_action_that_decodes_to_it(surface, bits, data):
    scenario = preset(
        "physical_small",
        surface=surface,
        phase_bits=bits,
        motion=data.draw(st.sampled_from(["cartesian", "spherical"])),
        p_max=data.draw(st.sampled_from(["total", "per_user"])),
        climb_up_mps=data.draw(st.sampled_from([None, 3.0])),
    )
    numbers = st.one_of(st.floats(-1.5, 1.5, width=32), st.sampled_from([-1.0, 0.0, 1.0]))
    raw = torch.from_numpy(data.draw(hnp.arrays(np.float64, (2, action_size(scenario)), elements=numbers)))
    beams = slice(continuous_size(scenario) - 2 * scenario.antennas * scenario.users, continuous_size(scenario))
    raw[:, beams] = torch.where(raw[:, beams].abs() < 1e-3, 0.25, raw[:, beams])  # silence has no raw action of its own
    wanted = decode(raw, scenario)
    back = encode(wanted, scenario)
    assert back.abs().max() <= 1
    got = decode(back, scenario)
    torch.testing.assert_close(got.displacement_enu, wanted.displacement_enu, rtol=0, atol=1e-9)
    torch.testing.assert_close(got.beamforming, wanted.beamforming, rtol=0, atol=1e-9)
    for ours, theirs in zip(got.trc.coefficients(), wanted.trc.coefficients(), strict=True):
        torch.testing.assert_close(ours, theirs, rtol=0, atol=1e-9)
    assert torch.equal(got.sign, wanted.sign)


@given(st.tuples(*[st.floats(-1, 1)] * 3))
def test_a_move_that_is_too_far_is_shortened_in_its_own_direction(motion):
    scenario = preset("prototype_s4", motion="cartesian")
    raw = torch.zeros(action_size(scenario), dtype=torch.float64)
    raw[:3] = torch.tensor(motion, dtype=torch.float64)
    wanted = 10 * np.array(motion)
    length = np.linalg.norm(wanted)
    move = decode(raw, scenario).displacement_enu.numpy()
    np.testing.assert_allclose(move, wanted * min(1, 10 / max(length, 1e-300)), atol=1e-12)
