"""Coupled coefficients: every angle gives a passive, lossless, coupled surface; what is none is refused."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from rf_model.star_ris import Trc, TrcError, check_trc, neutral_trc

angles = st.floats(-math.pi, math.pi)
elements = st.tuples(angles, st.floats(0, math.pi / 2), st.sampled_from([-1.0, 1.0]))


def trc_of(rows, dtype=torch.float64) -> Trc:
    theta, split, sign = (torch.tensor(column, dtype=dtype) for column in zip(*rows, strict=True))
    return Trc(theta, split, sign)


@given(st.lists(elements, min_size=1, max_size=8))
@settings(deadline=None)
def test_every_element_is_lossless_and_coupled(rows):
    trc = trc_of(rows)
    reflection, transmission = trc.coefficients()
    energy = reflection.abs() ** 2 + transmission.abs() ** 2
    assert energy.tolist() == pytest.approx([1.0] * len(rows), abs=1e-12)
    # cos(theta_T - theta_R) = 0, also as an inner product of the coefficients themselves
    assert torch.cos(trc.theta_transmission - trc.theta_reflection).abs().max() < 1e-12
    assert (reflection.conj() * transmission).real.abs().max() < 1e-12


@given(st.lists(elements, min_size=1, max_size=8), st.sampled_from([torch.float32, torch.float64]))
@settings(deadline=None)
def test_transmission_phase_is_wrapped_and_is_that_of_the_coefficient(rows, dtype):
    trc = trc_of(rows, dtype)
    theta = trc.theta_transmission
    assert ((theta >= -math.pi - 1e-6) & (theta < math.pi)).all()
    phasor = torch.polar(trc.beta_transmission, theta)
    assert (phasor - trc.coefficients()[1]).abs().max() < 1e-6
    assert (torch.polar(trc.beta_reflection, trc.theta_reflection) - trc.coefficients()[0]).abs().max() < 1e-6


@given(st.lists(elements, min_size=1, max_size=8), st.sampled_from([torch.float32, torch.float64]))
@settings(deadline=None)
def test_feasible_coefficients_pass(rows, dtype):
    check_trc(trc_of(rows, dtype), len(rows))


def test_neutral_surface_splits_evenly():
    neutral = neutral_trc(5, torch.float64)
    check_trc(neutral, 5)
    assert neutral.beta_reflection.tolist() == pytest.approx([math.sqrt(0.5)] * 5)
    assert neutral.theta_transmission.tolist() == pytest.approx([math.pi / 2] * 5)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ((3.2, 0.5, 1.0), r"theta_reflection: 3.2 is outside \[-pi, pi\]"),
        ((0.0, -0.1, 1.0), r"split_angle: -0.1 is outside \[0, pi/2\]"),
        ((0.0, 1.6, 1.0), r"split_angle: 1.6 is outside"),
        ((0.0, 0.5, 0.0), "sign: must be -1 or 1"),
        ((math.nan, 0.5, 1.0), "theta_reflection: not finite"),
        ((0.0, math.inf, 1.0), "split_angle: not finite"),
    ],
)
def test_infeasible_coefficients_are_refused_by_name(row, words):
    with pytest.raises(TrcError, match=words):
        check_trc(trc_of([row, (0.0, 0.5, 1.0)]), 2)


def test_wrong_number_of_elements_is_refused():
    with pytest.raises(TrcError, match=r"theta_reflection: shape \[2\], the surface has 3 elements"):
        check_trc(neutral_trc(2, torch.float64), 3)
