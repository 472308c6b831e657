"""The radio world slot by slot, without a bus: one configuration and one report for each slot, whatever comes in."""

import math

import numpy as np
import pytest
import torch

from airframe.power import total_power
from bus.messages import Action, ChannelState, FlownSlot, LinkReport, RisConfiguration, SlotOpened, TrackSample
from bus.topics import encode
from rf_model import slot_radio
from rf_model.channels import Channels
from rf_model.reference.solve import ReferenceInputError, closed_form, solve
from rf_model.ris_control import RisControl, RisControlError
from rf_model.scenario import preset
from rf_model.slot_radio import SlotRadio

SCENARIO = preset("physical_small")
N, M, J = SCENARIO.elements, SCENARIO.antennas, SCENARIO.users


def flown(slot, outcome="flown", velocity=(4.0, 0.0, 0.0)) -> FlownSlot:
    track = [
        TrackSample(time_s=100.0 + slot + i / 10, position_enu=(0.4 * i, 0.0, 60.0), velocity_enu=velocity)
        for i in range(11)
    ]
    zero = (0.0, 0.0, 0.0)
    return FlownSlot(
        slot=slot,
        outcome=outcome,
        reasons=[],
        commanded_enu=(4.0, 0.0, 0.0),
        planned_enu=(4.0, 0.0, 0.0),
        flown_enu=zero,
        track=track,
        plan=[],
    )


def opened(slot, outcome="flown", closing=False, **changes) -> SlotOpened:
    fields = {
        "slot": slot,
        "slots": 30,
        "time_s": 100.0 + slot,
        "position_enu": (4.0 * slot, 0.0, 60.0),
        "velocity_enu": (0.0, 0.0, 0.0),
        "attitude_rad": (0.0, 0.0, 0.0),
        "closing": closing,
        "flown": flown(slot - 1, outcome) if slot else None,
    }
    return SlotOpened(**(fields | changes))


def action(slot, seed=0, **changes) -> Action:
    rng = np.random.default_rng((seed, slot))
    W = rng.standard_normal((M, J, 2))
    W *= math.sqrt(SCENARIO.p_max_w / (W**2).sum())
    fields = {
        "slot": slot,
        "time_s": 100.0 + slot,
        "source": "test",
        "displacement_enu": (4.0, 0.0, 0.0),
        "theta_reflection": rng.uniform(-math.pi, math.pi, N).tolist(),
        "split_angle": rng.uniform(0, math.pi / 2, N).tolist(),
        "sign": rng.choice([-1, 1], N).tolist(),
        "beamforming": [[tuple(c) for c in row] for row in W.tolist()],
        "raw": [],
    }
    return Action(**(fields | changes))


def kinds(messages):
    return [type(message) for message in messages]


def fly(radio, slots=4):
    """A whole flight; the messages that came out."""
    out = []
    for k in range(slots):
        out += radio.open(opened(k))
        out += radio.apply(action(k))
    return out + radio.open(opened(slots, closing=True))


def test_a_flight_gives_one_of_each_for_every_slot():
    messages = fly(SlotRadio(SCENARIO, 1))
    for kind in (ChannelState, RisConfiguration, LinkReport):
        assert [m.slot for m in messages if isinstance(m, kind)] == [0, 1, 2, 3]
    assert {m.source for m in messages if isinstance(m, RisConfiguration)} == {"action"}


def test_same_seed_same_flight_bit_for_bit_and_another_seed_another():
    first, again, other = (fly(SlotRadio(SCENARIO, seed)) for seed in (1, 1, 2))
    assert [encode(m) for m in first] == [encode(m) for m in again]
    assert encode(first[0]) != encode(other[0])


def test_restarted_world_has_the_same_users_and_channels():
    flight = fly(SlotRadio(SCENARIO, 1))
    restarted = SlotRadio(SCENARIO, 1)
    csi = restarted.open(opened(3))
    assert [encode(m) for m in csi] == [encode(m) for m in flight if isinstance(m, ChannelState) and m.slot == 3]


def test_a_world_flown_before_gives_the_same_flight_again():
    radio = SlotRadio(SCENARIO, 1)
    assert [encode(m) for m in fly(radio)] == [encode(m) for m in fly(radio)]


def test_channels_have_the_shapes_of_the_contract():
    (csi,) = SlotRadio(SCENARIO, 1).open(opened(0))
    assert (len(csi.direct), len(csi.direct[0])) == (J, M)
    assert (len(csi.bs_ris), len(csi.bs_ris[0])) == (N, M)
    assert (len(csi.ris_user), len(csi.ris_user[0])) == (J, N)
    assert csi.regions == ["reflection", "reflection", "transmission", "transmission"]
    assert (csi.time_s, csi.position_enu) == (100.0, (0.0, 0.0, 60.0))


