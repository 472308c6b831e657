"""Scenarios: what the presets mean, what is refused and how it is said."""

import math
import subprocess
import sys

import pytest
from pydantic import ValidationError

from rf_model.scenario import PRESETS, Scenario, ScenarioError, make_scenario, preset


def test_presets_are_the_four_of_the_design():
    assert list(PRESETS) == ["paper_literal", "physical_1km", "physical_small", "prototype_s4"]


SMALL = {"rows": 4, "columns": 4, "group": 4, "ris_gain_db": 42.0, "motion": "cartesian"}


@pytest.mark.parametrize(
    ("name", "switches"),
    [
        ("physical_1km", {}),
        ("physical_small", SMALL),
        (
            "paper_literal",
            {
                "sinr": "amplitude",
                "noise": "density",
                "nlos_height": "uav",
                "ris_user": "nlos",
                "direct_extra_db": 0.0,
                "ris_gain_db": 0.0,
                "array": "literal",
                "induced": "paper",
                "induced_velocity": "paper",
                "climb": "signed",
                "v_perp": "speed",
                "p_max": "per_user",
                "region": "fixed",
                "timing": "post",
                "climb_up_mps": None,
                "climb_down_mps": None,
                "rows": 4,
                "columns": 4,
            },
        ),
        (
            "prototype_s4",
            SMALL
            | {
                "group": 1,
                "motion": "spherical",
                "ris_user": "los",
                "region": "fixed",
                "user_centre_enu": (0.0, 50.0),
                "user_half_angle_rad": 0.45 * math.pi,
                "user_bounds": "none",
                "mobility": "directional",
                "induced_velocity": "paper",
                "climb": "signed",
                "climb_up_mps": None,
                "climb_down_mps": None,
            },
        ),
    ],
)
def test_presets_set_the_designs_switches_and_no_other(name, switches):
    assert PRESETS[name] == Scenario(**switches)


def test_small_twin_has_the_surface_of_the_large_one():
    small, large = PRESETS["physical_small"], PRESETS["physical_1km"]
    assert (small.elements, large.elements) == (16, 256)
    assert small.panel == large.panel
    # 16 elements share what one controlled group adds up coherently, twice on the cascade's amplitude.
    assert small.ris_gain_db - large.ris_gain_db == pytest.approx(20 * math.log10(16), abs=0.1)


@pytest.mark.parametrize(("noise", "dbm"), [("thermal", -174 + 7 + 60), ("total", -95), ("density", -95 + 60)])
def test_noise_readings(noise, dbm):
    assert 10 * math.log10(preset("physical_small", noise=noise).noise_w) + 30 == pytest.approx(dbm)


def test_power_limit_in_watts():
    assert PRESETS["physical_small"].p_max_w == pytest.approx(0.7943, abs=1e-4)


def test_wing_reads_the_scenario():
    literal = PRESETS["paper_literal"]
    assert literal.wing.induced_velocity_mps == 4.028
    assert (literal.wing.induced, literal.wing.climb, literal.panel.v_perp) == ("paper", "signed", "speed")
    assert PRESETS["physical_1km"].wing.induced_velocity_mps == pytest.approx(4.504, abs=5e-4)
    assert PRESETS["physical_1km"].hover_power_w == pytest.approx(192.5, abs=0.05)


def test_half_of_the_users_start_on_the_reflection_side_unless_said():
    assert preset("physical_small", users=7).reflection_count == 3
    assert preset("physical_small", users=7, reflection_users=0).reflection_count == 0


def test_every_preset_survives_being_written_down():
    for scenario in PRESETS.values():
        assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario


def test_path_loss_overrides_one_link_and_keeps_the_others():
    scenario = preset("physical_small", path_loss={"ris_user": "free_space"})
    assert (scenario.path_loss.ris_user, scenario.path_loss.bs_user) == ("free_space", "paper")


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"v_max_mps": -3}, ["v_max_mps", "-3", "greater than 0"]),
        ({"speed": 3}, ["speed: unknown key, allowed are preset, slots"]),
        ({"rowz": 3}, ["rowz: unknown key, did you mean rows?"]),
        ({"xyzzy": 3}, ["xyzzy: unknown key, allowed are preset, slots, slot_s"]),
        ({"path_loss": {"ris_usr": "paper"}}, ["path_loss.ris_usr: unknown key, did you mean ris_user"]),
        ({"path_loss": {"xyzzy": 1}}, ["path_loss.xyzzy: unknown key, allowed are bs_user, bs_ris, ris_user"]),
        ({"users": "6"}, ["users: '6' is not allowed", "integer"]),
        ({"users": 6.0}, ["users: 6.0", "integer"]),
        ({"users": True}, ["users: True", "integer"]),
        ({"kappa": "5"}, ["kappa: '5'", "number"]),
        ({"kappa": False}, ["kappa: False", "number"]),
        ({"extrapolate": "yes"}, ["extrapolate: 'yes'", "boolean"]),
        ({"extrapolate": 1}, ["extrapolate: 1", "boolean"]),
        ({"phase_bits": True}, ["phase_bits: True", "integer"]),
        ({"start_enu": (0, "0", 60)}, ["start_enu.1: '0'", "number"]),
        ({"start_enu": "abc"}, ["start_enu: 'abc'", "should be a list"]),
        ({"box_enu": ((-1, 1), (-1, True), (30, 60))}, ["box_enu.1.1: True", "number"]),
        ({"path_loss": 3}, ["path_loss: 3", "dictionary"]),
        ({"sinr": "voltage"}, ["sinr", "voltage", "'power' or 'amplitude'"]),
        ({"slots": 0}, ["slots", "0", "greater than or equal to 1"]),
        ({"users": 0}, ["users", "greater than or equal to 1"]),
        ({"slots": 2.5}, ["slots", "2.5", "integer"]),
        ({"kappa": math.nan}, ["kappa", "nan", "finite"]),
        ({"start_enu": (0, 0, math.inf)}, ["start_enu.2", "inf", "finite"]),
        ({"path_loss": {"bs_user": "okumura"}}, ["path_loss.bs_user", "okumura", "tr38901_umi"]),
        ({"timing": "during"}, ["timing", "during", "'pre' or 'post'"]),
        ({"box_enu": ((1, -1), (-1, 1), (30, 60))}, ["box_enu", "x from 1 to -1"]),
        ({"start_enu": (0, 0, 20)}, ["start_enu", "z = 20", "30 to 120"]),
        ({"base_station_enu": (0, 0, 60)}, ["base_station_enu", "start_enu"]),
        ({"user_radius_m": (100, 20)}, ["user_radius_m", "100 to 20"]),
        ({"reflection_users": 5}, ["reflection_users", "5", "users (4)"]),
        ({"user_height_m": 30, "box_enu": ((-1, 1), (-1, 1), (20, 60))}, ["box_enu", "user_height_m"]),
        (
            {"user_height_m": 15, "path_loss": {"bs_user": "tr38901_uma"}},
            ["user_height_m", "15", "1.5 to 13", "tr38901_uma", "extrapolate: true"],
        ),
        (
            {"path_loss": {"bs_user": "tr38901_umi"}},
            ["base_station_enu", "z = 25 is not 10", "path_loss.bs_user tr38901_umi", "extrapolate: true"],
        ),
        (
            {"path_loss": "3gpp", "box_enu": ((-1, 1), (-1, 1), (22, 60))},
            ["box_enu", "22 to 60", "(22.5, 300]", "path_loss.bs_ris tr36777_uma_av", "extrapolate: true"],
        ),
        (
            {"path_loss": {"bs_ris": "tr36777_umi_av"}, "base_station_enu": (-1000, 0, 10), "start_enu": (0, 0, 301)}
            | {"box_enu": ((-1, 1), (-1, 1), (30, 301))},
            ["box_enu", "30 to 301", "tr36777_umi_av"],
        ),
        ({"path_loss": "4gpp"}, ["path_loss", "4gpp", "paper, 3gpp"]),
        ({"phase_bits": 4}, ["phase_bits: 4", "less than or equal to 3"]),
        ({"surface": "star"}, ["surface", "star", "'coupled'", "'conventional'"]),
        ({"element_loss_db": -1}, ["element_loss_db", "-1", "greater than or equal to 0"]),
        ({"attitude": "tilted"}, ["attitude", "tilted", "'level' or 'flown'"]),
        ({"csi_error_variance": -0.1}, ["csi_error_variance", "-0.1", "greater than or equal to 0"]),
        ({"csi_delay_slots": 1.5}, ["csi_delay_slots", "1.5", "integer"]),
        ({"wind_enu": (0, 0)}, ["wind_enu.2: missing"]),
        ({"wind_enu": (0, 0, math.nan)}, ["wind_enu.2", "nan", "finite"]),
        ({"ris_mass_kg_per_m2": -1}, ["ris_mass_kg_per_m2", "-1"]),
        ({"state_extra": ["time", "speed"]}, ["state_extra.1", "speed", "'users' or 'time'"]),
        ({"state_extra": ["time", "time"]}, ["state_extra: time, time", "once"]),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_that_names_it(fields, words):
    with pytest.raises(ScenarioError) as error:
        preset("physical_small", **fields)
    assert all(word in str(error.value) for word in words), str(error.value)
    assert "\n" not in str(error.value)


