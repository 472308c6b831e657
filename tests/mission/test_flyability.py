"""What a flight would have been worth elsewhere, against an evaluation written apart and against closed forms."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from msgspec.structs import replace

from bus import messages as m
from bus import topics
from mission.flight_log import Entry, FlightLog
from mission.flyability import flyability
from mission.mission_file import Mission
from rf_model.channels import draw_fading, faded_channels
from rf_model.geometry import panel_frame
from rf_model.reference.solve import closed_form
from rf_model.reward import reward
from rf_model.seeding import generator_of
from rf_model.slot_radio import SlotRadio
from rf_model.star_ris import Trc
from rf_model.world import slot_rates, track_power

MOVES = [((4.0, 0.0, 0.0), (1.0, 0.5, 0.0)), ((0.0, 8.0, 1.0), (2.0, 2.0, 0.5)), ((-6.0, 0.0, 0.0), (0.5, 1.0, 0.0))]
"""Commanded and planned displacement of each slot."""
START_S = 30.0


def mission(seed=5, scenario=None, **fields):
    return Mission.model_validate(
        {"seed": seed, "slots": 3, "scenario": {"preset": "physical_small"} | (scenario or {})} | fields
    )


def plus(place, displacement):
    return tuple(a + b for a, b in zip(place, displacement, strict=True))


def track(start, displacement, begin_s):
    """Ten samples a second at one velocity."""
    return [
        m.TrackSample(
            time_s=begin_s + i / 10,
            position_enu=plus(start, tuple(i / 10 * d for d in displacement)),
            velocity_enu=displacement,
        )
        for i in range(10)
    ]


STILL = (0.0, 0.0, 0.0)


def openings(flying, moves=MOVES, off=STILL, slip=STILL, attitude=(0.0, 0.0, 0.0), outcome="flown"):
    """A flight that is `off` its plan all the time, and measured as faster by `slip`."""
    place, found = flying.scenario.start_enu, []
    for k in range(len(moves) + 1):
        flown = None
        if k:
            commanded, planned = moves[k - 1]
            start, place = place, plus(place, planned)
            flown = m.FlownSlot(
                slot=k - 1,
                outcome=outcome,
                reasons=[],
                commanded_enu=commanded,
                planned_enu=planned,
                flown_enu=planned,
                track=[
                    replace(sample, velocity_enu=plus(sample.velocity_enu, slip))
                    for sample in track(plus(start, off), planned, START_S + k - 1)
                ],
                plan=track(start, planned, START_S + k - 1),
            )
        found.append(
            m.SlotOpened(
                slot=k,
                slots=len(moves),
                time_s=START_S + k,
                position_enu=plus(place, off),
                velocity_enu=(0.0, 0.0, 0.0),
                attitude_rad=attitude,
                closing=k == len(moves),
                flown=flown,
            )
        )
    return found


def decided(flying, slot):
    """An action of random coefficients and beams."""
    scenario, rng = flying.scenario, np.random.default_rng(slot)
    beams = rng.standard_normal((scenario.antennas, scenario.users, 2))
    beams *= math.sqrt(scenario.p_max_w / (beams**2).sum())
    return m.Action(
        slot=slot,
        time_s=START_S + slot,
        source="test",
        displacement_enu=(0.0, 0.0, 0.0),
        theta_reflection=rng.uniform(-math.pi, math.pi, scenario.elements).tolist(),
        split_angle=rng.uniform(0, math.pi / 2, scenario.elements).tolist(),
        sign=rng.choice([-1, 1], scenario.elements).tolist(),
        beamforming=beams.tolist(),
        raw=[],
    )


def recording(flying, opened, without_action=(), more=()):
    """What a flight's rf node said, recorded."""
    radio = SlotRadio(flying.scenario, flying.seed, flying.ris)
    sent = list(more)
    for slot in opened:
        sent += [slot, *radio.open(slot)]
        if not slot.closing and not flying.ris.by_itself and slot.slot not in without_action:
            action = decided(flying, slot.slot)
            sent += [action, *radio.apply(action)]
    name = {topic.message: topic.name for topic in topics.TOPICS}
    entries = tuple(Entry(name[type(message)], 0.0, topics.encode(message)) for message in sent)
    return FlightLog(Path("flight.mcap"), "t", entries, complete=True, lost_bytes=0)