def test_configuration_is_the_action_with_both_sides():
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    sent = action(0)
    (configuration,) = radio.apply(sent)
    assert configuration.source == "action"
    for field in ("theta_reflection", "split_angle", "sign", "beamforming"):
        assert getattr(configuration, field) == getattr(sent, field)
    for n in range(N):
        difference = configuration.theta_transmission[n] - configuration.theta_reflection[n]
        assert math.sin(difference) == pytest.approx(sent.sign[n])
        assert configuration.beta_reflection[n] == pytest.approx(math.sin(sent.split_angle[n]))
        assert configuration.beta_transmission[n] == pytest.approx(math.cos(sent.split_angle[n]))


def test_report_is_worth_the_configured_channels_and_the_flown_track():
    radio = SlotRadio(SCENARIO, 1)
    (csi,) = radio.open(opened(0))
    (configuration,) = radio.apply(action(0))
    report, _ = radio.open(opened(1))
    h_b, H, h_s, W = (np.array(x) @ [1, 1j] for x in (csi.direct, csi.bs_ris, csi.ris_user, configuration.beamforming))
    for j in range(J):
        side = csi.regions[j]
        theta, beta = getattr(configuration, f"theta_{side}"), getattr(configuration, f"beta_{side}")
        g = h_b[j] + (h_s[j] * beta * np.exp(1j * np.array(theta))) @ H
        power = np.abs(g @ W) ** 2
        gamma = power[j] / (power.sum() - power[j] + SCENARIO.noise_w)
        assert report.sinr[j] == pytest.approx(gamma, rel=1e-9)
        assert report.rate_bps[j] == pytest.approx(1e6 * math.log2(1 + gamma), rel=1e-9)
        assert report.below_qos[j] == (report.rate_bps[j] < 200e3)
    watts = total_power(SCENARIO.wing, SCENARIO.panel, 4.0, 0.0, 0.0, 1.0, 0.0)
    assert report.power_w == pytest.approx(watts)
    assert report.energy_j == pytest.approx(watts * 1.0)
    fair = J**2 / sum(1 / r for r in report.rate_bps)
    assert report.fair_rate_bps == pytest.approx(fair)
    assert report.reward == pytest.approx(fair / 1e6 - 0.1 * watts / SCENARIO.hover_power_w)
    assert (report.slot, report.configuration, report.position_enu) == (0, "action", (0.0, 0.0, 60.0))
    assert report.users_enu == csi.users_enu


def test_power_is_the_mean_over_an_uneven_track():
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    speeds = {100.0: 0.0, 100.5: 0.0, 101.0: 8.0}
    track = [
        TrackSample(time_s=t, position_enu=(0.0, 0.0, 60.0), velocity_enu=(v, 0.0, 0.0)) for t, v in speeds.items()
    ]
    fields = {name: getattr(flown(0), name) for name in FlownSlot.__struct_fields__} | {"track": track}
    _, report, _ = radio.open(opened(1, flown=FlownSlot(**fields)))
    hover, fast = (total_power(SCENARIO.wing, SCENARIO.panel, v, 0.0, 0.0, 1.0, 0.0) for v in (0.0, 8.0))
    assert report.power_w == pytest.approx(0.75 * hover + 0.25 * fast)


def test_without_actions_the_neutral_configuration_is_in_force():
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    configuration, report, csi = radio.open(opened(1, "missing"))
    assert kinds([configuration, report, csi]) == [RisConfiguration, LinkReport, ChannelState]
    assert (configuration.slot, configuration.source, report.configuration) == (0, "default", "default")
    assert configuration.theta_reflection == [0.0] * N
    assert configuration.split_angle == pytest.approx([math.pi / 4] * N)
    W = np.array(configuration.beamforming) @ [1, 1j]
    assert pytest.approx(np.eye(4) * math.sqrt(SCENARIO.p_max_w / 4)) == W


def test_missing_action_holds_the_last_configuration():
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    (first,) = radio.apply(action(0))
    radio.open(opened(1))
    held, report, _ = radio.open(opened(2, "missing"))
    assert (held.slot, held.source, report.configuration) == (1, "held", "held")
    assert held.theta_reflection == first.theta_reflection
    assert held.beamforming == first.beamforming


