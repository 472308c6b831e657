"""A mission file says what to fly, and every mistake in it is told in one line."""

from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from mission.mission_file import Mission, MissionError, action_deadline_s, bridge_config, check, dump, load
from rf_model.scenario import PRESETS

DEMO = Path(__file__).parents[2] / "missions" / "demo.yaml"


def test_the_demo_mission_is_sound():
    demo = load(DEMO)
    assert (demo.clock, demo.slots, demo.scenario.slots) == ("lockstep", 30, 30)
    check(demo)


def test_an_empty_mapping_is_a_mission_of_defaults(mission):
    loaded = load(mission("{}"))
    assert loaded.name == "m"
    assert loaded.scenario == PRESETS["physical_small"]
    assert loaded.slots == loaded.scenario.slots


@given(
    st.fixed_dictionaries(
        {},
        optional={
            "seed": st.integers(0, 2**63 - 1),
            "scenario": st.sampled_from(sorted(PRESETS)) | st.just({"preset": "physical_small", "users": 6}),
            "slots": st.integers(1, 10**6),
            "vehicle": st.fixed_dictionaries(
                {}, optional={"name": st.just("ab"), "sitl": st.just({"parameters": {"SIH_KDV": 0.1}})}
            ),
            "limits": st.fixed_dictionaries(
                {}, optional={"up_mps": st.floats(0.1, 9), "fence_sideways_m": st.floats(0, 1000)}
            ),
            "fence": st.sampled_from(
                [
                    {"box": {"x": [-150, 150], "y": [-150, 150], "z": [20, 130]}},
                    {"polygon": [[-150, -150], [150, -150], [160, 160], [0, 120], [-150, 150]], "altitude": [20, 130]},
                    {"cylinder": {"centre": [0, 0], "radius": 150, "altitude": [20, 130]}},
                ]
            ),
            "energy": st.just({"pack_wh": 74, "margin": 0.5}),
            "tracking": st.sampled_from(["position", "none"]),
            "yaw": st.sampled_from(["panel", "face_users"]),
            "restart": st.sampled_from(["once", "never"]),
            "record": st.just({"tlog": False}),
            "at_end": st.sampled_from(["return", "land"]),
        },
    ),
    st.sampled_from([{"policy": {"kind": "random"}}, {"clock": "paced", "speed": 7.5, "policy": {"kind": "hover"}}]),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=60)
def test_the_resolved_mission_reads_back_as_the_same_one(mission, fields, more):
    loaded = load(mission(yaml.safe_dump(fields | more)))
    text = dump(loaded)
    assert load(mission(text)) == loaded
    given_again = yaml.safe_load(text)
    assert set(given_again) == set(Mission.model_fields), "every field with its value"
    check(loaded)


def test_whole_numbers_and_exponents_are_numbers(mission):
    loaded = load(mission("clock: paced\nspeed: 5\nvehicle: {sitl: {parameters: {SIH_KDV: 1e-1, SIH_MASS: 2}}}"))
    assert loaded.speed == 5.0
    assert loaded.vehicle.sitl.parameters == {"SIH_KDV": 0.1, "SIH_MASS": 2.0}


@pytest.mark.parametrize(
    ("text", "mode", "iterations"),
    [
        ("{}", "agent", 40),
        ("ris: agent\nscenario: paper_literal", "agent", 40),
        ("ris: closed_form", "closed_form", 40),
        ("ris: {mode: optimised, iterations: 7}", "optimised", 7),
        ("ris: {}", "agent", 40),
    ],
)
def test_who_sets_the_surface_is_a_name_or_a_mapping(mission, text, mode, iterations):
    loaded = load(mission(text))
    assert (loaded.ris.mode, loaded.ris.iterations) == (mode, iterations)
    assert load(mission(dump(loaded))) == loaded


