"""The reference optimiser for one slot, compiled: closed form, projected gradient and damped WMMSE.

Numba is slow to import, so import this lazily; `rf_model.reference.solve` is the front. Inside, channels are scaled so
that the noise and the power limit are both 1, and rates are in nats. Beams are rows: v_j is `beams[j]`. Index 0 of a
side axis is reflection, 1 transmission.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

from rf_model.reference.elements import Element

Complex: TypeAlias = NDArray[np.complex128]
Real: TypeAlias = NDArray[np.float64]
Index: TypeAlias = NDArray[np.int64]
F = TypeVar("F", bound=Callable[..., object])

REFLECTION, TRANSMISSION = 0, 1
COUPLED, INDEPENDENT, REFLECTING, TRANSMITTING = (int(element) for element in Element)
FROM_CLOSED_FORM, FROM_COEFFICIENTS, FROM_BOTH = 0, 1, 2
"""Where the search starts: at the closed form, at given coefficients, or at given coefficients and beams."""

STEP_FACTORS = (0.4, 1.0, 2.5)
DAMPING = (0.3, 0.6, 1.0)
OPENING_BEAM_STEPS = 3
POWER_TOLERANCE = 1e-10
MULTIPLIER_STEPS = 60
MODE_STEPS = 30
SMALLEST = 1e-300


class Slot(NamedTuple):
    """A slot's scaled channels, and what is asked of it."""

    direct: Complex
    """[J, M]"""
    bs_ris: Complex
    """H transposed, [M, N]."""
    ris_user: Complex
    """[J, N]"""
    side: Index
    """[J] of each user."""
    element: Index
    """[N], what each can do."""
    per_user: bool
    """The power limit is on each beam, not on all together."""
    harmonic: bool
    """Maximise J^2 / sum(1 / R), not sum(R)."""
    floor: float
    """Rates count as at least this in the harmonic mean [nat]."""


def _compiled(function: F) -> F:
    """Machine code, cached on disk, that runs without the interpreter lock.

    Without `fastmath`: where sums may be reordered, the code of the process that compiles gives other last digits than
    the same code loaded from disk, and a replay would not be the flight's, bit for bit.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def _parallel(function: F) -> F:
    """The same with `numba.prange` spread over numba's threads."""
    compile_parallel = numba.njit(cache=True, nogil=True, error_model="numpy", parallel=True)
    return cast(F, compile_parallel(function))


@_compiled
def squared(value: complex) -> float:
    """|value|^2."""
    return value.real * value.real + value.imag * value.imag


@_compiled
def project(reflection: complex, transmission: complex, element: int) -> tuple[complex, complex]:
    """The feasible coefficients (reflection, transmission) of an element that are nearest to a point.

    For d = (reflection, transmission) they maximise Re(conj(d_r) phi_r + conj(d_t) phi_t), exactly: with
    m = Im(conj(d_t) d_r), a coupled element takes the sign of m, the angle w = atan2(2 |m|, |d_t|^2 - |d_r|^2) / 2 and
    the phase of S = cos w conj(d_t) +- j sin w conj(d_r).
    """
    if element == REFLECTING:
        size = np.sqrt(squared(reflection))
        return (reflection / size if size > 0.0 else 1.0 + 0.0j), 0.0j
    if element == TRANSMITTING:
        size = np.sqrt(squared(transmission))
        return 0.0j, (transmission / size if size > 0.0 else 1.0 + 0.0j)
    if element == INDEPENDENT:
        size = np.sqrt(squared(reflection) + squared(transmission))
        if size > 0.0:
            return reflection / size, transmission / size
        return np.sqrt(0.5) + 0.0j, np.sqrt(0.5) + 0.0j

    m = transmission.real * reflection.imag - transmission.imag * reflection.real
    excess = squared(transmission) - squared(reflection)
    root = np.sqrt(excess * excess + 4.0 * m * m)
    # Half-angle formulas by whichever of cosine and sine is large, so that the small one keeps its digits.
    if root == 0.0:
        cosine, sine = np.sqrt(0.5), np.sqrt(0.5)
    elif excess >= 0.0:
        cosine = np.sqrt(0.5 * (1.0 + excess / root))
        sine = abs(m) / (root * cosine)
    else:
        sine = np.sqrt(0.5 * (1.0 - excess / root))
        cosine = abs(m) / (root * sine)
    quarter_turn = 1.0j if m > 0.0 else -1.0j
    S = cosine * transmission.conjugate() + sine * quarter_turn * reflection.conjugate()
    size = np.sqrt(squared(S))
    phasor = S.conjugate() / size if size > 0.0 else 1.0 + 0.0j
    return sine * quarter_turn * phasor, cosine * phasor