def evaluated_apart(flying, log, slot, place, attitude, plan):
    """(sum rate, reward, energy) of one slot by the radio model's parts, with the vehicle put somewhere."""
    scenario = flying.scenario
    rated = slot if scenario.timing == "pre" else slot + 1
    set_by = log.by_slot(topics.CONFIGURATION)[slot]
    users = torch.tensor(log.by_slot(topics.LINK)[slot].users_enu, dtype=torch.float64)
    roll, pitch, yaw = torch.tensor(attitude, dtype=torch.float64)
    frame = panel_frame(yaw, roll, pitch)
    fading = draw_fading(scenario, (), generator_of(flying.seed, rated, 1), torch.float64)
    channels = faded_channels(scenario, torch.tensor(place, dtype=torch.float64), frame, users, fading)
    fields = (set_by.theta_reflection, set_by.split_angle, set_by.sign)
    trc = Trc(*(torch.tensor(field, dtype=torch.float64) for field in fields))
    beams = torch.view_as_complex(torch.tensor(set_by.beamforming, dtype=torch.float64))
    rates = slot_rates(scenario, channels, trc, beams)
    time_s = torch.tensor([sample.time_s for sample in plan], dtype=torch.float64)
    velocity = torch.tensor([sample.velocity_enu for sample in plan], dtype=torch.float64)
    power = track_power(scenario, time_s, velocity, yaw)
    return rates.sum_rate_bps.item(), reward(scenario, rates.fair_rate_bps, power).item(), power.item()


def test_a_flight_that_is_its_plan_loses_nothing_at_all():
    flying = mission()
    moves = [(planned, planned) for _, planned in MOVES]
    got = flyability(recording(flying, openings(flying, moves)), flying)
    assert (got.slots, got.difference, got.limits_rms_m, got.tracking_rms_m) == (3, "", 0.0, 0.0)
    for worth in (got.as_set, got.anew):
        for total in (worth.rate_bps, worth.reward):
            assert total.commanded == pytest.approx(total.flown, rel=1e-12)
            assert total.lost_to_tracking == 0.0
            assert total.lost_to_limits == pytest.approx(0.0, abs=1e-9)
            assert total.planned != 0.0
    assert got.energy_j.lost_to_tracking == 0.0
    assert got.energy_j.lost_to_limits == pytest.approx(0.0, abs=1e-9)


def headings(flying, places):
    """Asked for in each place: the panel's, or towards the users' centre unless that is as good as below."""
    found = [flying.scenario.panel_heading_rad]
    for place in places:
        east, north = (there - here for there, here in zip(flying.scenario.user_centre_enu, place, strict=False))
        kept = flying.yaw == "panel" or math.hypot(east, north) <= 2.0
        found.append(found[-1] if kept else math.atan2(north, east))
    return found[1:]


