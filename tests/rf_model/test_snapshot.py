"""One slot on its own, against the equations written anew with plain loops; and every way to ask for it wrongly."""

import cmath
import copy
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.messages import Action, SlotOpened
from rf_model.evaluation import evaluate
from rf_model.reference.solve import closed_form
from rf_model.scenario import preset
from rf_model.slot_radio import SlotRadio
from rf_model.snapshot import SnapshotError, read_snapshot
from tests.rf_model.test_slot_radio import action, opened

EXAMPLE = yaml.safe_load((Path(__file__).parents[2] / "missions" / "snapshot.yaml").read_text())
USERS = [[-30.0, 0.0, 1.5], [-40.0, 20.0, 1.5], [50.0, 3.0, 1.5], [20.0, -40.0, 1.5]]
WORDS = {"scenario": "physical_small", "position_enu": [0.0, 0.0, 60.0], "users_enu": USERS}


def changed(fields, **changes):
    """A copy with some fields replaced; `None` removes one."""
    merged = copy.deepcopy(fields) | changes
    return {name: value for name, value in merged.items() if value is not None}


def result(fields):
    return evaluate(read_snapshot(fields))


# The equations anew: one number at a time, no tensors, nothing of rf_model.

C, F_GHZ, KAPPA, RIS_GAIN_DB, DIRECT_EXTRA_DB, SPACING, BANDWIDTH = 299792458.0, 5.0, 5.0, 42.0, 40.0, 2.0, 1e6
NOISE_W = 10 ** ((-174 + 7 + 60 - 30) / 10)


def los_db(d):
    return 28.0 + 22.0 * math.log10(d) + 20.0 * math.log10(F_GHZ)


def nlos_db(d):
    return max(36.7 * math.log10(d) + 22.7 + 26.0 * math.log10(F_GHZ), los_db(d))


