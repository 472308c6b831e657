"""Each surface: whatever numbers it is told, it can have what comes out; what it cannot have is refused by name."""

import math

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from rf_model.channels import Channels
from rf_model.link import effective_channel
from rf_model.scenario import ScenarioError, preset
from rf_model.star_ris import IndependentTrc, Trc, TrcError
from rf_model.surfaces import read_coefficients, surface_of

KINDS = ("coupled", "independent", "dual", "conventional")
N = 7


def scenario_of(kind: str, bits: int | None = None):
    return preset("physical_small", surface=kind, phase_bits=bits, rows=1, columns=N)


def told(kind: str, dtype) -> st.SearchStrategy[np.ndarray]:
    """Any finite numbers for N elements."""
    surface = surface_of(scenario_of(kind))
    numbers = st.one_of(
        st.floats(-1.5, 1.5, width=32),
        st.sampled_from([-1.0, 0.0, 1.0]),
        st.floats(allow_nan=False, allow_infinity=False, width=32),
    )
    return hnp.arrays(dtype, (surface.continuous + surface.signs) * N, elements=numbers)


def decoded(kind: str, bits: int | None, numbers: np.ndarray):
    surface = surface_of(scenario_of(kind, bits))
    raw = torch.from_numpy(numbers)
    return surface.decode(raw[: surface.continuous * N], raw[surface.continuous * N :])