BAD = {
    "too few phases": {"theta_reflection": [0.0] * (N - 1)},
    "phase out of range": {"theta_reflection": [4.0] * N},
    "NaN": {"theta_reflection": [math.nan] * N},
    "infinite split": {"split_angle": [math.inf] * N},
    "negative split": {"split_angle": [-0.1] * N},
    "sign of zero": {"sign": [0] * N},
    "too few signs": {"sign": []},
    "too much power": {"beamforming": [[(1.0, 0.0)] * J] * M},
    "NaN beam": {"beamforming": [[(math.nan, 0.0)] * J] * M},
    "missing antenna": {"beamforming": [[(0.0, 0.0)] * J] * (M - 1)},
    "missing stream": {"beamforming": [[(0.0, 0.0)] * (J - 1)] * M},
    "ragged beams": {"beamforming": [[(0.0, 0.0)] * J] * (M - 1) + [[]]},
    "no beams": {"beamforming": []},
}


@pytest.mark.parametrize("changes", BAD.values(), ids=BAD.keys())
def test_bad_action_is_counted_and_the_last_configuration_held(changes):
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    (good,) = radio.apply(action(0))
    radio.open(opened(1))
    (held,) = radio.apply(action(1, **changes))
    assert (held.source, held.slot) == ("held", 1)
    assert held.theta_reflection == good.theta_reflection
    assert radio.counters["rejected"] == 1
    (reason,) = radio.rejections
    assert next(iter(changes)) in reason
    assert "\n" not in reason
    report, _ = radio.open(opened(2, "rejected"))
    assert report.configuration == "held"


def test_actions_of_other_slots_and_second_ones_change_nothing():
    radio = SlotRadio(SCENARIO, 1)
    assert radio.apply(action(0)) == []
    radio.open(opened(0))
    assert radio.apply(action(1)) == []
    radio.apply(action(0))
    assert radio.apply(action(0, seed=9)) == []
    radio.open(opened(1))
    assert radio.apply(action(0)) == []
    assert radio.counters["stray"] == 4
    assert radio.counters["applied"] == 1


@pytest.mark.parametrize(("outcome", "source"), [("late", "default"), ("missing", "default"), ("clipped", "action")])
def test_the_bridge_says_whether_an_action_that_seems_late_was_in_time(outcome, source):
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    assert radio.apply(action(0), late=True) == []
    assert not radio.must_wait(opened(1, outcome))
    configuration, report, _ = radio.open(opened(1, outcome))
    assert (configuration.source, report.configuration) == (source, source)
    assert radio.counters["late"] == (source == "default")


@pytest.mark.parametrize(
    ("outcome", "waits"), [("flown", True), ("clipped", True), ("rejected", True), ("missing", False), ("late", False)]
)
def test_waits_only_for_an_action_that_the_bridge_got(outcome, waits):
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    assert radio.must_wait(opened(1, outcome)) == waits
    radio.apply(action(0))
    assert not radio.must_wait(opened(1, outcome))


def test_lost_slot_still_closes_the_open_one():
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    radio.apply(action(0))
    report, csi = radio.open(opened(3))
    assert (report.slot, csi.slot) == (0, 3)
    hover = SCENARIO.hover_power_w  # at rest at both openings; nobody said what was flown in between
    assert (report.power_w, report.energy_j) == (pytest.approx(hover), pytest.approx(hover * 1.0))
    assert radio.counters["lost_slots"] == 2


def test_repeated_opening_changes_nothing():
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    radio.apply(action(0))
    assert radio.open(opened(0)) == []
    assert kinds(radio.open(opened(1))) == [LinkReport, ChannelState]


def test_new_flight_starts_afresh():
    radio = SlotRadio(SCENARIO, 1)
    first = radio.open(opened(0))
    radio.apply(action(0))
    radio.open(opened(1))
    again = radio.open(opened(0, time_s=500.0))
    assert [m.direct for m in again] == [m.direct for m in first]
    configuration, _, _ = radio.open(opened(1, "missing", time_s=501.0))
    assert configuration.source == "default"


def test_closing_opening_is_answered_by_the_last_report_only():
    radio = SlotRadio(SCENARIO, 1)
    radio.open(opened(0))
    radio.apply(action(0))
    assert kinds(radio.open(opened(1, closing=True))) == [LinkReport]
    assert radio.open(opened(1, closing=True)) == []
    assert radio.apply(action(1)) == []