def channels_by_hand(fields, M, J, rows, columns):
    """h_b [J][M], H [N][M], h_s [J][N] and who is served by transmission, from the raw random numbers."""
    N, base, uav, yaw = rows * columns, (-1000.0, 0.0, 25.0), fields["position_enu"], fields["attitude_rad"][2]
    generator = torch.Generator().manual_seed(fields["seed"])
    w = torch.randn(J * M + N * M + J * N, generator=generator, dtype=torch.complex128).tolist()
    coin = torch.rand(J, generator=generator, dtype=torch.float64).tolist()
    normal, along = (math.cos(yaw), math.sin(yaw)), (-math.sin(yaw), math.cos(yaw))
    strong, weak = math.sqrt(KAPPA / (KAPPA + 1)), math.sqrt(1 / (KAPPA + 1))

    def response(n, offset, d):
        across = (offset[0] * along[0] + offset[1] * along[1]) / d
        phase = 2 * math.pi * SPACING * ((n % columns) * across + (n // columns) * offset[2] / d)
        return cmath.exp(1j * phase)

    to_base = [b - u for b, u in zip(base, uav, strict=True)]
    d_base = math.dist(base, uav)
    amplitude = 10 ** (-(los_db(d_base) - RIS_GAIN_DB) / 20)
    h_b = [[0j] * M for _ in range(J)]
    H = [[0j] * M for _ in range(N)]
    h_s = [[0j] * N for _ in range(J)]
    for n in range(N):
        for m in range(M):
            steering = response(n, to_base, d_base) * cmath.exp(1j * math.pi * m * to_base[1] / d_base)
            H[n][m] = amplitude * (strong * steering + weak * w[J * M + n * M + m])
    beyond, seen = [], []
    for j, user in enumerate(fields["users_enu"]):
        for m in range(M):
            h_b[j][m] = 10 ** (-(nlos_db(math.dist(base, user)) + DIRECT_EXTRA_DB) / 20) * w[j * M + m]
        offset = [a - b for a, b in zip(user, uav, strict=True)]
        d = math.dist(user, uav)
        elevation = math.degrees(math.asin(-offset[2] / d))
        seen.append(coin[j] < 1 / (1 + 9.61 * math.exp(-0.16 * (elevation - 9.61))))
        for n in range(N):
            scattered = w[J * M + N * M + j * N + n]
            if seen[j]:
                h_s[j][n] = 10 ** (-los_db(d) / 20) * (strong * response(n, offset, d) + weak * scattered)
            else:
                h_s[j][n] = 10 ** (-(los_db(d) + 20) / 20) * scattered
        side = offset[0] * normal[0] + offset[1] * normal[1]
        beyond.append(side * (to_base[0] * normal[0] + to_base[1] * normal[1]) < 0)
    return h_b, H, h_s, beyond, seen


def sinr_by_hand(h_b, H, h_s, beyond, phi_r, phi_t, W):
    J, M, N = len(h_b), len(W), len(H)
    sinr = []
    for j in range(J):
        phi = phi_t if beyond[j] else phi_r
        powers = []
        for k in range(J):
            received = 0j
            for m in range(M):
                cascade = sum(h_s[j][n] * phi[n] * H[n][m] for n in range(N))
                received += (h_b[j][m] + cascade) * W[m][k]
            powers.append(abs(received) ** 2)
        sinr.append(powers[j] / (sum(powers) - powers[j] + NOISE_W))
    return sinr


def power_by_hand(velocity, yaw, elements):
    """Eq. 15-19, W = 25 N, with both roots of eq. 16b, v_i of momentum theory, no negative climb."""
    rho, A, s, tip, delta, d0, W = 1.225, 0.503, 0.05, 120.0, 0.012, 0.6, 25.0
    V = math.hypot(velocity[0], velocity[1])
    v_i = math.sqrt(W / (2 * rho * A))
    P_0 = delta / 8 * rho * s * A * tip**3
    P_i = W**1.5 / math.sqrt(2 * rho * A)
    area = (elements - 1) ** 2 * (C / (F_GHZ * 1e9) / 2) ** 2
    v_perp = abs(velocity[0] * math.cos(yaw) + velocity[1] * math.sin(yaw))
    return {
        "blade": P_0 * (1 + 3 * V**2 / tip**2),
        "induced": P_i * math.sqrt(math.sqrt(1 + V**4 / (4 * v_i**4)) - V**2 / (2 * v_i**2)),
        "parasite": 0.5 * d0 * rho * s * A * V**3,
        "climb": W * max(velocity[2], 0.0),
        "panel_drag": 0.5 * rho * 2.1 * area * v_perp**3,
    }


def require_numbers(evaluation, sinr, power):
    """What follows from SINR and power, by the definitions."""
    rates = [BANDWIDTH * math.log2(1 + value) for value in sinr]
    J = len(rates)
    assert evaluation.sinr == pytest.approx(sinr, rel=1e-9)
    assert evaluation.rate_bps == pytest.approx(rates, rel=1e-9)
    assert evaluation.sum_rate_bps == pytest.approx(sum(rates))
    assert evaluation.hfi == pytest.approx(J / sum(1 / rate for rate in rates) / (sum(rates) / J))
    assert evaluation.jfi == pytest.approx(sum(rates) ** 2 / (J * sum(rate**2 for rate in rates)))
    assert evaluation.fair_rate_bps == pytest.approx(evaluation.hfi * sum(rates))
    assert evaluation.below_qos == [rate < 200e3 for rate in rates]
    assert evaluation.power_terms_w == pytest.approx(power)
    assert evaluation.power_w == pytest.approx(sum(power.values()))
    assert evaluation.energy_j == pytest.approx(evaluation.power_w)
    hover = power_by_hand((0, 0, 0), 0.0, 1)
    expected = evaluation.fair_rate_bps / 1e6 - 0.1 * evaluation.power_w / sum(hover.values())
    assert evaluation.reward == pytest.approx(expected)


def coefficients(theta, split, sign):
    """phi_R, phi_T of eq. 1 and 2."""
    reflection = [math.sin(x) * cmath.exp(1j * t) for t, x in zip(theta, split, strict=True)]
    turned = [t + q * math.pi / 2 for t, q in zip(theta, sign, strict=True)]
    return reflection, [math.cos(x) * cmath.exp(1j * t) for t, x in zip(turned, split, strict=True)]


def test_the_example_agrees_with_the_equations_written_anew():
    evaluation = result(EXAMPLE)
    h_b, H, h_s, beyond, seen = channels_by_hand(EXAMPLE, M=2, J=2, rows=2, columns=2)
    for name, link in (("direct", h_b), ("bs_ris", H), ("ris_user", h_s)):
        expected = [[[value.real, value.imag] for value in row] for row in link]
        np.testing.assert_allclose(evaluation.channels[name], expected, rtol=1e-9, atol=1e-15)
    assert evaluation.regions == ["transmission" if side else "reflection" for side in beyond]
    assert evaluation.regions == ["reflection", "transmission"], "the example shows both"

    given_trc = EXAMPLE["trc"]
    phi_r, phi_t = coefficients(given_trc["theta_reflection"], given_trc["split_angle"], given_trc["sign"])
    W = [[complex(*value) for value in row] for row in EXAMPLE["beamforming"]]
    power = power_by_hand(EXAMPLE["velocity_enu"], EXAMPLE["attitude_rad"][2], elements=2 * 4)
    require_numbers(evaluation, sinr_by_hand(h_b, H, h_s, beyond, phi_r, phi_t, W), power)

    base, uav, users = (-1000.0, 0.0, 25.0), EXAMPLE["position_enu"], EXAMPLE["users_enu"]
    links = evaluation.links
    assert links.bs_ris.distance_m == pytest.approx(math.dist(base, uav))
    assert links.bs_ris.path_loss_los_db == pytest.approx(los_db(math.dist(base, uav)))
    assert (links.bs_ris.path_loss_nlos_db, links.bs_ris.line_of_sight) == (None, True)
    for j, user in enumerate(users):
        assert links.direct[j].path_loss_nlos_db == pytest.approx(nlos_db(math.dist(base, user)))
        assert links.direct[j].path_loss_los_db is None
        assert links.ris_user[j].path_loss_los_db == pytest.approx(los_db(math.dist(uav, user)))
        assert links.ris_user[j].path_loss_nlos_db == pytest.approx(los_db(math.dist(uav, user)) + 20)
        assert links.ris_user[j].line_of_sight == seen[j]
    assert evaluation.noise_w == pytest.approx(NOISE_W)
    assert evaluation.transmit_power_w == pytest.approx(sum(abs(w) ** 2 for row in W for w in row))
    longer = result(EXAMPLE | {"scenario": EXAMPLE["scenario"] | {"slot_s": 2.5}})
    assert longer.energy_j == pytest.approx(2.5 * evaluation.power_w)


@pytest.mark.parametrize(
    "fields",
    [{"ris": "closed_form"}, {"ris": {"mode": "optimised", "iterations": 3}}, {"beamforming": "rzf"}, {}],
    ids=["closed form", "optimised", "rzf", "neutral"],
)
def test_what_is_chosen_for_the_user_is_told_and_worth_what_the_equations_say(fields):
    fields = WORDS | {"seed": 3, "attitude_rad": [0.0, 0.0, -0.3], "velocity_enu": [-4.0, 2.0, -1.0]} | fields
    evaluation = result(fields)
    h_b, H, h_s, beyond, _ = channels_by_hand(fields, M=4, J=4, rows=4, columns=4)
    trc = evaluation.trc
    phi_r = [b * cmath.exp(1j * t) for b, t in zip(trc["beta_reflection"], trc["theta_reflection"], strict=True)]
    phi_t = [b * cmath.exp(1j * t) for b, t in zip(trc["beta_transmission"], trc["theta_transmission"], strict=True)]
    W = [[complex(*value) for value in row] for row in evaluation.beamforming]
    power = power_by_hand(fields["velocity_enu"], -0.3, elements=4 * 4)
    require_numbers(evaluation, sinr_by_hand(h_b, H, h_s, beyond, phi_r, phi_t, W), power)
    limit = 10 ** ((29 - 30) / 10)
    assert evaluation.transmit_power_w <= limit * (1 + 1e-6)
    if "optimised" not in str(fields):  # where unused power can be best
        assert evaluation.transmit_power_w == pytest.approx(limit)


@pytest.mark.parametrize("p_max", ["total", "per_user"])
def test_zero_forcing_is_that_of_the_closed_form_for_its_coefficients(p_max):
    """The reference has its own, compiled one."""
    words = WORDS | {"scenario": {"preset": "physical_small", "p_max": p_max}}
    reference = result(words | {"ris": "closed_form"})
    again = result(words | {"trc": reference.trc, "beamforming": "rzf"})
    assert again.sinr == pytest.approx(reference.sinr, rel=1e-6)
    assert again.transmit_power_w == pytest.approx(reference.transmit_power_w)


@pytest.mark.parametrize("surface", ["coupled", "independent", "dual", "conventional"])
@pytest.mark.parametrize("bits", [None, 2])
def test_what_comes_out_goes_in_again(surface, bits):
    """Coefficients, beams and channels of an answer, put into the question, give the same answer."""
    scenario = {"preset": "physical_small", "surface": surface, "phase_bits": bits}
    question = WORDS | {"scenario": scenario, "ris": "closed_form", "seed": 5}
    answer = asdict(result(question))
    told = {name: answer[name] for name in ("trc", "beamforming", "channels")}
    again = asdict(result(WORDS | {"scenario": scenario} | told))
    for name in ("sinr", "rate_bps", "reward", "fair_rate_bps", "power_w"):
        assert again[name] == pytest.approx(answer[name], rel=1e-6)
    assert again["channels"] == answer["channels"]
    sights = [link["line_of_sight"] for link in again["links"]["ris_user"]]
    assert sights == [None] * 4, "nobody knows with which line of sight given channels came about"


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(-3.1, 3.1), st.floats(0, math.pi / 2), st.sampled_from([-1, 1])), min_size=4, max_size=4
    )
)
def test_three_forms_of_the_same_coefficients_are_worth_the_same(elements):
    theta, split, sign = (list(column) for column in zip(*elements, strict=True))
    phi_r, phi_t = coefficients(theta, split, sign)
    amplitudes = {
        "theta_reflection": theta,
        "theta_transmission": [t + q * math.pi / 2 for t, q in zip(theta, sign, strict=True)],
        "beta_reflection": [math.sin(x) for x in split],
        "beta_transmission": [math.cos(x) for x in split],
    }
    diagonals = {"reflection": [[p.real, p.imag] for p in phi_r], "transmission": [[p.real, p.imag] for p in phi_t]}
    forms = ({"theta_reflection": theta, "split_angle": split, "sign": sign}, amplitudes, diagonals)
    sinrs = [result(EXAMPLE | {"trc": form}).sinr for form in forms]
    assert sinrs[1] == pytest.approx(sinrs[0], rel=1e-6)
    assert sinrs[2] == pytest.approx(sinrs[0], rel=1e-6)


