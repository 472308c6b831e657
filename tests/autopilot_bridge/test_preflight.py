"""What is asked of the autopilot before it arms, and put back after: real SITL processes, real UDP, real files."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

PATIENT = ("--param", "COM_OF_LOSS_T=10")
PROGRAM = """
import sys
from autopilot_bridge.config import BridgeConfig
from autopilot_bridge.node import run
from bus.session import open_session
session = open_session()
code = run(BridgeConfig.model_validate_json(sys.argv[1]), "test", session, None)
session.close()
sys.exit(code)
"""


class Bridge:
    """One bridge as a process of its own."""

    def __init__(self, config):
        self.process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, config.model_dump_json()],
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).parents[2],
        )
        self.lines = []

    def until(self, text):
        for line in self.process.stdout:
            self.lines.append(line)
            if text in line:
                return
        raise AssertionError(f"ended without {text!r}: {''.join(self.lines)}")

    def wait(self):
        self.lines += self.process.stdout
        return self.process.wait(120)

    def told(self, kind):
        return [line.split(f" {kind}: ", 1)[1].strip() for line in self.lines if f" {kind}: " in line]

    def kill(self):
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.process.stdout.close()


def journal(tmp_path):
    (found,) = (tmp_path / "state" / "aerialstar").iterdir()
    return found


def test_what_a_killed_bridge_left_is_put_back_by_the_next(sitl, fly, bridge_config, tmp_path):
    autopilot = sitl("--speed", "10", *PATIENT)
    config = bridge_config(
        autopilot, clock={"kind": "paced", "speed": 10.0}, slots=1000, parameters={"MPC_XY_VEL_MAX": 6.0}
    )
    bridge = Bridge(config.model_copy(update={"grace_s": 3600.0}))
    bridge.until("phase: slots")
    bridge.kill()
    entries = [json.loads(line) for line in journal(tmp_path).read_text().splitlines()]
    assert [(entry["set"], entry["before"]) for entry in entries] == [
        ("MPC_XY_VEL_MAX", 12.0),
        ("COM_OBL_RC_ACT", 0.0),
        ("MIS_TAKEOFF_ALT", 2.5),
    ]

    early = fly(config)  # while the autopilot's failsafe brings it home
    assert early.wait() == 1
    assert "armed already" in early.told("error")[0]
    assert len(journal(tmp_path).read_text().splitlines()) == len(entries)

    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        again = fly(bridge_config(autopilot, clock={"kind": "paced", "speed": 10.0}, autostart=False))
        again.until(lambda again=again: again.code is not None or "ready" in again.phases, "preflight")
        if "ready" in again.phases:
            break
        again.wait()
        time.sleep(0.5)
    put_back = [text for text in again.told("parameter") if "put back" in text]
    assert put_back == [
        "MPC_XY_VEL_MAX put back to 12",
        "COM_OBL_RC_ACT put back to 0",
        "MIS_TAKEOFF_ALT put back to 2.5",
    ]
    assert not any("armed" in text for text in again.told("error"))
    assert again.command("land").accepted
    assert again.wait() == 3
    assert journal(tmp_path).read_text() == ""


def test_mavsdk_puts_back_what_a_killed_bridge_left_too(sitl, fly, bridge_config, tmp_path):
    """One float and one whole parameter, at the wall clock's pace: MAVSDK knows no other."""
    autopilot = sitl(*PATIENT)
    mavsdk = {"backend": "mavsdk", "autostart": False}
    bridge = Bridge(bridge_config(autopilot, parameters={"MPC_XY_VEL_MAX": 6.0}, **mavsdk))
    bridge.until("phase: ready")
    bridge.kill()
    assert len(journal(tmp_path).read_text().splitlines()) == 3
    again = fly(bridge_config(autopilot, **mavsdk))
    again.until_phase("ready")
    assert [text for text in again.told("parameter") if "put back" in text] == [
        "MPC_XY_VEL_MAX put back to 12",
        "COM_OBL_RC_ACT put back to 0",
        "MIS_TAKEOFF_ALT put back to 2.5",
    ]
    assert again.command("land").accepted
    assert again.wait() == 3
    assert journal(tmp_path).read_text() == ""