def test_several_faults_are_all_named():
    with pytest.raises(ScenarioError, match=r"slots: .*; users: "):
        make_scenario({"slots": 0, "users": 0})


def test_lists_and_whole_numbers_are_taken_for_points_and_floats():
    scenario = make_scenario(
        {"preset": "physical_small", "start_enu": [0, 1, 60], "box_enu": [[-9, 9]] * 2 + [[30, 99]]}
    )
    assert (scenario.start_enu, scenario.box_enu) == ((0.0, 1.0, 60.0), ((-9.0, 9.0), (-9.0, 9.0), (30.0, 99.0)))


def test_what_is_observed_besides_may_be_named_in_any_order():
    assert preset("physical_small", state_extra=["time", "users"]) == preset(
        "physical_small", state_extra=["users", "time"]
    )


def test_a_preset_goes_by_its_name_alone_or_beside_the_fields_that_differ():
    assert make_scenario("physical_small") == PRESETS["physical_small"]
    assert make_scenario({"preset": "physical_small", "users": 6}) == preset("physical_small", users=6)


@pytest.mark.parametrize("given", [3, None, [], ["physical_small"], {"preset": []}, {"preset": "big"}, {1: 2}])
def test_what_is_no_scenario_at_all_is_refused(given):
    with pytest.raises(ScenarioError) as error:
        make_scenario(given)
    assert "\n" not in str(error.value)


def test_unknown_preset_names_those_there_are():
    with pytest.raises(ScenarioError, match="'paper' is not one of paper_literal, physical_1km"):
        preset("paper")


def test_scenarios_do_not_change():
    with pytest.raises(ValidationError, match="frozen"):
        PRESETS["physical_small"].slots = 3


def test_scenario_is_read_without_loading_torch():
    code = "import sys, rf_model.scenario; sys.exit('torch' in sys.modules or 'numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_set_of_path_losses_goes_by_its_name():
    scenario = preset("physical_small", path_loss="3gpp")
    assert scenario.path_loss.model_dump() == {
        "bs_user": "tr38901_uma",
        "bs_ris": "tr36777_uma_av",
        "ris_user": "elevation",
    }
    assert make_scenario({"path_loss": "paper"}) == PRESETS["physical_1km"]


def test_heights_outside_a_models_validity_are_taken_on_request():
    fields = {"path_loss": "3gpp", "base_station_enu": (-1000, 0, 40), "user_height_m": 15}
    fields |= {"box_enu": ((-1, 1), (-1, 1), (20, 60)), "extrapolate": True}
    assert preset("physical_small", **fields).extrapolate


def test_literal_reading_rates_the_next_slot():
    assert [scenario.timing for scenario in PRESETS.values()] == ["post", "pre", "pre", "pre"]


def test_the_panels_mass_is_flown_but_power_is_measured_by_the_bare_vehicle():
    light, heavy = (preset("physical_small", ris_mass_kg_per_m2=density) for density in (0.0, 5.0))
    side = 16 * heavy.wavelength_m / 2
    assert heavy.ris_mass_kg == pytest.approx(5.0 * side**2)
    assert heavy.wing.weight_n == pytest.approx(25 + 9.80665 * heavy.ris_mass_kg)
    induced = math.sqrt(heavy.wing.weight_n / (2 * 1.225 * 0.503))
    assert heavy.wing.induced_velocity_mps == pytest.approx(induced)
    assert heavy.hover_power_w == light.hover_power_w
    assert light.wing.weight_n == 25