def test_four_decimals_are_enough():
    rounded = {"reflection": [[0.7071, 0.0]] * 4, "transmission": [[0.0, -0.7071]] * 4}
    exact = {"theta_reflection": [0.0] * 4, "split_angle": [math.pi / 4] * 4, "sign": [-1] * 4}
    assert result(EXAMPLE | {"trc": rounded}).sinr == pytest.approx(result(EXAMPLE | {"trc": exact}).sinr)


def test_surfaces_without_choices_need_phases_only():
    for surface in ("dual", "conventional"):
        scenario = EXAMPLE["scenario"] | {"surface": surface}
        short = result(EXAMPLE | {"scenario": scenario, "trc": {"theta_reflection": [0.1, 0.2, 0.3, 0.4]}})
        split = [math.pi / 2, 0.0 if surface == "dual" else math.pi / 2] * 2
        whole = {"theta_reflection": [0.1, 0.2, 0.3, 0.4], "split_angle": split, "sign": [1] * 4}
        assert result(EXAMPLE | {"scenario": scenario, "trc": whole}).sinr == pytest.approx(short.sinr)


def test_messages_of_a_flight_can_be_pasted():
    """A slot of the rf node, evaluated from its messages, is worth what its report says."""
    scenario = preset("physical_small")
    radio = SlotRadio(scenario, seed=11)
    slot = opened(0, velocity_enu=(4.0, 0.0, 0.0), attitude_rad=(0.02, -0.1, 0.3))
    (state,) = radio.open(slot)
    decided: Action = action(0)
    radio.apply(decided)
    closing: SlotOpened = opened(1, closing=True)
    report = radio.open(closing)[-1]
    evaluation = result(
        {
            "scenario": "physical_small",
            "position_enu": list(slot.position_enu),
            "velocity_enu": list(slot.velocity_enu),
            "attitude_rad": list(slot.attitude_rad),
            "users_enu": state.users_enu,
            "channels": {name: getattr(state, name) for name in ("direct", "bs_ris", "ris_user")},
            "trc": {name: getattr(decided, name) for name in ("theta_reflection", "split_angle", "sign")}
            | {"theta_transmission": []},
            "beamforming": decided.beamforming,
        }
    )
    assert evaluation.regions == report.regions
    for name in ("sinr", "rate_bps", "below_qos", "sum_rate_bps", "fair_rate_bps", "hfi", "jfi", "power_w", "reward"):
        assert getattr(evaluation, name) == pytest.approx(getattr(report, name), rel=1e-9), name