def test_parameters_are_put_back_on_the_ground_after_every_end(sitl, fly, bridge_config, tmp_path):
    autopilot = sitl("--speed", "10", *PATIENT)
    paced = {"kind": "paced", "speed": 10.0}
    flight = fly(bridge_config(autopilot, clock=paced, parameters={"MPC_XY_VEL_MAX": 6.0}))
    assert flight.wait() == 0
    assert flight.told("parameter")[-3:] == [
        "MPC_XY_VEL_MAX put back to 12",
        "COM_OBL_RC_ACT put back to 0",
        "MIS_TAKEOFF_ALT put back to 2.5",
    ]
    assert journal(tmp_path).read_text() == ""
    refused = fly(bridge_config(autopilot, clock=paced, parameters={"MPC_XY_VEL_MAX": 6.0, "COM_OBL_RC_ACT": 77}))
    assert refused.wait() == 1
    assert refused.told("error") == ["parameter COM_OBL_RC_ACT: the autopilot did not take 77"]
    assert "arming" not in refused.phases
    assert refused.told("parameter")[-1] == "MPC_XY_VEL_MAX put back to 12"
    assert journal(tmp_path).read_text() == ""


def test_an_autopilot_that_has_started_anew_has_forgotten_them(sitl, fly, bridge_config, tmp_path):
    autopilot = sitl("--lockstep")
    config = bridge_config(autopilot, autostart=False)
    bridge = Bridge(config)
    bridge.until("phase: ready")
    bridge.kill()
    autopilot.close()
    assert len(journal(tmp_path).read_text().splitlines()) == 2
    another = sitl("--lockstep", port=autopilot.port)
    flight = fly(bridge_config(another))
    assert flight.wait() == 0
    assert flight.told("error") == []
    assert flight.told("parameter")[0].startswith("COM_OBL_RC_ACT was 0")
    assert journal(tmp_path).read_text() == ""


def test_what_somebody_else_has_set_since_is_theirs(sitl, fly, bridge_config, tmp_path):
    autopilot = sitl("--lockstep", "--param", "MPC_XY_VEL_MAX=9")
    folder = tmp_path / "state" / "aerialstar"
    folder.mkdir(parents=True)
    path = folder / f"parameters-udpin-127.0.0.1-{autopilot.port}-1.jsonl"
    path.write_text(
        '{"set": "MPC_XY_VEL_MAX", "before": 12, "value": 6}\n'
        '{"set": "NO_SUCH", "before": 1, "value": 2}\n'
        '{"set": "MIS_TAKE'
    )
    flight = fly(bridge_config(autopilot))
    assert flight.wait() == 0
    assert "MPC_XY_VEL_MAX is 9 by somebody else's hand, not 6: left so" in flight.told("parameter")
    assert "NO_SUCH could not be put back to 1" in flight.told("error")[0]
    assert path.read_text().count("\n") >= 1
    assert '"NO_SUCH"' in path.read_text()  # it stays


def test_a_journal_that_cannot_be_written_forbids_the_flight(sitl, fly, bridge_config, tmp_path):
    (tmp_path / "state").write_text("no folder")
    flight = fly(bridge_config(sitl("--lockstep")))
    assert flight.wait() == 1
    assert "parameter journal" in flight.told("error")[0]
    assert "arming" not in flight.phases


PX4, COPTER = "px4", "arducopter"
PACED = {"clock": {"kind": "paced", "speed": 10.0}}