@pytest.mark.parametrize("yaw", ["panel", "face_users"])
@pytest.mark.parametrize("attitude", ["level", "flown"])
@pytest.mark.parametrize("timing", ["pre", "post"])
def test_each_place_is_worth_what_the_radio_models_parts_say(timing, attitude, yaw):
    flying = mission(scenario={"timing": timing, "attitude": attitude, "panel_heading_rad": 0.3}, yaw=yaw)
    off, slip, (roll, pitch, flown_yaw) = (0.4, -0.3, 0.2), (0.7, 0.2, -0.1), (0.1, -0.15, 0.5)
    log = recording(flying, openings(flying, off=off, slip=slip, attitude=(roll, pitch, flown_yaw)))
    planned = [flying.scenario.start_enu]
    for _, move in MOVES:
        planned.append(plus(planned[-1], move))
    commanded = [planned[0], *(plus(start, move) for start, (move, _) in zip(planned, MOVES, strict=False))]
    flown = [plus(place, off) for place in planned]
    tilt = (roll, pitch) if attitude == "flown" else (0.0, 0.0)
    attitudes = {
        "commanded": [(0.0, 0.0, yaw_rad) for yaw_rad in headings(flying, commanded)],
        "planned": [(0.0, 0.0, yaw_rad) for yaw_rad in headings(flying, planned)],
        "flown": [(*tilt, flown_yaw)] * 4,
    }
    got = flyability(log, flying)
    assert got.difference == ""
    for row, (command, plan) in zip(got.by_slot, MOVES, strict=True):
        rated = row.slot if timing == "pre" else row.slot + 1
        for name, places, velocity in (
            ("commanded", commanded, command),
            ("planned", planned, plan),
            ("flown", flown, plus(plan, slip)),
        ):
            way = track(places[row.slot], velocity, 0.0)
            rate, _, _ = evaluated_apart(flying, log, row.slot, places[rated], attitudes[name][rated], way)
            _, _, energy = evaluated_apart(flying, log, row.slot, places[rated], attitudes[name][row.slot], way)
            assert getattr(row.as_set.rate_bps, name) == pytest.approx(rate, rel=1e-9)
            assert getattr(row.energy_j, name) == pytest.approx(energy, rel=1e-9)
        assert row.limits_m == pytest.approx(math.dist(command, plan))
        assert row.tracking_rms_m == pytest.approx(math.hypot(*off))
        assert (row.commanded_m, row.planned_m) == (math.hypot(*command), math.hypot(*plan))


def test_totals_are_those_of_the_slots():
    flying = mission()
    got = flyability(recording(flying, openings(flying, off=(0.0, 0.0, 0.6))), flying)
    rows = got.by_slot
    assert got.limits_rms_m == pytest.approx(math.sqrt(np.mean([math.dist(*move) ** 2 for move in MOVES])))
    assert got.tracking_rms_m == pytest.approx(0.6)
    for worth, slots in ((got.as_set, [row.as_set for row in rows]), (got.anew, [row.anew for row in rows])):
        for name in ("commanded", "planned", "flown"):
            rate, gained = (
                [getattr(number, name) for number in numbers]
                for numbers in ([slot.rate_bps for slot in slots], [slot.reward for slot in slots])
            )
            assert getattr(worth.rate_bps, name) == pytest.approx(sum(rate) / 3)
            assert getattr(worth.reward, name) == pytest.approx(sum(gained))
        for total in (worth.rate_bps, worth.reward):
            assert total.lost_to_limits == pytest.approx(total.commanded - total.planned)
            assert total.lost_to_tracking == pytest.approx(total.planned - total.flown)
    assert got.energy_j.planned == pytest.approx(sum(row.energy_j.planned for row in rows))
    assert got.energy_j.lost_to_limits == pytest.approx(got.energy_j.planned - got.energy_j.commanded), "what was spent"


def test_the_reward_is_that_of_rate_and_power_in_each_place():
    flying = mission()
    log = recording(flying, openings(flying, off=(0.0, 2.0, 0.0)))
    for row in flyability(log, flying).by_slot:
        start = flying.scenario.start_enu
        for _, planned in MOVES[: row.slot]:
            start = plus(start, planned)
        _, worth, _ = evaluated_apart(
            flying, log, row.slot, start, (0.0, 0.0, 0.0), track(start, MOVES[row.slot][1], 0.0)
        )
        assert row.as_set.reward.planned == pytest.approx(worth, rel=1e-9)


