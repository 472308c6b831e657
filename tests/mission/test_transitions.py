"""Transitions rebuilt from the messages of a flight; from a real flight's recording in tests/e2e."""

import math

import pytest
import torch
import yaml

from agent.decoding import action_size, decode
from agent.observation import Normalisation, ends, observe_message
from bus import messages as m
from mission import mission_file
from mission.transitions import rebuilt
from rf_model.slot_radio import SlotRadio

SLOTS = 4


def mission_of(tmp_path, seed=7, **fields):
    scenario = {"preset": "physical_small", "rows": 2, "columns": 3, "slots": SLOTS} | fields
    path = tmp_path / f"{seed}.yaml"
    path.write_text(yaml.safe_dump({"name": "test", "seed": seed, "scenario": scenario, "policy": {"kind": "random"}}))
    return mission_file.load(path)


def opening(slot, planned):
    """The vehicle flies 1 m east a slot, at a speed that changes."""
    track = [
        m.TrackSample(
            time_s=slot - 1 + step / 10, position_enu=(slot - 1 + step / 10, 0, 60), velocity_enu=(step, 1, 0.5)
        )
        for step in range(11)
    ]
    flown = (
        m.FlownSlot(
            slot=slot - 1,
            outcome="flown",
            reasons=[],
            commanded_enu=planned[slot - 1],
            planned_enu=planned[slot - 1],
            flown_enu=(1.0, 0.0, 0.0),
            track=track,
            plan=track,
        )
        if slot
        else None
    )
    return m.SlotOpened(
        slot=slot,
        slots=SLOTS,
        time_s=float(slot),
        position_enu=(float(slot), 0.0, 60.0),
        velocity_enu=(1.0, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.1),
        closing=slot == SLOTS,
        flown=flown,
    )


def complex_rows(matrix):
    return [[(re, im) for re, im in row] for row in torch.view_as_real(matrix).tolist()]


def flight(mission, beam_scale=1.0):
    """Openings, channels seen, configurations and reports by slot, as the rf node has them; and what was decided."""
    scenario = mission.scenario
    raws = torch.rand(SLOTS, action_size(scenario), generator=torch.Generator().manual_seed(1)).double() * 1.8 - 0.9
    actions = [decode(raw, scenario) for raw in raws]
    planned = [tuple(action.displacement_enu.tolist()) for action in actions]
    openings = {slot: opening(slot, planned) for slot in range(SLOTS + 1)}
    radio = SlotRadio(scenario, mission.seed)
    said = {m.ChannelState: {}, m.RisConfiguration: {}, m.LinkReport: {}}
    for slot, opened in openings.items():
        messages = radio.open(opened)
        if slot < SLOTS:
            action = actions[slot]
            trc = action.trc
            messages += radio.apply(
                m.Action(
                    slot=slot,
                    time_s=opened.time_s,
                    source="test",
                    raw=[],
                    displacement_enu=planned[slot],
                    theta_reflection=trc.theta_reflection.tolist(),
                    split_angle=trc.split_angle.tolist(),
                    sign=[int(sign) for sign in trc.sign.tolist()],
                    theta_transmission=trc.theta_transmission.tolist() if scenario.surface == "independent" else [],
                    beamforming=complex_rows(action.beamforming * beam_scale),
                )
            )
        for message in messages:
            said[type(message)][message.slot] = message
    return openings, said[m.ChannelState], said[m.RisConfiguration], said[m.LinkReport], actions


@pytest.mark.parametrize(
    "fields",
    [
        {},
        {"timing": "post"},
        {"surface": "independent", "motion": "spherical"},
        {"surface": "dual"},
        {"surface": "conventional", "phase_bits": 1},
        {"phase_bits": 2},
        {"element_loss_db": 2.0},
        {"csi_error_variance": 0.2},
        {"csi_delay_slots": 2},
        {"csi_error_variance": 0.2, "csi_delay_slots": 1, "timing": "post"},
        {"state_extra": ["users", "time"]},
    ],
    ids=str,
)
def test_every_slot_is_rebuilt_with_what_was_done_and_the_reward_that_was_reported(tmp_path, fields):
    mission = mission_of(tmp_path, **fields)
    openings, seen, configurations, reports, actions = flight(mission)
    rows = rebuilt(mission, openings, seen, configurations)
    assert [row.slot for row in rows] == list(range(SLOTS))
    for row, following in zip(rows, [*rows[1:], None], strict=True):
        assert row.reward == pytest.approx(reports[row.slot].reward, rel=1e-12)
        executed, wanted = decode(row.action.double(), mission.scenario), actions[row.slot]
        torch.testing.assert_close(executed.displacement_enu, wanted.displacement_enu, atol=1e-5, rtol=0)
        torch.testing.assert_close(executed.beamforming, wanted.beamforming, atol=1e-5, rtol=0)
        for ours, theirs in zip(executed.trc.coefficients(), wanted.trc.coefficients(), strict=True):
            torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=0)
        if following is not None:
            assert torch.equal(row.next_observation, following.observation)
        if mission.scenario.state_extra:
            assert row.observation[-1] == pytest.approx(row.slot / SLOTS)
            assert ends(row.next_observation) == (row.slot == SLOTS - 1)


def test_an_observation_that_nobody_published_is_drawn_again_as_it_would_have_been(tmp_path):
    mission = mission_of(tmp_path, csi_error_variance=0.2, csi_delay_slots=1)
    openings, seen, configurations, _, _ = flight(mission)
    published = seen.pop(SLOTS - 1)
    del openings[SLOTS]
    last = rebuilt(mission, openings, seen, configurations)[-1]
    assert last.slot == SLOTS - 2
    assert torch.equal(last.next_observation, observe_message(published, Normalisation.of(mission.scenario)))


def test_what_no_raw_action_says_is_left_out(tmp_path):
    """Half the power is no action of an agent's, although the rf node does it."""
    mission = mission_of(tmp_path)
    openings, seen, configurations, reports, _ = flight(mission, beam_scale=math.sqrt(0.5))
    assert {report.configuration for report in reports.values()} == {"action"}
    assert rebuilt(mission, openings, seen, configurations) == []


def test_another_seed_than_the_recorded_one_is_refused(tmp_path):
    openings, seen, configurations, _, _ = flight(mission_of(tmp_path))
    with pytest.raises(ValueError, match="seed: 8 draws other users than the recorded ones, first in slot 0"):
        rebuilt(mission_of(tmp_path, seed=8), openings, seen, configurations)


def test_a_slot_that_was_not_recorded_whole_is_left_out(tmp_path):
    mission = mission_of(tmp_path)
    openings, seen, configurations, _, _ = flight(mission)
    del configurations[1], openings[3]
    assert [row.slot for row in rebuilt(mission, openings, seen, configurations)] == [0, 3]