def test_channels_belong_to_the_positions_told():
    scenario = preset("physical_small", ris_user="los", kappa=1e6)
    radio = SlotRadio(scenario, 1)
    for k in range(3):
        messages = radio.open(opened(k))
    position, user = np.array(messages[-1].position_enu), np.array(messages[-1].users_enu[0])
    h = np.array(messages[-1].ris_user[0]) @ [1, 1j]
    loss_db = 20 * math.log10(5) + 28 + 22 * math.log10(np.linalg.norm(user - position))
    assert np.abs(h) == pytest.approx(10 ** (-loss_db / 20), rel=0.01)


def post(**changes):
    return preset("physical_small", timing="post", **changes)


def test_post_timing_rates_the_configuration_in_the_channels_of_the_next_opening():
    scenario = post()
    radio = SlotRadio(scenario, 1)
    states, reports, configurations = [], [], []
    for k in range(3):
        messages = radio.open(opened(k))
        states += [m for m in messages if isinstance(m, ChannelState)]
        reports += [m for m in messages if isinstance(m, LinkReport)]
        configurations += radio.apply(action(k))
    for slot, report in enumerate(reports):
        state, configuration = states[slot + 1], configurations[slot]
        assert (report.slot, report.users_enu, report.position_enu) == (slot, state.users_enu, state.position_enu)
        for j in range(J):
            assert report.sinr[j] == pytest.approx(sinr_by_hand(state, configuration, j), rel=1e-9)
    (last,) = radio.open(opened(3, closing=True))
    assert last.slot == 2
    pre = [m for m in fly(SlotRadio(SCENARIO, 1), 3) if isinstance(m, LinkReport)]
    assert [m.power_w for m in pre] == [m.power_w for m in [*reports, last]]
    assert all(ours.rate_bps != theirs.rate_bps for ours, theirs in zip([*reports, last], pre, strict=True))


def sinr_by_hand(state, configuration, j) -> float:
    h_b, H, h_s, W = (
        np.array(x) @ [1, 1j] for x in (state.direct, state.bs_ris, state.ris_user, configuration.beamforming)
    )
    side = state.regions[j]
    theta, beta = getattr(configuration, f"theta_{side}"), getattr(configuration, f"beta_{side}")
    g = h_b[j] + (h_s[j] * beta * np.exp(1j * np.array(theta))) @ H
    power = np.abs(g @ W) ** 2
    return power[j] / (power.sum() - power[j] + SCENARIO.noise_w)


def test_imperfect_csi_is_what_is_told_and_not_what_is_rated():
    exact, noisy = SlotRadio(SCENARIO, 1), SlotRadio(preset("physical_small", csi_error_variance=0.5), 1)
    for ours, theirs in zip(fly(exact), fly(noisy), strict=True):
        if isinstance(ours, ChannelState):
            assert ours.bs_ris != theirs.bs_ris
            assert ours.regions == theirs.regions
        else:
            assert encode(ours) == encode(theirs)


def test_stale_csi_is_that_of_earlier_slots():
    exact, stale = SlotRadio(SCENARIO, 1), SlotRadio(preset("physical_small", csi_delay_slots=2), 1)
    told = [[m for m in fly(radio, 5) if isinstance(m, ChannelState)] for radio in (exact, stale)]
    for slot, state in enumerate(told[1]):
        assert state.ris_user == told[0][max(0, slot - 2)].ris_user
        assert state.users_enu == told[0][slot].users_enu


def test_tilt_counts_only_when_it_is_flown():
    tilted = {"attitude_rad": (0.1, -0.2, 0.0)}
    level, flown_tilt = SlotRadio(SCENARIO, 1), SlotRadio(preset("physical_small", attitude="flown"), 1)
    (upright,) = level.open(opened(0))
    assert SlotRadio(SCENARIO, 1).open(opened(0, **tilted))[0].bs_ris == upright.bs_ris
    (turned,) = flown_tilt.open(opened(0, **tilted))
    assert turned.bs_ris != upright.bs_ris
    assert turned.direct == upright.direct


def test_independent_surface_takes_both_phases():
    scenario = preset("physical_small", surface="independent")
    radio = SlotRadio(scenario, 1)
    (state,) = radio.open(opened(0))
    theta = np.random.default_rng(1).uniform(-math.pi, math.pi, N).tolist()
    (configuration,) = radio.apply(action(0, theta_transmission=theta))
    assert configuration.source == "action"
    assert configuration.theta_transmission == theta
    report, _ = radio.open(opened(1))
    for j in range(J):
        assert report.sinr[j] == pytest.approx(sinr_by_hand(state, configuration, j), rel=1e-9)
    (held,) = radio.apply(action(1))
    assert (held.source, held.theta_transmission) == ("held", theta)
    assert "theta_transmission: shape [0], the surface has 16 elements" in radio.rejections[0]