@pytest.mark.parametrize("off_m", [1.0, 10.0, 40.0])
def test_a_lone_user_in_sight_loses_what_the_distances_say(off_m):
    """One antenna, one element, no direct link: the SNR falls with both distances (22 dB and 20 dB a decade)."""
    one = {"users": 1, "reflection_users": 1, "antennas": 1, "rows": 1, "columns": 1, "surface": "conventional"}
    sight = {
        "ris_user": "los",
        "direct": "blocked",
        "kappa": 1e6,
        "path_loss": {"bs_ris": "paper", "ris_user": "free_space"},
        "region": "fixed",
    }
    flying = mission(scenario=one | sight)
    still = [((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))] * 3
    log = recording(flying, openings(flying, still, off=(0.0, off_m, 0.0)))
    got = flyability(log, flying)
    scenario, station = flying.scenario, flying.scenario.base_station_enu
    for row, link in zip(got.by_slot, log.by_slot(topics.LINK).values(), strict=True):
        planned, flown = scenario.start_enu, plus(scenario.start_enu, (0.0, off_m, 0.0))
        (user,) = link.users_enu
        gain_db = 22 * math.log10(math.dist(flown, station) / math.dist(planned, station))
        gain_db += 20 * math.log10(math.dist(flown, user) / math.dist(planned, user))
        rate = scenario.bandwidth_hz * math.log2(1 + link.sinr[0] * 10 ** (gain_db / 10))
        assert row.as_set.rate_bps.planned == pytest.approx(rate, rel=2e-3), "0.1 % of the amplitude is scattered"
        assert row.as_set.rate_bps.flown == link.rate_bps[0]
        assert row.anew.rate_bps.planned == pytest.approx(row.as_set.rate_bps.planned), "nothing to align"


def test_set_anew_is_the_closed_form_of_each_place():
    flying = mission()
    log = recording(flying, openings(flying, off=(0.0, 1.0, 0.0)))
    got = flyability(log, flying)
    assert got.anew_by == "closed_form"
    place = flying.scenario.start_enu
    for row, (_, planned) in zip(got.by_slot, MOVES, strict=True):
        users = torch.tensor(log.by_slot(topics.LINK)[row.slot].users_enu, dtype=torch.float64)
        fading = draw_fading(flying.scenario, (), generator_of(flying.seed, row.slot, 1), torch.float64)
        at = torch.tensor(place, dtype=torch.float64)
        channels = faded_channels(flying.scenario, at, panel_frame(torch.zeros(()).double()), users, fading)
        best = closed_form(flying.scenario, channels)
        rates = slot_rates(flying.scenario, channels, best.trc, best.beamforming)
        assert row.anew.rate_bps.planned == pytest.approx(rates.sum_rate_bps.item(), rel=1e-5)
        place = plus(place, planned)


def test_what_set_the_surface_in_flight_sets_it_anew():
    flying = mission(ris="closed_form")
    log = recording(flying, openings(flying, off=(0.0, 3.0, 0.0)))
    got = flyability(log, flying)
    assert (got.difference, got.anew_by) == ("", "closed_form")
    for row, link in zip(got.by_slot, log.by_slot(topics.LINK).values(), strict=True):
        assert row.as_set.rate_bps.flown == row.anew.rate_bps.flown == link.sum_rate_bps
    assert got.as_set.reward.lost_to_tracking < got.anew.reward.lost_to_tracking, "set for the place flown to"


def test_amplitude_sinr_has_no_closed_form():
    flying = mission(scenario={"sinr": "amplitude"})
    got = flyability(recording(flying, openings(flying)), flying)
    assert (got.anew, got.anew_by, got.by_slot[0].anew) == (None, None, None)
    assert got.as_set.rate_bps.flown > 0


def test_a_slot_without_an_action_is_worth_what_was_held_in_it():
    flying = mission()
    log = recording(flying, openings(flying, outcome="missing"), without_action=(0, 2))
    assert [entry.source for entry in log.by_slot(topics.CONFIGURATION).values()] == ["default", "action", "held"]
    got = flyability(log, flying)
    assert got.difference == ""
    assert [row.as_set.rate_bps.flown for row in got.by_slot] == [
        link.sum_rate_bps for link in log.by_slot(topics.LINK).values()
    ]


