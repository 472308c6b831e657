"""The demo mission as a user flies it, twice, and once paced."""

import itertools
import json
import math
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
import torch
from pymavlink import mavutil

from agent.decoding import decode
from bus import topics
from mission import mission_file
from mission.transitions import data_set, transitions
from rf_model.channels import Channels
from rf_model.star_ris import Trc
from rf_model.world import slot_rates

DEMO = Path(__file__).parents[2] / "missions" / "demo.yaml"


@pytest.fixture(scope="module")
def demo(launch):
    flight = launch(DEMO)
    assert flight.wait() == 0, flight.text
    return flight


def test_the_demo_flies_all_its_slots_and_leaves_nothing_behind(demo):
    assert not demo.processes()
    log = demo.log
    assert log.complete
    mission = mission_file.load(DEMO)
    assert sorted(log.by_slot(topics.LINK)) == list(range(mission.slots))
    assert sorted(log.by_slot(topics.CONFIGURATION)) == list(range(mission.slots))
    states = log.messages(topics.STATE)
    assert not states[-1].armed
    assert states[-1].landed
    ended = log.messages(topics.EVENT)[-1]
    assert (ended.kind, ended.exit_code) == ("ended", 0)


def test_the_same_seed_gives_the_same_flight_also_from_the_resolved_mission(demo, launch):
    again = launch(demo.run / "mission.yaml")
    assert again.wait() == 0, again.text
    first, second = demo.log, again.log
    for topic in (topics.SLOT, topics.CSI, topics.ACTION, topics.CONFIGURATION, topics.LINK, topics.STATE):
        assert first.messages(topic) == second.messages(topic), topic.name


def test_the_run_folder_holds_what_it_should(demo):
    names = {path.name for path in demo.run.iterdir()}
    assert names == {
        "mission.yaml",
        "versions.json",
        "flight.tlog",
        "flight.mcap",
        "report.json",
        "report.png",
        "logs",
    }
    versions = json.loads((demo.run / "versions.json").read_text())
    assert versions["seed"] == mission_file.load(DEMO).seed
    assert {"torch", "pymavlink", "eclipse-zenoh"} <= set(versions["libraries"])
    picture = (demo.run / "report.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", picture[16:24])
    assert width > 1000
    assert height > 600
    assert len(set(zlib.decompress(_idat(picture))[:: width * 4])) > 20, "an empty picture"


def _idat(png):
    data, at = b"", 8
    while at < len(png):
        (length,), kind = struct.unpack(">I", png[at : at + 4]), png[at + 4 : at + 8]
        if kind == b"IDAT":
            data += png[at + 8 : at + 8 + length]
        at += 12 + length
    return data


def test_the_flight_log_reads_in_pymavlink_both_directions(demo):
    log = mavutil.mavlink_connection(str(demo.run / "flight.tlog"), robust_parsing=False)
    kinds = {}
    while (message := log.recv_msg()) is not None:
        kinds.setdefault(message.get_srcSystem(), set()).add(message.get_type())
    assert {"HEARTBEAT", "LOCAL_POSITION_NED", "COMMAND_ACK"} <= kinds[1]
    assert any("SET_POSITION_TARGET_LOCAL_NED" in sent for system, sent in kinds.items() if system != 1)


def test_what_was_shown_is_what_was_recorded(demo):
    report, links = demo.report, demo.log.messages(topics.LINK)
    assert report["exit_code"] == 0
    assert report["slots"] == len(links)
    for index, user in enumerate(report["users"]):
        rates = [link.rate_bps[index] for link in links]
        assert user["mean_rate_bps"] == pytest.approx(sum(rates) / len(rates))
        assert user["below_qos"] == pytest.approx(sum(rate < report["qos_bps"] for rate in rates) / len(rates))
    assert report["energy_j"] == pytest.approx(sum(link.energy_j for link in links))
    flown = [slot.flown for slot in demo.log.messages(topics.SLOT) if slot.flown]
    assert sum(report["actions"].values()) == len(flown)
    shown = report["displacement"]["flown_m"]
    assert shown == pytest.approx(sum(math.dist((0, 0, 0), slot.flown_enu) for slot in flown))
    assert str(demo.run) in demo.text
    assert "harmonic fairness index" in demo.text


def test_every_transition_is_rebuilt_with_the_reported_reward(demo):
    """Also through the raw action: what it decodes to is worth the reported fair rate."""
    mission = mission_file.load(demo.run / "mission.yaml")
    links, states = demo.log.by_slot(topics.LINK), demo.log.by_slot(topics.CSI)
    rebuilt = transitions(demo.run)
    assert [transition.slot for transition in rebuilt] == list(range(mission.slots))
    for transition in rebuilt:
        link, state = links[transition.slot], states[transition.slot]
        assert transition.reward == pytest.approx(link.reward, rel=1e-12, abs=1e-12)
        action = decode(transition.action.double(), mission.scenario)
        channels = Channels(
            *(
                torch.view_as_complex(torch.tensor(matrix, dtype=torch.float64))
                for matrix in (state.direct, state.bs_ris, state.ris_user)
            ),
            transmission=torch.tensor([region == "transmission" for region in state.regions]),
        )
        trc = Trc(action.theta_reflection, action.split_angle, action.sign)
        rates = slot_rates(mission.scenario, channels, trc, action.beamforming)
        assert rates.fair_rate_bps.item() == pytest.approx(link.fair_rate_bps, rel=1e-3)
    for before, after in itertools.pairwise(rebuilt):
        assert torch.equal(before.next_observation, after.observation)
    _, data = data_set([demo.run])
    assert data.observation.shape[0] == len(rebuilt)


def test_a_fresh_rf_node_says_the_same_bit_for_bit(demo):
    command = [sys.executable, "-m", "mission", "replay", str(demo.run)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "all the same bit for bit" in done.stdout


def test_a_replay_in_another_world_is_told_apart(demo, tmp_path):
    shutil.copy(demo.run / "flight.mcap", tmp_path)
    mission = (demo.run / "mission.yaml").read_text()
    (tmp_path / "mission.yaml").write_text(mission.replace(f"seed: {demo.report['seed']}\n", "seed: 123456\n"))
    done = subprocess.run(
        [sys.executable, "-m", "mission", "replay", str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert "the first is rf/csi of slot 0" in done.stdout


def test_paced_five_times_as_fast_as_the_wall_clock_and_the_first_flight_of_an_installation(launch, short, tmp_path):
    """Nothing is compiled yet, so the autopilot comes up long after the others."""
    flight = launch(short | {"slots": 5}, "--speed", "5", NUMBA_CACHE_DIR=str(tmp_path))
    assert flight.wait() == 0, flight.text
    assert not flight.processes()
    assert "compiling the flight model, once" in flight.text
    log = flight.log
    assert sorted(log.by_slot(topics.LINK)) == list(range(5))
    opened = [slot.time_s for slot in log.messages(topics.SLOT)]
    assert [after - before for before, after in itertools.pairwise(opened)] == pytest.approx([1.0] * 5, abs=0.06)
    states = [entry for entry in log.entries if entry.topic == "state"]
    vehicle = [state.time_s for state in log.messages(topics.STATE)]
    assert vehicle == sorted(vehicle)
    assert vehicle[-1] - vehicle[0] > 15.0, "takeoff, five slots and landing took vehicle time"
    pace = (vehicle[-1] - vehicle[0]) / (states[-1].wall_s - states[0].wall_s)
    assert pace <= 5.5, "it never runs ahead of its clock"