def test_slots_of_mission_and_scenario_agree(mission):
    assert load(mission("slots: 5")).scenario.slots == 5
    assert load(mission("scenario: {preset: physical_small, slots: 7}")).slots == 7


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[1]", ["must hold a mapping", "scenario"]),
        ("a: [1", ["not YAML"]),
        ("1: 2", ["1", "keys should be strings"]),
        ("vehicle: 3", ["vehicle: 3", "dictionary"]),
        ("seed: -1", ["seed: -1", "greater than or equal to 0"]),
        ("seed: 1.5", ["seed: 1.5", "integer"]),
        ("speed: .nan\nclock: paced", ["speed: nan"]),
        ("speed: 1000\nclock: paced", ["speed: 1000", "100"]),
        ("clock: fast", ["clock: 'fast'", "'lockstep'", "'paced'"]),
        ("scenario: 3", ["scenario: 3", "preset"]),
        ("scenario: {preset: [1]}", ["scenario.preset: [1] is not one of", "physical_small"]),
        ("scenario: physical_big", ["scenario: 'physical_big' is not one of", "physical_small"]),
        ("scenario: {preset: physical_small, rowz: 3}", ["scenario.rowz: unknown key, did you mean rows?"]),
        ("scenario: {preset: physical_small, name: foo}", ["scenario.name: unknown key, "]),
        ("scenario: {xyzzy: 3}", ["scenario.xyzzy: unknown key, allowed are preset, slots, slot_s"]),
        (
            "scenario: {preset: physical_small, path_loss: {bs_rs: paper}}",
            ["scenario.path_loss.bs_rs: unknown key, did you mean bs_ris"],
        ),
        ('scenario: {users: "6"}', ["scenario.users: '6' is not allowed", "integer"]),
        ("scenario: {preset: physical_small, kappa: yes}", ["scenario.kappa: True", "number"]),
        ("sceanrio: physical_small", ["sceanrio: unknown key, did you mean scenario?"]),
        ("vehicle: {autopilt: sitl}", ["vehicle.autopilt: unknown key, did you mean autopilot?"]),
        ("scenario: {preset: physical_small, rows: 0}", ["scenario.rows: 0", "greater than or equal to 1"]),
        ("ris: optimized", ["ris.mode: 'optimized'", "'agent', 'closed_form' or 'optimised'"]),
        ("ris: {mode: optimised, iterations: -1}", ["ris.iterations: -1", "greater than or equal to 0"]),
        ('ris: {mode: optimised, iterations: "40"}', ["ris.iterations: '40'", "integer"]),
        ("ris: {mode: optimised, iteration: 9}", ["ris.iteration: unknown key, did you mean iterations?"]),
        ("ris: 40", ["ris: 40", "dictionary"]),
        (
            "ris: closed_form\nscenario: paper_literal\npolicy: {kind: hover}",
            ["ris.mode: 'closed_form'", "scenario.sinr 'amplitude'", "'agent'", "'power'"],
        ),
        (
            "ris: optimised\nscenario: {sinr: amplitude}\npolicy: {kind: hover}",
            ["ris.mode: 'optimised'", "scenario.sinr 'amplitude'"],
        ),
        ("slots: {a: 1}", ["slots: {'a': 1} is not allowed", "integer"]),
        ("scenario: {preset: physical_small, slot_s: 0.15}\npolicy: {kind: hover}", ["scenario.slot_s: 0.15", "0.2"]),
        ("scenario: {preset: physical_small, start_enu: [0, 0, 500]}", ["start_enu: z = 500", "30 to 120"]),
        ("policy: {kind: hover, checkpoint: physical_small}", ["policy.checkpoint", "hover"]),
        ("policy: {kind: genius}", ["policy.kind: 'genius'", "'random'"]),
        ("policy: {checkpoint: nobody}", ["policy.checkpoint: 'nobody'", ".safetensors"]),
        ("vehicle: {name: a b}", ["vehicle.name: 'a b'", "letters"]),
        (
            "vehicle: {autopilot: 'usb://1.2.3.4:5'}",
            ["vehicle.autopilot", "usb", "'sitl'", "udpin://HOST:PORT", "tcp://"],
        ),
        ("vehicle: {backend: mavsdk}", ["vehicle.backend: 'mavsdk'", "clock 'paced'", "not lockstep"]),
        ("clock: paced\nspeed: 2\nvehicle: {backend: mavsdk}", ["vehicle.backend: 'mavsdk'", "at speed 1 at most"]),
        (
            "clock: paced\nvehicle: {backend: mavsdk, signing_key: key}",
            ["vehicle.signing_key", "'mavsdk' cannot sign", "'pymavlink' can"],
        ),
        ("vehicle: {dialect: inav}", ["vehicle.dialect: 'inav'", "'auto'", "'px4'", "'arducopter'"]),
        ("vehicle: {sitl: {personality: inav}}", ["vehicle.sitl.personality: 'inav'", "'px4'", "'arducopter'"]),
        (
            "clock: paced\nvehicle: {autopilot: 'udpin://127.0.0.1:1', sitl: {parameters: {A: 1}}}",
            ["vehicle.sitl", "'sitl'"],
        ),
        ("clock: paced\nspeed: 2\nvehicle: {autopilot: 'udpin://127.0.0.1:1'}", ["speed: 2", "allows 1 at most"]),
        ("clock: lockstep\nvehicle: {autopilot: 'udpin://127.0.0.1:1'}", ["clock: 'lockstep'", "'paced'"]),
        ("speed: 2", ["speed: 2", "'paced'"]),
        ("restart: twice", ["restart: 'twice'", "'once'", "'never'"]),
        ('slots: "10"', ["slots: '10'", "integer"]),
        ("slots: 10.0", ["slots: 10.0", "integer"]),
        ("slots: true", ["slots: True", "integer"]),
        ("seed: true", ["seed: True", "integer"]),
        ("vehicle: {system_id: 1.0}", ["vehicle.system_id: 1.0", "integer"]),
        ('record: {tlog: "no"}', ["record.tlog: 'no'", "boolean"]),
        ('limits: {up_mps: "2"}', ["limits.up_mps: '2'", "number"]),
        ("speed: true\nclock: paced", ["speed: True", "number"]),
        ('vehicle: {parameters: {MPC_XY_VEL_MAX: "8"}}', ["vehicle.parameters.MPC_XY_VEL_MAX: '8'", "number"]),
        ("seed: 1\nslots: 3\nseed: 2", ["seed: given twice, in lines 1 and 3"]),
        ("vehicle:\n  name: a\n  name: b", ["name: given twice, in lines 2 and 3"]),
        ("record: {mcap: maybe}", ["record.mcap: 'maybe'", "boolean"]),
        ("seed: -1\nslots: -1\nname: a b", ["(and 2 more)"]),
    ],
)
def test_every_mistake_is_one_line_naming_file_field_value_and_what_is_allowed(mission, text, parts):
    path = mission(text)
    with pytest.raises(MissionError) as caught:
        check(load(path))
    line = str(caught.value)
    assert "\n" not in line
    for part in parts:
        assert part in line
    if "slot_s" not in line:
        assert line.startswith(str(path))