@_compiled
def nearest_feasible(slot: Slot, points: Complex, stride: float, direction: Complex) -> Complex:
    """Every element's projection of points + stride * direction, [2, N]."""
    nearest = np.empty_like(points)
    for n in range(points.shape[1]):
        nearest[REFLECTION, n], nearest[TRANSMISSION, n] = project(
            points[REFLECTION, n] + stride * direction[REFLECTION, n],
            points[TRANSMISSION, n] + stride * direction[TRANSMISSION, n],
            slot.element[n],
        )
    return nearest


@_compiled
def products(left: Complex, right: Complex) -> Complex:
    """left @ right.T, plain loops: these matrices are too small for BLAS calls to pay."""
    product = np.empty((left.shape[0], right.shape[0]), np.complex128)
    for j in range(left.shape[0]):
        for k in range(right.shape[0]):
            total = 0.0j
            for m in range(left.shape[1]):
                total += left[j, m] * right[k, m]
            product[j, k] = total
    return product


@_compiled
def effective_channel(slot: Slot, coefficients: Complex) -> Complex:
    """g_j = h_b,j^T + h_s,j^T Phi H (paper eq. 12), [J, M]."""
    channel = np.empty_like(slot.direct)
    scattered = np.empty(slot.ris_user.shape[1], np.complex128)
    for j in range(channel.shape[0]):
        side = slot.side[j]
        for n in range(scattered.shape[0]):
            scattered[n] = slot.ris_user[j, n] * coefficients[side, n]
        for m in range(channel.shape[1]):
            total = slot.direct[j, m]
            for n in range(scattered.shape[0]):
                total += scattered[n] * slot.bs_ris[m, n]
            channel[j, m] = total
    return channel


@_compiled
def beams_at_surface(slot: Slot, beams: Complex) -> Complex:
    """H v_k, [K, N]."""
    arriving = np.zeros((beams.shape[0], slot.bs_ris.shape[1]), np.complex128)
    for k in range(beams.shape[0]):
        for m in range(beams.shape[1]):
            for n in range(arriving.shape[1]):
                arriving[k, n] += beams[k, m] * slot.bs_ris[m, n]
    return arriving


@_compiled
def utility(slot: Slot, received: Complex) -> float:
    """The objective [nat] of received amplitudes [J, J], user j's of beam k at (j, k)."""
    users = received.shape[0]
    total = 0.0
    for j in range(users):
        interference = 1.0
        for k in range(users):
            if k != j:
                interference += squared(received[j, k])
        rate = np.log1p(squared(received[j, j]) / interference)
        total += 1.0 / max(rate, slot.floor) if slot.harmonic else rate
    return users * users / total if slot.harmonic else total


@_compiled
def receivers(slot: Slot, received: Complex) -> tuple[Real, Complex]:
    """MMSE receivers u [J] and WMMSE weights [J]: the inverse error times the slope of the objective (1 or 1 / R^2)."""
    users = received.shape[0]
    weight = np.empty(users)
    receiver = np.empty(users, np.complex128)
    for j in range(users):
        interference = 1.0
        for k in range(users):
            if k != j:
                interference += squared(received[j, k])
        own = squared(received[j, j])
        rate = max(np.log1p(own / interference), slot.floor)
        slope = 1.0 / (rate * rate) if slot.harmonic else 1.0
        weight[j] = slope * (1.0 + own / interference)
        receiver[j] = received[j, j].conjugate() / (own + interference)
    return weight, receiver


