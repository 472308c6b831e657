"""The compiled pieces of the reference, each against an independent computation."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from rf_model.reference import kernel
from rf_model.reference.elements import Element

component = st.floats(-3, 3).map(lambda x: 0.0 if abs(x) < 1e-6 else x)
points = st.tuples(component, component, component, component)


def scattered(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / math.sqrt(2)


def a_slot(seed, users=4, antennas=4, elements=6, harmonic=True, per_user=False, snr=30.0, element=None):
    rng = np.random.default_rng(seed)
    codes = np.full(elements, int(Element.COUPLED)) if element is None else np.asarray(element, np.int64)
    return kernel.Slot(
        direct=scattered(rng, users, antennas) * math.sqrt(snr),
        bs_ris=scattered(rng, antennas, elements) * math.sqrt(snr),
        ris_user=scattered(rng, users, elements),
        side=rng.integers(0, 2, users),
        element=codes,
        per_user=per_user,
        harmonic=harmonic,
        floor=1e-9,
    )


def some_beams(slot, seed, power=1.0):
    beams = scattered(np.random.default_rng(seed + 1000), *slot.direct.shape)
    powers = (np.abs(beams) ** 2).sum(axis=1 if slot.per_user else None, keepdims=True)
    return beams * np.sqrt(power / powers)


def some_coefficients(slot, seed):
    wanted = scattered(np.random.default_rng(seed + 2000), 2, slot.bs_ris.shape[1])
    return kernel.nearest_feasible(slot, wanted, 0.0, wanted)


@settings(max_examples=60, deadline=None)
@given(points)
def test_no_point_of_a_dense_grid_of_coupled_coefficients_beats_the_projection(parts):
    d_r, d_t = complex(*parts[:2]), complex(*parts[2:])
    phi_r, phi_t = kernel.project(d_r, d_t, Element.COUPLED)
    reached = (d_r.conjugate() * phi_r + d_t.conjugate() * phi_t).real

    splits, phases = 181, 360
    x = np.linspace(0, math.pi / 2, splits)[:, None, None]
    theta = np.linspace(-math.pi, math.pi, phases, endpoint=False)[:, None]
    sign = np.array([-1, 1])
    reflection = np.sin(x) * np.exp(1j * theta)
    transmission = np.cos(x) * np.exp(1j * (theta + sign * math.pi / 2))
    grid = (d_r.conjugate() * reflection + d_t.conjugate() * transmission).real.max()

    assert grid <= reached + 1e-12
    # half a cell away from the maximum in both angles costs at most the product of these cosines
    assert grid >= reached * math.cos(math.pi / 4 / (splits - 1)) * math.cos(math.pi / phases) - 1e-12


@settings(max_examples=200, deadline=None)
@given(points)
def test_coupled_projection_reaches_the_closed_form_of_the_maximum_and_is_feasible(parts):
    d_r, d_t = complex(*parts[:2]), complex(*parts[2:])
    phi_r, phi_t = kernel.project(d_r, d_t, Element.COUPLED)
    m = (d_t.conjugate() * d_r).imag
    half = (abs(d_t) ** 2 - abs(d_r) ** 2) / 2
    highest = math.sqrt((abs(d_t) ** 2 + abs(d_r) ** 2) / 2 + math.hypot(half, m))
    assert (d_r.conjugate() * phi_r + d_t.conjugate() * phi_t).real == pytest.approx(highest, rel=1e-12, abs=1e-15)
    assert abs(phi_r) ** 2 + abs(phi_t) ** 2 == pytest.approx(1, abs=1e-12)
    assert abs((phi_t * phi_r.conjugate()).real) < 1e-12


@settings(max_examples=100, deadline=None)
@given(points)
def test_projections_of_the_other_elements_are_the_nearest_points_of_their_spheres(parts):
    d_r, d_t = complex(*parts[:2]), complex(*parts[2:])
    gain = {
        Element.INDEPENDENT: math.hypot(abs(d_r), abs(d_t)),
        Element.REFLECTING: abs(d_r),
        Element.TRANSMITTING: abs(d_t),
    }
    for element, highest in gain.items():
        phi_r, phi_t = kernel.project(d_r, d_t, element)
        assert (d_r.conjugate() * phi_r + d_t.conjugate() * phi_t).real == pytest.approx(highest, abs=1e-12)
        assert abs(phi_r) ** 2 + abs(phi_t) ** 2 == pytest.approx(1, abs=1e-12)
    assert kernel.project(d_r, d_t, Element.REFLECTING)[1] == 0
    assert kernel.project(d_r, d_t, Element.TRANSMITTING)[0] == 0


def torch_utility(slot, coefficients, beams):
    """The objective [nat] by matrix products, differentiable."""
    direct, surface, ris_user = (torch.from_numpy(a) for a in (slot.direct, slot.bs_ris.T.copy(), slot.ris_user))
    g = direct + (ris_user * coefficients[torch.from_numpy(slot.side)]) @ surface
    powers = (g @ torch.from_numpy(beams).T).abs() ** 2
    own = powers.diagonal()
    rate = torch.log1p(own / (powers.sum(1) - own + 1))
    return len(rate) ** 2 / (1 / rate).sum() if slot.harmonic else rate.sum(), rate.detach()


@pytest.mark.parametrize("harmonic", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_gradient_is_that_of_autograd(harmonic, seed):
    slot = a_slot(seed, harmonic=harmonic, users=3 + seed % 3)
    beams, coefficients = some_beams(slot, seed), some_coefficients(slot, seed)
    variable = torch.from_numpy(coefficients.copy()).requires_grad_()
    value, rate = torch_utility(slot, variable, beams)
    value.backward()

    received = kernel.products(kernel.effective_channel(slot, coefficients), beams)
    gradient = kernel.coefficient_gradient(slot, kernel.beams_at_surface(slot, beams), received)
    slope_of_mean = len(rate) ** 2 / (1 / rate).sum().item() ** 2 if harmonic else 1.0
    assert kernel.utility(slot, received) == pytest.approx(value.item(), rel=1e-12)
    np.testing.assert_allclose(2 * slope_of_mean * gradient, variable.grad.numpy(), rtol=1e-9, atol=1e-12)


def test_gradient_is_zero_where_an_element_does_not_serve():
    slot = a_slot(3, element=[Element.REFLECTING, Element.TRANSMITTING] * 3)
    beams, coefficients = some_beams(slot, 3), some_coefficients(slot, 3)
    received = kernel.products(kernel.effective_channel(slot, coefficients), beams)
    gradient = kernel.coefficient_gradient(slot, kernel.beams_at_surface(slot, beams), received)
    assert (gradient[kernel.TRANSMISSION, ::2] == 0).all()
    assert (gradient[kernel.REFLECTION, 1::2] == 0).all()
    assert (gradient[kernel.REFLECTION, ::2] != 0).all()


def plain_wmmse_beams(G, W, harmonic, limit, per_user=False):
    """One undamped WMMSE step for channels G [J, M] and beams W [M, J], noise 1: eigenvalues and plain bisection."""
    J = len(G)
    E = G @ W
    total = (np.abs(E) ** 2).sum(1) + 1
    own = np.diag(E)
    u = own.conj() / total
    error = 1 - np.abs(own) ** 2 / total
    weight = (1 / np.log(1 / error) ** 2 if harmonic else 1.0) / error
    A = sum(weight[j] * abs(u[j]) ** 2 * np.outer(G[j].conj(), G[j]) for j in range(J))
    B = G.conj().T * (weight * u.conj())
    values, basis = np.linalg.eigh(A)
    values = np.where(values > 1e-10 * values.max(), values, 0)
    target = basis.conj().T @ B

    def at(columns, mu):
        inverse = np.divide(1, values + mu, where=values + mu > 0, out=np.zeros_like(values))
        return basis @ (inverse[:, None] * target[:, columns])

    result = np.empty_like(W)
    for columns in [[j] for j in range(J)] if per_user else [list(range(J))]:
        low, high = 0.0, np.linalg.norm(B[:, columns]) / math.sqrt(limit)
        if np.linalg.norm(at(columns, 0)) ** 2 <= limit:
            high = 0.0
        for _ in range(200):
            middle = (low + high) / 2
            if np.linalg.norm(at(columns, middle)) ** 2 > limit:
                low = middle
            else:
                high = middle
        result[:, columns] = at(columns, high)
    return result


@pytest.mark.parametrize("per_user", [False, True])
@pytest.mark.parametrize("harmonic", [True, False])
@pytest.mark.parametrize(("users", "antennas"), [(4, 4), (2, 5), (5, 2), (1, 1)])
def test_wmmse_step_is_that_of_a_plain_numpy_one(users, antennas, harmonic, per_user):
    for seed in range(4):
        slot = a_slot(seed, users, antennas, harmonic=harmonic, per_user=per_user, snr=10.0 ** (seed - 1))
        beams = some_beams(slot, seed)
        channel = kernel.effective_channel(slot, some_coefficients(slot, seed))
        ours = kernel.wmmse_beams(slot, channel, kernel.products(channel, beams))
        plain = plain_wmmse_beams(channel, beams.T, harmonic, 1.0, per_user)
        np.testing.assert_allclose(ours.T, plain, atol=1e-5)  # 2e-16 over the least multiplier, 1e-10


def test_wmmse_leaves_power_unused_where_that_is_best():
    slot = a_slot(0, users=1, antennas=4, harmonic=False, snr=1e4)
    channel = slot.direct
    beams = math.sqrt(0.5) * channel.conj() / np.linalg.norm(channel)
    ours = kernel.wmmse_beams(slot, channel, kernel.products(channel, beams))
    np.testing.assert_allclose(ours.T, plain_wmmse_beams(channel, beams.T, False, 1.0), atol=1e-5)
    assert np.linalg.norm(ours) ** 2 == pytest.approx(0.5, rel=1e-3)


@pytest.mark.parametrize(("users", "antennas"), [(3, 5), (5, 2)])
def test_zero_forcing_is_regularised_by_the_noise_and_keeps_the_powers_given(users, antennas):
    G = a_slot(7, users, antennas).direct
    equal = kernel.zero_forcing(G, np.full(users, 0.25)).T
    plain = G.conj().T @ np.linalg.inv(G @ G.conj().T + np.eye(users) / 0.25)
    np.testing.assert_allclose(equal, 0.5 * plain / np.linalg.norm(plain, axis=0), atol=1e-12)

    power = np.linspace(0.0, 0.4, users)
    beams = kernel.zero_forcing(G, power).T
    plain = np.linalg.inv(np.eye(antennas) + (G.conj().T * power) @ G) @ G.conj().T
    np.testing.assert_allclose(beams, np.sqrt(power) * plain / np.linalg.norm(plain, axis=0), atol=1e-12)


def test_strongest_mode_is_the_first_right_singular_vector():
    slot = a_slot(11, antennas=5, elements=16)
    rank_one = np.outer(scattered(np.random.default_rng(0), 5), scattered(np.random.default_rng(1), 16))
    slot = slot._replace(bs_ris=slot.bs_ris / 30 + 3 * rank_one)
    mode = kernel.strongest_mode(slot)[0]
    singular = np.linalg.svd(slot.bs_ris.T)[2][0].conj()
    assert abs(np.vdot(mode, singular)) == pytest.approx(np.linalg.norm(mode), rel=1e-9)


def test_closed_form_puts_a_lone_users_cascade_in_phase_with_the_direct_link():
    slot = a_slot(5, users=1, elements=8)
    beam = kernel.strongest_mode(slot)
    coefficients = kernel.closed_form(slot)
    cascade = slot.ris_user[0] * kernel.beams_at_surface(slot, beam)[0] * coefficients[slot.side[0]]
    direct = kernel.products(slot.direct, beam)[0, 0]
    np.testing.assert_allclose(np.angle(cascade / direct), 0, atol=1e-9)
    np.testing.assert_allclose(np.abs(coefficients[slot.side[0]]), 1, atol=1e-12)