@pytest.mark.parametrize("surface", ["dual", "conventional"])
def test_other_surfaces_start_neutral_and_refuse_what_they_cannot_have(surface):
    radio = SlotRadio(preset("physical_small", surface=surface), 1)
    radio.open(opened(0))
    (default,) = radio.apply(action(0))
    assert default.source == "default"
    assert "split_angle" in radio.rejections[0]
    radio.open(opened(1))
    (good,) = radio.apply(action(1, split_angle=default.split_angle, sign=[1] * N))
    assert good.source == "action"


def test_power_in_wind_is_that_of_the_velocity_through_the_air():
    radio = SlotRadio(preset("physical_small", wind_enu=(4.0, 0.0, 0.0)), 1)
    radio.open(opened(0))
    report, _ = [m for m in radio.open(opened(1)) if not isinstance(m, RisConfiguration)]  # flown at (4, 0, 0)
    assert report.power_w == pytest.approx(SCENARIO.hover_power_w)


BY_ITSELF = ("closed_form", "optimised")


def by_itself(mode, iterations=5):
    return RisControl(mode=mode, iterations=iterations)


def told_channels(state) -> Channels:
    """The channels in a message."""
    direct, bs_ris, ris_user = (
        torch.view_as_complex(torch.tensor(x, dtype=torch.float64))
        for x in (state.direct, state.bs_ris, state.ris_user)
    )
    return Channels(direct, bs_ris, ris_user, torch.tensor([region == "transmission" for region in state.regions]))


@pytest.mark.parametrize("mode", BY_ITSELF)
@pytest.mark.parametrize("phase_bits", [None, 2])
@pytest.mark.parametrize("surface", ["coupled", "independent", "dual", "conventional"])
def test_surface_set_without_an_agent_is_one_that_there_can_be_and_rated_as_told(surface, phase_bits, mode):
    scenario = preset("physical_small", surface=surface, phase_bits=phase_bits)
    radio = SlotRadio(scenario, 1, by_itself(mode))
    configuration, state = radio.open(opened(0))
    assert (kinds([configuration, state]), configuration.source) == ([RisConfiguration, ChannelState], mode)
    reflection, transmission, theta_r, theta_t = (
        np.array(getattr(configuration, name))
        for name in ("beta_reflection", "beta_transmission", "theta_reflection", "theta_transmission")
    )
    assert reflection**2 + transmission**2 == pytest.approx(np.ones(N))
    if surface == "coupled":
        assert np.cos(theta_r - theta_t) == pytest.approx(np.zeros(N), abs=1e-9)
    if surface == "dual":
        assert reflection == pytest.approx(1.0 - np.arange(N) % 2)
    if surface == "conventional":
        assert reflection == pytest.approx(np.ones(N))
    if phase_bits:
        steps = theta_r / (math.pi / 2)
        assert steps == pytest.approx(np.round(steps), abs=1e-9)
    power = np.sum(np.array(configuration.beamforming) ** 2)
    assert power <= scenario.p_max_w * (1 + 1e-6)
    report, *_ = radio.open(opened(1))
    assert (report.slot, report.configuration) == (0, mode)
    for j in range(J):
        assert report.sinr[j] == pytest.approx(sinr_by_hand(state, configuration, j), rel=1e-9)


@pytest.mark.parametrize("csi", [{}, {"csi_error_variance": 0.3, "csi_delay_slots": 1}], ids=["exact", "imperfect"])
def test_it_is_the_reference_for_the_channels_told(csi):
    scenario = preset("physical_small", **csi)
    for mode in BY_ITSELF:
        for message in fly(SlotRadio(scenario, 1, by_itself(mode))):
            if isinstance(message, RisConfiguration):
                configuration = message
            if isinstance(message, ChannelState):
                channels = told_channels(message)
                best = closed_form(scenario, channels) if mode == "closed_form" else solve(scenario, channels, 5)
                assert configuration.slot == message.slot
                assert configuration.theta_reflection == pytest.approx(best.trc.theta_reflection.tolist(), abs=1e-9)
                beams = np.array(configuration.beamforming) @ [1, 1j]
                assert beams == pytest.approx(best.beamforming.numpy(), abs=1e-9)