def test_same_seed_same_channels_and_another_seed_others():
    assert result(WORDS | {"seed": 1}) == result(WORDS | {"seed": 1})
    assert result(WORDS | {"seed": 1}).channels != result(WORDS | {"seed": 2}).channels


def test_tilt_counts_only_when_it_is_flown():
    tilted = WORDS | {"attitude_rad": [0.2, -0.1, 0.0]}
    assert result(tilted).sinr == result(WORDS).sinr
    flown = {"scenario": {"preset": "physical_small", "attitude": "flown"}}
    assert result(tilted | flown).sinr != pytest.approx(result(WORDS | flown).sinr, rel=1e-2)


def test_heading_is_the_scenarios_unless_said_and_wind_blows_on_the_panel():
    turned = WORDS | {
        "scenario": {"preset": "physical_small", "panel_heading_rad": 0.7},
        "velocity_enu": [5.0, 0.0, 0.0],
    }
    assert result(turned) == result(turned | {"attitude_rad": [0.0, 0.0, 0.7]})
    windy = WORDS | {"scenario": {"preset": "physical_small", "wind_enu": [-5.0, 0.0, 0.0]}}
    assert result(windy).power_terms_w == pytest.approx(result(WORDS | {"velocity_enu": [5.0, 0.0, 0.0]}).power_terms_w)