@_compiled
def coefficient_gradient(slot: Slot, surface_beam: Complex, received: Complex) -> Complex:
    """Ascent direction of the objective in both sides' coefficients, [2, N].

    A positive multiple of dU / d(Re phi) + j dU / d(Im phi); zero for a side that an element does not serve.
    """
    users, elements = slot.ris_user.shape
    weight, receiver = receivers(slot, received)
    gradient = np.zeros((2, elements), np.complex128)
    pull = np.empty(elements, np.complex128)
    for j in range(users):
        pull[:] = 0.0
        for k in range(users):
            slope = -squared(receiver[j]) * received[j, k].conjugate()
            if k == j:
                slope += receiver[j]
            slope *= weight[j]
            for n in range(elements):
                pull[n] += slope * surface_beam[k, n]
        side = slot.side[j]
        for n in range(elements):
            gradient[side, n] += (slot.ris_user[j, n] * pull[n]).conjugate()
    for n in range(elements):
        if slot.element[n] == REFLECTING:
            gradient[TRANSMISSION, n] = 0.0
        elif slot.element[n] == TRANSMITTING:
            gradient[REFLECTION, n] = 0.0
    return gradient


@_compiled
def coefficient_step(
    slot: Slot, reached: float, step: float, coefficients: Complex, beams: Complex, channel: Complex, received: Complex
) -> tuple[float, float]:
    """Line search along the projected gradient, with beams that stay or follow; writes the last four arguments.

    Following beams force zeros anew at the coefficients tried, each with its power. At high SNR beams that stay would
    let interference in at any but tiny steps. Returns the objective, which never falls, and the next step.
    """
    gradient = coefficient_gradient(slot, beams_at_surface(slot, beams), received)
    size = 0.0
    for side in range(2):
        for n in range(gradient.shape[1]):
            size += squared(gradient[side, n])
    if not size > 0.0:
        return reached, step
    unit = np.sqrt(gradient.size / size)

    best = 0.0
    origin, held, power = coefficients.copy(), beams.copy(), row_powers(beams)
    for factor in STEP_FACTORS:
        trial = nearest_feasible(slot, origin, step * factor * unit, gradient)
        trial_channel = effective_channel(slot, trial)
        for candidate in (held, zero_forcing(trial_channel, power)):
            at_users = products(trial_channel, candidate)
            value = utility(slot, at_users)
            if value > reached:
                reached, best = value, factor
                coefficients[:], beams[:], channel[:], received[:] = trial, candidate, trial_channel, at_users
    return reached, step * (best if best > 0.0 else 0.5)


@_compiled
def regularised_solve(normal: Complex, multiplier: float, target: Complex) -> tuple[Complex, float, float]:
    """Rows x_k = (normal + mu I)^-1 target_k, their power p, and -dp/dmu / 2; by Cholesky factors.

    `normal` [M, M] is Hermitian and positive semidefinite, and only its lower triangle is read; mu is positive.
    """
    K, M = target.shape
    factor = np.empty((M, M), np.complex128)
    inverse_diagonal = np.empty(M)
    for column in range(M):
        pivot = normal[column, column].real + multiplier
        for i in range(column):
            pivot -= squared(factor[column, i])
        inverse = 1.0 / np.sqrt(max(pivot, 1e-3 * multiplier))  # exactly, no pivot is below mu
        inverse_diagonal[column] = inverse
        for row in range(column + 1, M):
            entry = normal[row, column]
            for i in range(column):
                entry -= factor[row, i] * factor[column, i].conjugate()
            factor[row, column] = entry * inverse
    solution = np.empty((K, M), np.complex128)
    whitened = np.empty(M, np.complex128)
    power, curvature = 0.0, 0.0
    for k in range(K):
        for row in range(M):
            entry = target[k, row]
            for i in range(row):
                entry -= factor[row, i] * solution[k, i]
            solution[k, row] = entry * inverse_diagonal[row]
        for row in range(M - 1, -1, -1):
            entry = solution[k, row]
            for i in range(row + 1, M):
                entry -= factor[i, row].conjugate() * solution[k, i]
            solution[k, row] = entry * inverse_diagonal[row]
        for row in range(M):
            power += squared(solution[k, row])
            entry = solution[k, row]
            for i in range(row):
                entry -= factor[row, i] * whitened[i]
            whitened[row] = entry * inverse_diagonal[row]
            curvature += squared(whitened[row])
    return solution, power, curvature