def test_more_iterations_are_worth_more():
    def fair(ris):
        return sum(m.fair_rate_bps for m in fly(SlotRadio(SCENARIO, 1, ris)) if isinstance(m, LinkReport))

    closed, few, many = (
        fair(by_itself("closed_form")),
        fair(by_itself("optimised", 3)),
        fair(by_itself("optimised", 40)),
    )
    assert fair(RisControl()) < closed < few < many


@pytest.mark.parametrize("mode", BY_ITSELF)
def test_without_an_agent_a_flight_still_has_one_of_each(mode):
    radio = SlotRadio(SCENARIO, 1, by_itself(mode))
    messages = [m for k in range(4) for m in radio.open(opened(k, "missing"))]
    messages += radio.open(opened(4, "missing", closing=True))
    for kind in (ChannelState, RisConfiguration, LinkReport):
        assert [m.slot for m in messages if isinstance(m, kind)] == [0, 1, 2, 3]
    assert {m.source for m in messages if isinstance(m, RisConfiguration)} == {mode}
    assert {m.configuration for m in messages if isinstance(m, LinkReport)} == {mode}
    assert (radio.counters[mode], radio.rejections) == (4, [])


@pytest.mark.parametrize("mode", BY_ITSELF)
def test_actions_do_not_set_a_surface_that_is_set_without_them(mode):
    left_alone, acted_on = (SlotRadio(SCENARIO, 1, by_itself(mode)) for _ in range(2))
    for k in range(3):
        assert [encode(m) for m in acted_on.open(opened(k))] == [encode(m) for m in left_alone.open(opened(k))]
        assert acted_on.apply(action(k, theta_reflection=[math.nan])) == []
        assert acted_on.apply(action(k)) == []
        assert not acted_on.must_wait(opened(k + 1, "flown"))
    assert acted_on.counters["stray"] == 6
    assert acted_on.rejections == []


def test_users_and_channels_are_the_same_whoever_sets_the_surface():
    flights = [fly(SlotRadio(SCENARIO, 1, RisControl(mode=mode))) for mode in ("agent", *BY_ITSELF)]
    states = [[encode(m) for m in flight if isinstance(m, ChannelState)] for flight in flights]
    assert states[0] == states[1] == states[2]


@pytest.mark.parametrize("mode", BY_ITSELF)
def test_a_surface_set_without_an_agent_is_the_same_again_also_after_a_restart(mode):
    first, again = (fly(SlotRadio(SCENARIO, 1, by_itself(mode))) for _ in range(2))
    assert [encode(m) for m in first] == [encode(m) for m in again]
    restarted = SlotRadio(SCENARIO, 1, by_itself(mode)).open(opened(3))
    assert [encode(m) for m in restarted] == [encode(m) for m in first if m.slot == 3 and not isinstance(m, LinkReport)]


def test_post_timing_rates_what_was_set_at_the_opening():
    radio = SlotRadio(post(), 1, by_itself("closed_form"))
    configuration, _ = radio.open(opened(0))
    report, _, state = radio.open(opened(1))
    for j in range(J):
        assert report.sinr[j] == pytest.approx(sinr_by_hand(state, configuration, j), rel=1e-9)
    assert kinds(radio.open(opened(2, closing=True))) == [LinkReport]


def test_what_the_reference_cannot_solve_is_counted_and_the_last_configuration_held(monkeypatch):
    """Positions on the bus are finite, and no finite one was found whose channels are not: the fault is injected."""
    radio = SlotRadio(SCENARIO, 1, by_itself("closed_form"))
    first, _ = radio.open(opened(0))
    with monkeypatch.context() as broken:

        def refuse(*_):
            raise ReferenceInputError("direct: not finite")

        broken.setattr(slot_radio, "reference_solution", refuse)
        report, held, _ = radio.open(opened(1))
    assert (report.configuration, held.source, held.slot) == ("closed_form", "held", 1)
    assert held.theta_reflection == first.theta_reflection
    assert radio.rejections == ["closed_form of slot 1: direct: not finite"]
    assert radio.counters["unsolved"] == 1
    report, after, _ = radio.open(opened(2))
    assert (report.configuration, after.source) == ("held", "closed_form")


@pytest.mark.parametrize("mode", BY_ITSELF)
def test_the_paper_s_sinr_by_amplitudes_cannot_be_optimised(mode):
    with pytest.raises(RisControlError, match=r"ris\.mode: '\w+' is not allowed with scenario\.sinr 'amplitude'"):
        SlotRadio(preset("physical_small", sinr="amplitude"), 1, RisControl(mode=mode))