def test_line_of_sight_of_tr_36777_is_told():
    scenario = {"preset": "physical_small", "path_loss": "3gpp"}
    low = result(WORDS | {"scenario": scenario, "position_enu": [0.0, 0.0, 40.0]}).links.bs_ris
    assert 0 < low.line_of_sight_probability < 1
    assert low.path_loss_nlos_db > low.path_loss_los_db
    assert isinstance(low.line_of_sight, bool)
    high = result(WORDS | {"scenario": scenario, "position_enu": [0.0, 0.0, 110.0]}).links.bs_ris
    assert (high.line_of_sight_probability, high.line_of_sight, high.path_loss_nlos_db) == (1.0, True, None)


# The odd and the wrong.


@pytest.mark.parametrize(
    ("users", "beyond"),
    [(USERS[:2], 0), (USERS[2:], 2), (USERS[:1], 0), ([[0.0, 30.0, 1.5]], 0)],
    ids=["Q = 0", "P = 0", "J = 1", "in the panel's plane: reflection"],
)
@pytest.mark.parametrize("ris", ["agent", "closed_form", {"mode": "optimised", "iterations": 2}])
def test_one_sided_service_is_allowed(users, beyond, ris):
    scenario = {"preset": "physical_small", "users": len(users)}
    evaluation = result(WORDS | {"scenario": scenario, "users_enu": users, "ris": ris})
    assert evaluation.regions.count("transmission") == beyond
    assert all(rate > 0 for rate in evaluation.rate_bps)


@pytest.mark.parametrize(
    "scenario",
    [{"rows": 2, "columns": 5}, {"rows": 1, "columns": 1}, {"antennas": 2}, {"antennas": 1}],
    ids=["not square", "N = 1", "M < J", "M = 1"],
)
@pytest.mark.parametrize("more", [{}, {"beamforming": "rzf"}, {"ris": "closed_form"}, {"ris": "optimised"}])
def test_odd_sizes_are_allowed(scenario, more):
    evaluation = result(WORDS | {"scenario": {"preset": "physical_small"} | scenario} | more)
    assert all(math.isfinite(rate) and rate >= 0 for rate in evaluation.rate_bps)


def test_nobody_is_asked_what_heights_mean_once_that_is_said():
    outside = {"scenario": {"preset": "physical_small", "path_loss": "3gpp", "extrapolate": True}}
    assert math.isfinite(result(WORDS | outside | {"position_enu": [0.0, 0.0, 20.0]}).reward)