def test_a_command_that_leads_out_of_the_box_ends_at_its_wall():
    flying = mission(scenario={"box_enu": [[-10, 10], [-10, 10], [30, 120]]})
    out = [((0.0, 30.0, 0.0), (0.0, 4.0, 0.0))]
    got = flyability(recording(flying, openings(flying, out)), flying)
    assert got.by_slot[0].limits_m == 10.0 - 4.0
    _, north, _ = flying.scenario.start_enu
    inside = [((0.0, 10.0 - north, 0.0), (0.0, 4.0, 0.0))]
    same = flyability(recording(flying, openings(flying, inside)), flying)
    assert got.by_slot[0].energy_j == same.by_slot[0].energy_j, "and is paid for as far as it goes"


def test_slots_that_somebody_else_flew_are_left_out():
    flying = mission()
    seized = m.VehicleState(
        time_s=START_S + 1.5,
        position_enu=(0.0, 0.0, 60.0),
        velocity_enu=(0.0, 0.0, 0.0),
        attitude_rad=(0.0, 0.0, 0.0),
        mode="POSCTL",
        armed=True,
        landed=False,
        battery_remaining=None,
        home_lat_lon_alt=None,
        phase="yielded",
    )
    all_of_it = flyability(recording(flying, openings(flying)), flying)
    got = flyability(recording(flying, openings(flying), more=[seized]), flying)
    assert (got.left_out, [row.slot for row in got.by_slot]) == ([1], [0, 2])
    assert got.by_slot[0] == all_of_it.by_slot[0]
    before, after = all_of_it.by_slot[2], got.by_slot[1]
    assert (after.energy_j, after.limits_m, after.tracking_rms_m) == (
        before.energy_j,
        before.limits_m,
        before.tracking_rms_m,
    )
    for old, new in ((before.as_set, after.as_set), (before.anew, after.anew)):
        assert (new.rate_bps.planned, new.rate_bps.flown) == (old.rate_bps.planned, old.rate_bps.flown)
        assert old.rate_bps.commanded != old.rate_bps.planned
        assert new.rate_bps.commanded == pytest.approx(new.rate_bps.planned), "nothing led there but somebody else"


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        ({"seed": 6}, "user 0's kbit/s"),
        ({"scenario": {"kappa": 3.0}}, "user 0's kbit/s"),
        ({"scenario": {"weight_n": 20.0}}, "energy in J"),
    ],
)
def test_a_mission_of_another_world_is_told(changed, what):
    log = recording(mission(), openings(mission()))
    got = flyability(log, mission(**changed))
    assert re.fullmatch(rf"slot 0 was recorded with {what} [\d.]+, this mission makes it [\d.]+", got.difference)
    assert flyability(log, mission()).difference == ""


def test_a_mission_of_another_surface_is_told():
    log = recording(mission(), openings(mission()))
    got = flyability(log, mission(scenario={"rows": 2}))
    assert "the surface has 8 elements" in got.difference


def test_what_was_not_recorded_whole_is_not_evaluated():
    flying = mission()
    opened = openings(flying)
    whole = flyability(recording(flying, opened), flying)
    log = recording(flying, opened)
    cut = replace_entries(log, lambda entry: b'"slot":2,"slots"' not in entry.payload)  # the opening of slot 2
    got = flyability(cut, flying)
    assert [row.slot for row in got.by_slot] == [0]
    assert got.by_slot[0].as_set.rate_bps == whole.by_slot[0].as_set.rate_bps
    assert flyability(replace_entries(log, lambda entry: entry.topic != "slot"), flying) is None


def replace_entries(log, keep):
    return FlightLog(log.path, log.vehicle, tuple(filter(keep, log.entries)), log.complete, log.lost_bytes)