def test_an_unknown_key_is_answered_with_the_known_ones_at_every_depth(mission):
    def sections(model, place):
        yield place, list(model.model_fields)
        for name, field in model.model_fields.items():
            if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel) and name != "scenario":
                yield from sections(field.annotation, [*place, name])

    for place, known in sections(Mission, []):
        fields = {"qqqq": 1}
        for name in reversed(place):
            fields = {name: fields}
        with pytest.raises(MissionError) as caught:
            load(mission(yaml.safe_dump(fields)))
        assert f"{'.'.join([*place, 'qqqq'])}: unknown key, allowed are {', '.join(known)}" in str(caught.value)


def test_the_bridge_gets_what_the_mission_says(mission):
    loaded = load(
        mission(
            "scenario: {preset: physical_small, slot_s: 2.0, v_max_mps: 6}\n"
            "slots: 9\nrestart: never\nat_end: land\n"
            "limits: {horizontal_mps: 4, fence_sideways_m: 7, fence_vertically_m: 3}\n"
            "vehicle: {system_id: 9, parameters: {MPC_XY_VEL_MAX: 8}}"
        )
    )
    config = bridge_config(loaded, autopilot="udpin://127.0.0.1:9", control="127.0.0.1:8")
    assert (config.slots, config.slot_s, config.v_max_mps, config.system_id) == (9, 2.0, 6.0, 9)
    assert (config.await_restart, config.at_end, config.clock.control) == (False, "land", "127.0.0.1:8")
    assert config.limits.horizontal_mps == 4
    assert config.slot_fence.x == (-107.0, 107.0)
    assert config.slot_fence.z == (27.0, 123.0)
    assert config.parameters == {"MPC_XY_VEL_MAX": 8}
    assert action_deadline_s(loaded) == 0.5


def test_a_vehicle_of_another_make(mission):
    text = "clock: paced\nvehicle: {autopilot: 'serial:///dev/ttyACM0:57600', backend: mavsdk, dialect: arducopter}"
    config = bridge_config(load(mission(text)))
    assert (config.autopilot, config.backend, config.dialect) == ("serial:///dev/ttyACM0:57600", "mavsdk", "arducopter")


def test_a_signing_key_is_looked_at_before_anything_starts(mission, tmp_path):
    loaded = load(mission(f"vehicle: {{signing_key: {tmp_path}/key}}"))
    with pytest.raises(MissionError, match=r"vehicle.signing_key: .*/key: cannot be read"):
        check(loaded)
    (tmp_path / "key").write_bytes(bytes(range(32)))
    check(loaded)
    assert bridge_config(loaded, control="127.0.0.1:8").signing_key == tmp_path / "key"