PLAIN = {"theta_reflection": [0.0] * 4, "split_angle": [0.5] * 4, "sign": [1] * 4}
HALF = {"theta_reflection": [0.0] * 4, "beta_reflection": [0.6] * 4}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        # Geometry.
        ({"users_enu": [[-20.0, 0.0, 60.0], [0, 0, 60]]}, ["users_enu.0: z = 60 is not scenario.user_height_m (1.5)"]),
        (
            {"position_enu": [50.0, -20.0, 1.5]},
            ["users_enu.1: 0 m from the surface (position_enu), must be at least 1 m"],
        ),
        ({"position_enu": [50.0, -20.0, 2.0]}, ["users_enu.1: 0.5 m from the surface"]),
        (
            {"position_enu": [-1000.0, 0.0, 25.0]},
            ["position_enu: 0 m from the base station, must be at least 1 m"],
        ),
        (
            {"scenario": {"preset": "physical_small", "users": 2, "base_station_enu": [50.0, -20.0, 1.0]}},
            ["users_enu.1: 0.5 m from the base station"],
        ),
        ({"position_enu": [math.nan, 0, 60]}, ["position_enu.0: nan is not allowed", "finite"]),
        ({"position_enu": [0, 0]}, ["position_enu.2: missing"]),
        ({"position_enu": [0, 0, 60, 1]}, ["position_enu", "at most 3 items"]),
        ({"position_enu": "here"}, ["position_enu: 'here' is not allowed", "should be a list"]),
        ({"position_enu": None}, ["position_enu: missing"]),
        ({"users_enu": [[0.0, math.inf, 1.5], [1, 1, 1.5]]}, ["users_enu.0.1: inf is not allowed", "finite"]),
        ({"users_enu": []}, ["users_enu: [] is not allowed", "at least 1 item"]),
        ({"users_enu": [[9.0, 9.0, 1.5]]}, ["users_enu: 1 positions, but scenario.users is 2"]),
        ({"users_enu": {"a": 1}}, ["users_enu", "should be a list"]),
        ({"velocity_enu": [math.nan, 0, 0]}, ["velocity_enu.0: nan"]),
        ({"velocity_enu": [2000, 0, 0]}, ["velocity_enu.0: 2000", "less than or equal to 1000"]),
        ({"attitude_rad": [0, 0, 90]}, ["attitude_rad.2: 90 is not allowed", "6.28"]),
        ({"attitude_rad": [0, 0, "1"]}, ["attitude_rad.2: '1' is not allowed", "number"]),
        (
            {"scenario": {"preset": "physical_small", "users": 2, "path_loss": "3gpp"}, "position_enu": [0, 0, 22.5]},
            ["position_enu: z = 22.5", "(22.5, 300]", "path_loss.bs_ris tr36777_uma_av", "extrapolate: true"],
        ),
        (
            {"scenario": {"preset": "physical_small", "users": 2, "path_loss": "3gpp"}, "position_enu": [0, 0, 301]},
            ["position_enu: z = 301", "tr36777_uma_av"],
        ),
        (
            {"scenario": {"preset": "physical_small", "path_loss": {"bs_user": "tr38901_uma"}, "user_height_m": 14}},
            ["scenario.user_height_m: 14", "1.5 to 13", "tr38901_uma", "extrapolate: true"],
        ),
        # Scenario.
        ({"scenario": None}, ["scenario: missing"]),
        ({"scenario": "physical_big"}, ["scenario: 'physical_big' is not one of", "physical_small"]),
        ({"scenario": {"preset": "physical_big"}}, ["scenario.preset: 'physical_big' is not one of"]),
        ({"scenario": {"users": 0}}, ["scenario.users: 0", "greater than or equal to 1"]),
        ({"scenario": {"users": "2"}}, ["scenario.users: '2' is not allowed", "integer"]),
        ({"scenario": {"uzers": 2}}, ["scenario.uzers: unknown key, did you mean users"]),
        (
            {"scenario": {"path_loss": {"bs_rs": "paper"}}},
            ["scenario.path_loss.bs_rs: unknown key, did you mean bs_ris"],
        ),
        ({"scenario": 3}, ["scenario: 3 must be a preset's name or a mapping"]),
        ({"seed": -1}, ["seed: -1", "greater than or equal to 0"]),
        ({"seed": 1.5}, ["seed: 1.5", "integer"]),
        ({"sed": 1}, ["sed: unknown key, did you mean seed?"]),
        ({"xyzzy": 1}, ["xyzzy: unknown key, allowed are scenario, seed, position_enu"]),
        ({1: 2}, ["1: 1 is not allowed", "string"]),
        # Coefficients.
        ({"trc": PLAIN | {"sign": [1, 1, 0, 1]}}, ["trc.sign", "must be -1 or 1"]),
        ({"trc": PLAIN | {"sign": [1, 1, True, 1]}}, ["trc.sign.2: True", "integer"]),
        ({"trc": PLAIN | {"sign": [1, 1]}}, ["trc.sign: 2 values, must be 4, one for each element"]),
        ({"trc": PLAIN | {"split_angle": [0.5, 0.5, 0.5, 1.6]}}, ["trc.split_angle: 1.6 is outside [0, pi/2]"]),
        ({"trc": PLAIN | {"theta_reflection": [4.0] * 4}}, ["trc.theta_reflection: 4 is outside [-pi, pi]"]),
        ({"trc": PLAIN | {"theta_reflection": [90] * 4}}, ["trc.theta_reflection.0: 90", "6.28"]),
        ({"trc": PLAIN | {"theta_reflection": [math.nan] * 4}}, ["trc.theta_reflection.0: nan", "(and 3 more)"]),
        ({"trc": PLAIN | {"theta_transmission": [0.0] * 4}}, ["trc.theta_transmission: must be empty", "coupled"]),
        (
            {"trc": {"theta_reflection": [0.0] * 4}},
            ["trc: theta_reflection given; surface coupled takes", "split_angle, sign"],
        ),
        ({"trc": {}}, ["trc: nothing given; surface coupled takes theta_reflection, split_angle, sign; or"]),
        ({"trc": PLAIN | {"beta_reflection": [1.0] * 4}}, ["trc: beta_reflection, sign, split_angle", "takes"]),
        ({"trc": {"thta_reflection": [0.0]}}, ["trc.thta_reflection: unknown key, did you mean theta_reflection"]),
        ({"trc": "best"}, ["trc: 'best' is not allowed", "dictionary"]),
        (
            {"trc": HALF | {"beta_transmission": [0.8, 0.8, 0.5, 0.8], "theta_transmission": [math.pi / 2] * 4}},
            ["trc: |beta_R|^2 + |beta_T|^2 = 0.61 at element 2, must be 1"],
        ),
        (
            {"trc": HALF | {"beta_transmission": [0.8] * 4, "theta_transmission": [1.5708, -1.5708, 4.71239, 1.0]}},
            ["trc: theta_T - theta_R = 1 rad at element 3, must be +-pi/2 on surface coupled"],
        ),
        (
            {"trc": HALF | {"beta_transmission": [-0.8] * 4, "theta_transmission": [1.5708] * 4}},
            ["trc.beta_transmission.0: -0.8", "greater than or equal to 0"],
        ),
        (
            {"trc": {"reflection": [[1.0, 0.0]] * 4, "transmission": [[0.0, 0.1]] * 4}},
            ["trc: |beta_R|^2 + |beta_T|^2 = 1.01 at element 0, must be 1"],
        ),
        (
            {"trc": {"reflection": [[0.6, 0.0]] * 4, "transmission": [[0.8, 0.0]] * 4}},
            ["trc: theta_T - theta_R = 0 rad at element 0, must be +-pi/2"],
        ),
        (
            {"trc": {"reflection": [0.6] * 4, "transmission": [[0.8, 0]] * 4}},
            ["trc.reflection.0: 0.6 must be [re, im]"],
        ),
        (
            {"trc": {"reflection": [[1.0, 0.0]] * 3, "transmission": [[0.0, 0.0]] * 4}},
            ["trc.reflection: 3 values, must be 4"],
        ),
        (
            {"scenario": EXAMPLE["scenario"] | {"surface": "conventional"}, "trc": PLAIN},
            ["trc.split_angle: 0.5 of element 0, which has 1.5708 fixed"],
        ),
        (
            {
                "scenario": EXAMPLE["scenario"] | {"surface": "dual"},
                "trc": {"reflection": [[1.0, 0.0]] * 4, "transmission": [[0.0, 0.0]] * 4},
            },
            ["trc: as angles, split_angle: 1.5708 of element 1, which has 0 fixed"],
        ),
        (
            {"scenario": EXAMPLE["scenario"] | {"phase_bits": 1}, "trc": PLAIN | {"theta_reflection": [0.3] * 4}},
            ["trc.theta_reflection: 0.3 is not one of the 2 phases of 1 bits"],
        ),
        (
            {"scenario": EXAMPLE["scenario"] | {"surface": "independent"}, "trc": PLAIN},
            ["surface independent takes theta_reflection, split_angle, theta_transmission"],
        ),
        # Who sets the surface.
        ({"ris": "closed_form"}, ["trc: not allowed with ris 'closed_form', which sets it; leave out one"]),
        ({"ris": "optimised", "trc": None}, ["beamforming: not allowed with ris 'optimised'"]),
        ({"ris": "best"}, ["ris.mode: 'best' is not allowed", "'closed_form'", "'optimised'"]),
        ({"ris": {"iteration": 3}}, ["ris.iteration: unknown key, did you mean iterations?"]),
        (
            {"ris": "closed_form", "scenario": EXAMPLE["scenario"] | {"sinr": "amplitude"}},
            ["ris.mode: 'closed_form' is not allowed with scenario.sinr 'amplitude'"],
        ),
        # Beams.
        ({"beamforming": "zf"}, ["beamforming: 'zf' is not allowed", "'identity' or 'rzf'"]),
        ({"beamforming": 3}, ["beamforming: 3 is not allowed", "should be a list"]),
        ({"beamforming": [[0.1, 0.2], [0.3, 0.4]]}, ["beamforming.0.0: 0.1 must be [re, im]"]),
        ({"beamforming": [[[0.1, "0"]] * 2] * 2}, ["beamforming.0.0.1: '0' is not allowed", "number"]),
        ({"beamforming": [[[0.1, 0]] * 3] * 2}, ["beamforming: 2 x 3, must be M x J = 2 x 2 of [re, im]"]),
        ({"beamforming": [[[0.1, 0]], [[0.1, 0]] * 2]}, ["beamforming: 2 x 1/2, must be M x J = 2 x 2"]),
        ({"beamforming": []}, ["beamforming: 0 x 0, must be M x J = 2 x 2"]),
        ({"beamforming": [[[1.0, 0]] * 2] * 2}, ["beamforming: 4 W in all is above p_max (0.794328 W)"]),
        ({"beamforming": [[[math.nan, 0]] * 2] * 2}, ["beamforming.0.0.0: nan is not allowed", "finite"]),
        # Channels.
        ({"channels": {"direct": []}}, ["channels.bs_ris: missing (and 1 more)"]),
        (
            {"channels": {"direct": [[[1, 0]] * 2] * 2, "bs_ris": [[[1, 0]] * 2] * 3, "ris_user": [[[1, 0]] * 4] * 2}},
            ["channels.bs_ris: 3 x 2, must be N x M = 4 x 2 of [re, im]"],
        ),
        (
            {
                "channels": {
                    "direct": [[[1, 0]] * 2] * 2,
                    "bs_ris": [[[1, 0]] * 2] * 4,
                    "ris_user": [[[1e300, 0]] * 4] * 2,
                }
            },
            ["channels.ris_user.0.0.0: 1e+300", "less than or equal to 1000000"],
        ),
        ({"channels": {"drect": []}}, ["channels.drect: unknown key, did you mean direct?"]),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_that_names_it(changes, words):
    with pytest.raises(SnapshotError) as caught:
        result(changed(EXAMPLE, **changes) if all(isinstance(name, str) for name in changes) else EXAMPLE | changes)
    line = str(caught.value)
    assert "\n" not in line
    for word in words:
        assert word in line, line