@_compiled
def limited_beams(normal: Complex, target: Complex, guess: float) -> Complex:
    """Rows (normal + mu I)^-1 target_k whose powers add up to at most 1, with the smallest such mu >= 0.

    Newton's method on 1 / sqrt(power), which is concave in mu: left of the root it rises monotonically to it, and from
    the right its first step goes left. It ends where bisection would. Zero counts as 1e-10 of the
    trace, with which a normal matrix of low rank can still be factored, to about 1e-6 of the result. A user who was
    given up has no target, so no power and no curvature.
    """
    lowest = SMALLEST
    for m in range(normal.shape[0]):
        lowest += 1e-10 * normal[m, m].real
    multiplier = max(guess, lowest)
    beams, power, curvature = regularised_solve(normal, multiplier, target)
    for _ in range(MULTIPLIER_STEPS):
        if abs(power - 1.0) <= POWER_TOLERANCE or (multiplier == lowest and power <= 1.0) or not curvature > 0.0:
            break
        multiplier = max(multiplier + power / curvature * (np.sqrt(power) - 1.0), lowest)
        beams, power, curvature = regularised_solve(normal, multiplier, target)
    beams *= 1.0 / np.sqrt(max(power, 1.0))
    return beams


@_compiled
def wmmse_beams(slot: Slot, channel: Complex, received: Complex) -> Complex:
    """Beams [J, M] that minimise the weighted mean square error for the present receivers and weights."""
    J, M = channel.shape
    weight, receiver = receivers(slot, received)
    normal = np.zeros((M, M), np.complex128)
    target = np.empty((J, M), np.complex128)
    multiplier = 0.0
    for j in range(J):
        loading = weight[j] * squared(receiver[j])
        multiplier += loading  # what the multiplier is where the beams are stationary
        for m in range(M):
            target[j, m] = weight[j] * (receiver[j] * channel[j, m]).conjugate()
            for i in range(m + 1):
                normal[m, i] += loading * channel[j, m].conjugate() * channel[j, i]
    if not slot.per_user:
        return limited_beams(normal, target, multiplier)
    beams = np.empty((J, M), np.complex128)
    for j in range(J):
        beams[j] = limited_beams(normal, target[j : j + 1], multiplier / J)[0]
    return beams


@_compiled
def beam_step(slot: Slot, channel: Complex, received: Complex, reached: float, beams: Complex) -> float:
    """Damped WMMSE step: writes `beams` and `received`, returns the objective, which never falls."""
    direction = wmmse_beams(slot, channel, received) - beams
    change = products(channel, direction)
    best = 0.0
    for damping in DAMPING:
        value = utility(slot, received + damping * change)
        if value > reached:
            reached, best = value, damping
    beams += best * direction
    received += best * change
    return reached


@_compiled
def row_powers(rows: Complex) -> Real:
    """Sum of |x|^2 over each row."""
    powers = np.zeros(rows.shape[0])
    for j in range(rows.shape[0]):
        for m in range(rows.shape[1]):
            powers[j] += squared(rows[j, m])
    return powers


@_compiled
def zero_forcing(channel: Complex, power: Real) -> Complex:
    """Regularised zero forcing [J, M] with the power [J] of each beam.

    v_j is along (I + sum over i of p_i conj(g_i) g_i^T)^-1 conj(g_j): for equal powers, the regulariser is noise over
    the power of a beam.
    """
    J, M = channel.shape
    normal = np.zeros((M, M), np.complex128)
    for j in range(J):
        for m in range(M):
            for i in range(m + 1):
                normal[m, i] += power[j] * channel[j, m].conjugate() * channel[j, i]
    beams, _, _ = regularised_solve(normal, 1.0, channel.conj())
    sizes = row_powers(beams)
    for j in range(J):
        beams[j] *= np.sqrt(power[j] / sizes[j]) if sizes[j] > 0.0 else 0.0
    return beams