@pytest.mark.parametrize(
    ("kind", "changes", "told"),
    [
        (
            PX4,
            {"allow_without": []},
            r"battery_failsafe is off: COM_LOW_BAT_ACT is 0, must be 1, 2 or 3; set it, or say in the mission that it "
            "flies without (allow_without: [battery_failsafe])",
        ),
        (PX4, {"require": ["gcs_loss"]}, "gcs_loss is off: NAV_DLL_ACT is 0, must be 1, 2 or 3"),
        (PX4, {"require": ["geofence"]}, "geofence is off: GF_MAX_HOR_DIST is 0, must be more than 0"),
        (
            PX4,
            {"parameters": {"COM_OBL_RC_ACT": 1}},
            "offboard_loss is off: parameters.COM_OBL_RC_ACT is 1, must be 3 or 4",
        ),
        (PX4, {"parameters": {"COM_OF_LOSS_T": 11}}, "offboard_loss is late: COM_OF_LOSS_T is 11 s, must be 10 s at"),
        (PX4, {"parameters": {"COM_OF_LOSS_T": 0.1}}, "offboard_loss is hasty: COM_OF_LOSS_T is 0.1 s, must be 0.25"),
        (PX4, {"parameters": {"GF_MAX_HOR_DIST": 72}}, "box: its corners are 70.7 m from home; the autopilot's own"),
        (PX4, {"parameters": {"GF_MAX_VER_DIST": 41}}, "box: its top is 40 m above home"),
        (PX4, {"parameters": {"NO_SUCH": 1}}, "parameter NO_SUCH: unknown to the autopilot"),
        (PX4, {"parameters": {"COM_OBL_RC_ACT": 3.5}}, "parameter COM_OBL_RC_ACT: 3.5 is not a whole number"),
        (
            PX4,  # enough for the way home, 12.8 kJ, but not above the half at which the autopilot lands
            {
                "parameters": {"COM_LOW_BAT_ACT": 2, "BAT_LOW_THR": 0.5, "BAT_CRIT_THR": 0.5},
                "endurance": {"pack_j": 16e3},
            },
            "battery: 8.0 kJ are left, the way home from the start needs 12.8 kJ",
        ),
        (COPTER, {"allow_without": []}, "battery_failsafe is off: BATT_FS_LOW_ACT is 0, must be 1, 2, 3, 4 or 6"),
        (
            COPTER,
            {"allow_without": [], "parameters": {"BATT_FS_LOW_ACT": 2, "BATT_LOW_VOLT": 0}},
            "battery_failsafe is off: BATT_LOW_VOLT is 0 and BATT_LOW_MAH is 0, one must be more than 0",
        ),
        (
            COPTER,
            {"allow_without": [], "parameters": {"BATT_FS_LOW_ACT": 2, "BATT_LOW_TIMER": 0}},
            "battery_failsafe is off: BATT_LOW_TIMER is 0 and BATT_LOW_MAH is 0, one must be more than 0",
        ),
        (COPTER, {"require": ["geofence"]}, "geofence is off: FENCE_ENABLE is 0, must be 1"),
        (
            COPTER,
            {"parameters": {"FENCE_ENABLE": 1, "FENCE_RADIUS": 80, "FENCE_MARGIN": 10}},
            "box: its corners are 70.7 m from home; the autopilot's own fence, FENCE_RADIUS 80 m, must be 10 m further",
        ),
        (
            COPTER,
            {"parameters": {"FENCE_ENABLE": 1, "FENCE_TYPE": 15, "FENCE_ALT_MIN": 7}},
            "box: its bottom is 8 m above home; the autopilot's own fence, FENCE_ALT_MIN 7 m, must be 2 m further",
        ),
        (
            COPTER,
            {"parameters": {"FENCE_ENABLE": 1, "FENCE_RADIUS": 60}},
            "box: its corners are 70.7 m from home; the autopilot's own fence, FENCE_RADIUS 60 m, must be 2 m further",
        ),
    ],
)
def test_what_forbids_a_flight_is_told_and_nothing_arms(standing, fly, bridge_config, kind, changes, told):
    flight = fly(bridge_config(standing(kind), **(PACED | changes)))
    assert flight.wait() == 1
    (error,) = flight.told("error")
    assert told in error
    assert "arming" not in flight.phases
    assert not any(state.armed for state in flight.states)


def test_failsafes_that_the_mission_sets_or_does_without_let_it_fly(sitl, fly, bridge_config, tmp_path):
    changes = {
        "allow_without": ["offboard_loss"],
        "require": ["geofence"],
        "parameters": {"COM_LOW_BAT_ACT": 3, "GF_ACTION": 3, "GF_MAX_HOR_DIST": 100, "GF_MAX_VER_DIST": 43},
        "autostart": False,
    }
    flight = fly(bridge_config(sitl("--lockstep"), **changes))
    flight.until_phase("ready")
    assert not any("COM_OBL_RC_ACT" in text for text in flight.told("parameter"))
    assert flight.command("land").accepted
    assert flight.wait() == 3


def test_a_battery_failsafe_by_charge_is_one(standing, fly, bridge_config):
    parameters = {"BATT_FS_LOW_ACT": 2, "BATT_LOW_VOLT": 0, "BATT_LOW_MAH": 500}
    flight = fly(bridge_config(standing(COPTER), allow_without=[], parameters=parameters, autostart=False, **PACED))
    flight.until_phase("ready")
    assert flight.command("land").accepted
    assert flight.wait() == 3
    assert "BATT_LOW_VOLT put back to 10.5" in flight.told("parameter")


def test_setpoints_stay_below_the_autopilots_own_fence(sitl, fly, bridge_config):
    """GF_MAX_VER_DIST 43: the bridge's fence would let it up to 45."""
    changes = {"parameters": {"GF_ACTION": 3, "GF_MAX_HOR_DIST": 100, "GF_MAX_VER_DIST": 43}, "slots": 8}
    config = bridge_config(sitl("--lockstep"), start_position_enu=(0.0, 0.0, 38.0), **changes)
    flight = fly(config, lambda opened: (0.0, 0.0, 3.0))
    assert flight.wait() == 0
    assert max(track.position_enu[2] for flown_slot in flight.flown for track in flown_slot.track) < 41.5


def test_waiting_until_armable_says_why(sitl, fly, bridge_config):
    flight = fly(bridge_config(sitl("--lockstep"), autostart=False))
    flight.until_phase("ready")
    assert flight.told("preflight")[0].startswith("waiting until it can be armed")
    assert flight.command("land").accepted
    assert flight.wait() == 3