@pytest.mark.parametrize("fields", [None, [], "physical_small", 3])
def test_what_is_no_mapping_is_refused(fields):
    with pytest.raises(SnapshotError, match="dictionary"):
        read_snapshot(fields)


def test_results_too_large_for_numbers_are_no_results():
    wide = {"preset": "physical_small", "users": 1, "bandwidth_hz": 1e308, "noise": "total", "p_max_dbm": 100}
    with pytest.raises(SnapshotError, match="not finite"):
        result(WORDS | {"scenario": wide, "users_enu": USERS[:1]})


def test_closed_form_of_a_snapshot_is_the_references():
    snapshot = read_snapshot(WORDS | {"ris": "closed_form", "seed": 9})
    told = evaluate(snapshot)
    from rf_model.channels import draw_channels

    channels = draw_channels(
        snapshot.scenario,
        torch.tensor(snapshot.position_enu, dtype=torch.float64),
        torch.tensor(0.0, dtype=torch.float64),
        torch.tensor(snapshot.users_enu, dtype=torch.float64),
        torch.Generator().manual_seed(9),
    )
    solution = closed_form(snapshot.scenario, channels)
    np.testing.assert_allclose(told.beamforming, torch.view_as_real(solution.beamforming).tolist())
    assert told.fair_rate_bps == pytest.approx(solution.utility_bps[-1].item(), rel=1e-9)