@_compiled
def strongest_mode(slot: Slot) -> Complex:
    """A beam [1, M] along the strongest right singular vector of H, by power iteration."""
    M, N = slot.bs_ris.shape
    gram = np.empty((M, M), np.complex128)
    strongest = 0
    for m in range(M):
        for i in range(M):
            total = 0.0j
            for n in range(N):
                total += slot.bs_ris[m, n].conjugate() * slot.bs_ris[i, n]
            gram[m, i] = total
        if gram[m, m].real > gram[strongest, strongest].real:
            strongest = m
    beam = np.empty((1, M), np.complex128)
    beam[0] = gram[:, strongest]
    for _ in range(MODE_STEPS):
        power = 0.0
        for m in range(M):
            power += squared(beam[0, m])
        if power > 0.0:
            beam = products(beam / np.sqrt(power), gram)
    return beam


@_compiled
def closed_form(slot: Slot) -> Complex:
    """Coefficients [2, N] for a beam v along the strongest mode of H.

    Each element maximises Re(c_r phi_r + c_t phi_t), where c of a side is the sum over its users of h_s[j, n] (H v)[n]
    turned back by the phase of h_b,j v: the cascades are pulled into phase with the direct links.
    """
    J, N = slot.ris_user.shape
    beam = strongest_mode(slot)
    arriving = beams_at_surface(slot, beam)
    direct = products(slot.direct, beam)
    wanted = np.zeros((2, N), np.complex128)
    for j in range(J):
        size = np.sqrt(squared(direct[j, 0]))
        phasor = direct[j, 0] / size if size > 0.0 else 1.0 + 0.0j
        side = slot.side[j]
        for n in range(N):
            wanted[side, n] += (slot.ris_user[j, n] * arriving[0, n]).conjugate() * phasor
    return nearest_feasible(slot, wanted, 0.0, wanted)


@_compiled
def solve_slot(slot: Slot, iterations: int, start: int, coefficients: Complex, beams: Complex, history: Real) -> None:
    """Optimise one slot. `coefficients` [2, N] and `beams` [J, M] are read as `start` says, and written.

    `history` [iterations + 1] gets the objective at the start and after each iteration. `iterations` -1 leaves it at
    zero forcing, without the WMMSE steps that open the search; `history` then has one entry.
    """
    if start == FROM_CLOSED_FORM:
        coefficients[:] = closed_form(slot)
    else:
        coefficients[:] = nearest_feasible(slot, coefficients, 0.0, coefficients)
    channel = effective_channel(slot, coefficients)
    if start != FROM_BOTH:
        users = beams.shape[0]
        beams[:] = zero_forcing(channel, np.full(users, 1.0 if slot.per_user else 1.0 / users))
    received = products(channel, beams)
    reached = utility(slot, received)
    if start != FROM_BOTH and iterations >= 0:
        for _ in range(OPENING_BEAM_STEPS):
            reached = beam_step(slot, channel, received, reached, beams)
    history[0] = reached
    step = 1.0
    for iteration in range(iterations):
        reached, step = coefficient_step(slot, reached, step, coefficients, beams, channel, received)
        reached = beam_step(slot, channel, received, reached, beams)
        history[iteration + 1] = reached


@_parallel
def solve_slots(
    direct: Complex,
    bs_ris: Complex,
    ris_user: Complex,
    side: Index,
    element: Index,
    per_user: bool,
    harmonic: bool,
    floor: float,
    iterations: int,
    start: int,
    coefficients: Complex,
    beams: Complex,
    history: Real,
) -> None:
    """`solve_slot` for every row of a batch, spread over numba's threads; all but `element` have a leading axis."""
    for b in numba.prange(direct.shape[0]):
        slot = Slot(direct[b], bs_ris[b], ris_user[b], side[b], element, per_user, harmonic, floor)
        solve_slot(slot, iterations, start, coefficients[b], beams[b], history[b])