@pytest.mark.parametrize("bits", [None, 1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_whatever_it_is_told_is_feasible(kind, bits, data):
    dtype = data.draw(st.sampled_from([np.float32, np.float64]))
    trc = decoded(kind, bits, data.draw(told(kind, dtype)))
    surface_of(scenario_of(kind, bits)).check(trc)
    # Judged from the coefficients alone, in double precision, as a message carries the angles.
    theta_r, theta_t, split = (
        np.array(field.tolist()) for field in (trc.theta_reflection, trc.theta_transmission, trc.split_angle)
    )
    reflection, transmission = np.sin(split) * np.exp(1j * theta_r), np.cos(split) * np.exp(1j * theta_t)
    assert (np.abs(theta_r) <= math.pi).all()
    assert ((split >= 0) & (split <= math.pi / 2)).all()
    np.testing.assert_allclose(np.abs(reflection) ** 2 + np.abs(transmission) ** 2, 1, atol=1e-12)
    if kind == "coupled":
        np.testing.assert_allclose((reflection.conj() * transmission).real, 0, atol=1e-6)
    if kind == "conventional":
        assert np.abs(transmission).max() < 1e-6
    if kind == "dual":
        assert np.abs(transmission[::2]).max() < 1e-6
        assert np.abs(reflection[1::2]).max() == 0
    if bits is not None:
        phases = np.concatenate([theta_r, theta_t] if kind == "independent" else [theta_r])
        steps = phases / (2 * math.pi / 2**bits)
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    for said, of_coefficients in zip((reflection, transmission), trc.coefficients(), strict=True):
        np.testing.assert_allclose(of_coefficients.numpy(), said, atol=1e-6)


@pytest.mark.parametrize("bits", [1, 2, 3])
def test_quantised_phases_are_all_there_equally_often_and_the_nearest(bits):
    numbers = torch.linspace(-1, 1, 80_001, dtype=torch.float64)[:-1]
    scenario = preset("physical_small", surface="conventional", phase_bits=bits, rows=1, columns=1)
    theta = surface_of(scenario).decode(numbers.unsqueeze(-1), numbers[:0]).theta_reflection.squeeze(-1)
    values, counts = theta.unique(return_counts=True)
    assert len(values) == 2**bits
    torch.testing.assert_close(counts.double(), torch.full((2**bits,), 80_000 / 2**bits).double(), rtol=2e-4, atol=2)
    off = torch.remainder(theta - numbers * math.pi + math.pi, 2 * math.pi) - math.pi
    assert off.abs().max() <= math.pi / 2**bits + 1e-9


def test_gradient_passes_a_quantised_phase():
    raw = torch.full((2 * N,), 0.3, dtype=torch.float64, requires_grad=True)
    trc = surface_of(scenario_of("coupled", 2)).decode(raw, torch.ones(N))
    trc.theta_reflection.sum().backward()
    assert raw.grad[:N].tolist() == pytest.approx([math.pi] * N)
    surface_of(scenario_of("coupled", 2)).check(trc)


@pytest.mark.parametrize("kind", KINDS)
def test_batches_decode_as_their_rows(kind):
    surface = surface_of(scenario_of(kind, 2))
    raw = torch.rand(3, (surface.continuous + surface.signs) * N, generator=torch.Generator().manual_seed(0)) * 2 - 1
    cut = surface.continuous * N
    whole = surface.decode(raw[:, :cut], raw[:, cut:])
    for row in range(3):
        one = surface.decode(raw[row, :cut], raw[row, cut:])
        for both, alone in zip(whole.coefficients(), one.coefficients(), strict=True):
            assert torch.equal(both[row], alone)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bits", [None, 1])
def test_neutral_is_feasible(kind, bits):
    surface = surface_of(scenario_of(kind, bits))
    neutral = surface.neutral(torch.float64)
    surface.check(neutral)
    assert neutral.theta_reflection.tolist() == [0.0] * N


def test_independent_phases_include_the_coupled_ones():
    coupled = surface_of(scenario_of("coupled")).decode(
        torch.rand(2 * N).double() * 2 - 1, torch.tensor([1.0, -1] * N)[:N]
    )
    free = IndependentTrc(coupled.theta_reflection, coupled.split_angle, coupled.theta_transmission)
    surface_of(scenario_of("independent")).check(free)
    for ours, theirs in zip(free.coefficients(), coupled.coefficients(), strict=True):
        torch.testing.assert_close(ours, theirs)


def test_conventional_leaves_users_behind_it_to_the_direct_link():
    generator = torch.Generator().manual_seed(0)

    def drawn(*shape):
        return torch.randn(shape, dtype=torch.complex128, generator=generator)

    channels = Channels(drawn(2, 3), drawn(N, 3), drawn(2, N), torch.tensor([False, True]))
    scenario = scenario_of("conventional")
    g = effective_channel(channels, surface_of(scenario).neutral(torch.float64))
    torch.testing.assert_close(g[1], channels.direct[1], atol=1e-12, rtol=0)
    torch.testing.assert_close(g[0], channels.direct[0] + channels.ris_user[0] @ channels.bs_ris)


def message(kind: str, **changes) -> dict[str, torch.Tensor]:
    neutral = surface_of(scenario_of(kind)).neutral(torch.float64)
    fields = {name: getattr(neutral, name) for name in ("theta_reflection", "split_angle", "sign")}
    fields["theta_transmission"] = neutral.theta_transmission if kind == "independent" else torch.zeros(0)
    return fields | {name: torch.tensor(value, dtype=torch.float64) for name, value in changes.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_messages_read_back(kind):
    read = read_coefficients(scenario_of(kind), **message(kind))
    assert isinstance(read, IndependentTrc if kind == "independent" else Trc)


@pytest.mark.parametrize(
    ("kind", "bits", "changes", "words"),
    [
        ("coupled", 2, {"theta_reflection": [0.3] * N}, r"theta_reflection: 0.3 is not one of the 4 phases of 2 bits"),
        ("coupled", None, {"theta_transmission": [0.0] * N}, "theta_transmission: must be empty, surface coupled"),
        ("independent", None, {"theta_transmission": []}, r"theta_transmission: shape \[0\], the surface has 7"),
        ("independent", None, {"theta_transmission": [4.0] * N}, r"theta_transmission: 4 is outside \[-pi, pi\]"),
        ("independent", 1, {"theta_transmission": [1.0] * N}, "theta_transmission: 1 is not one of the 2 phases"),
        ("dual", None, {"split_angle": [math.pi / 2] * N}, "split_angle: 1.5708 of element 1, which has 0 fixed"),
        ("conventional", None, {"split_angle": [0.5] * N}, "split_angle: 0.5 of element 0, which has 1.5708 fixed"),
        ("conventional", None, {"sign": [-1.0] * N}, "sign: must be 1"),
        ("dual", None, {"theta_reflection": [math.nan] * N}, "theta_reflection: not finite"),
    ],
)
def test_what_a_surface_cannot_have_is_refused_by_name(kind, bits, changes, words):
    with pytest.raises(TrcError, match=words):
        read_coefficients(scenario_of(kind, bits), **message(kind, **changes))


def test_surface_of_one_element_cannot_be_dual():
    with pytest.raises(ScenarioError, match="surface: dual needs at least 2 elements"):
        preset("physical_small", surface="dual", rows=1, columns=1)