def test_lockstep_without_a_control_socket_is_refused(mission):
    with pytest.raises(MissionError, match="--control"):
        bridge_config(load(mission("{}")))


def test_options_replace_fields_and_none_leaves_them(mission):
    loaded = load(mission("seed: 3\nslots: 4"), seed=None, slots=8, vehicle_name="other")
    assert (loaded.seed, loaded.slots, loaded.vehicle.name) == (3, 8, "other")


SQUARE = "[[-150, -150], [150, -150], [150, 150], [-150, 150]]"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("fence: {}", ["fence.box: one of box, polygon, cylinder must be given, not none"]),
        (
            f"fence: {{polygon: {SQUARE}, cylinder: {{centre: [0, 0], radius: 9, altitude: [2, 9]}}}}",
            ["one of box, polygon, cylinder must be given, not polygon and cylinder"],
        ),
        (f"fence: {{polygon: {SQUARE}}}", ["fence.altitude: must be given with polygon"]),
        (f"fence: {{polygon: {SQUARE}, altitude: [130, 20]}}", ["fence.altitude", "minimum must be below the maximum"]),
        ("fence: {polygon: [[0, 0], [9, 9], [9, 0], [0, 9]], altitude: [20, 130]}", ["fence.polygon", "must not meet"]),
        ("fence: {polygon: [[0, 0], [9, '9']], altitude: [20, 130]}", ["fence.polygon"]),
        ("fence: {cylinder: {centre: [0, 0], radius: -1, altitude: [20, 130]}}", ["fence.cylinder.radius: -1"]),
        ("fence: {cylinder: {center: [0, 0]}}", ["fence.cylinder.center: unknown key, did you mean centre?"]),
        ("fence: {box: {x: ['1', 2], y: [0, 1], z: [0, 1]}}", ["fence.box.x.0: '1'", "number"]),
        (
            "fence: {box: {x: [0, 150], y: [-150, 150], z: [0, 130]}}",
            ["fence.x: (0, 150) must hold the box's (-100, 100)"],
        ),
        (
            "fence: {cylinder: {centre: [0, 0], radius: 120, altitude: [20, 130]}}",
            ["fence: must hold the box's (-100, 100) x (-100, 100)"],
        ),
        (
            "fence: {cylinder: {centre: [0, 0], radius: 150, altitude: [40, 130]}}",
            ["fence.altitude: (40, 130) must hold the box's (30, 120)"],
        ),
        ("limits: {home_distance_m: 100}", ["limits.home_distance_m: 100 is less than the 141.4 to the box's corners"]),
        ("limits: {jerk_mps3: 0}", ["limits.jerk_mps3: 0"]),
        ("energy: {margin: 0.1}", ["energy.pack_wh: missing"]),
        ("energy: {pack_wh: -3}", ["energy.pack_wh: -3"]),
        ("tracking: open", ["tracking: 'open'", "'none'"]),
        ("yaw: north", ["yaw: 'north'", "'face_users'"]),
    ],
)
def test_a_fence_that_cannot_be_and_its_like_are_told_by_field(mission, text, parts):
    with pytest.raises(MissionError) as told:
        check(load(mission(text)))
    assert "\n" not in str(told.value)
    for part in parts:
        assert part in str(told.value)


def test_what_the_mission_says_of_fence_energy_yaw_and_tracking_reaches_the_bridge(mission):
    text = f"""
        fence: {{polygon: {SQUARE}, altitude: [20, 130]}}
        energy: {{pack_wh: 74, margin: 0.5}}
        limits: {{home_distance_m: 145, separation_m: 8, jerk_mps3: 10, vertical_acceleration_mps2: 2}}
        tracking: none
        yaw: face_users
        """
    loaded = load(mission(text))
    config = bridge_config(loaded, control="127.0.0.1:1")
    assert config.slot_fence.altitude == (20, 130)
    assert config.slot_fence.polygon[2] == (150, 150)
    assert config.flight_fence.altitude == (-1, 130)
    assert config.endurance.pack_j == 74 * 3600
    assert config.endurance.wing == loaded.scenario.wing
    assert (config.home_distance_m, config.separation_m, config.tracking) == (145, 8, "none")
    assert (config.limits.jerk_mps3, config.limits.vertical_mps2) == (10, 2)
    assert config.face_enu == loaded.scenario.user_centre_enu
    assert bridge_config(load(mission("{}")), control="127.0.0.1:1").face_enu is None
