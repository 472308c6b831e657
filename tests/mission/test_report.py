"""The report of a flight whose numbers are known."""

import json
import re
import struct
import subprocess
import sys

import pytest
from msgspec.structs import replace
from rich.console import Console

from bus.session import free_endpoint, open_session
from mission import flight_log, report
from mission.figures import draw
from mission.flyability import Flyability, Places, SlotFlyability, SlotWorth, Total, Worth
from mission.proof_log import Setpoints
from mission.recorder import Recorder


@pytest.fixture
def run(tmp_path, flight, record):
    return record(tmp_path, flight)


def test_the_numbers_are_those_of_the_messages(run):
    """Five slots of rates (1, 3) Mbit/s, the second with (0.1, 3); 200 W each; one slot of each outcome."""
    got = report.summarise(run, flight_log.read(run), None)
    assert (got.slots, got.slots_planned, got.exit_code, got.ended) == (5, 5, 0, "flown as planned")
    assert [user.region for user in got.users] == ["reflection", "transmission"]
    assert got.users[0].mean_rate_bps == pytest.approx((4 * 1e6 + 1e5) / 5)
    assert got.users[1].mean_rate_bps == pytest.approx(3e6)
    assert [user.below_qos for user in got.users] == [pytest.approx(0.2), 0.0]
    usual, starved = 4 / (1 / 1 + 1 / 3) / 4, 4 / (1 / 0.1 + 1 / 3) / 3.1
    assert got.hfi == pytest.approx((4 * usual + starved) / 5)
    assert got.sum_rate_bps == pytest.approx((4 * 4e6 + 3.1e6) / 5)
    assert (got.energy_j, got.power_w) == (pytest.approx(1000), pytest.approx(200))
    assert got.efficiency_bit_per_j == pytest.approx((4 * 4e6 + 3.1e6) / 1000)
    assert got.displacement.commanded_m == pytest.approx(2 * 5.0), "a 3-4-5 triangle in the two slots acted on"
    assert got.displacement.planned_m == pytest.approx(2 * 1.0)
    assert got.displacement.flown_m == pytest.approx(5 * 0.9)
    assert got.actions == dict.fromkeys(["flown", "clipped", "late", "missing", "rejected"], 1)


def test_files_and_table(run):
    written = report.write(run)
    assert json.loads((run / "report.json").read_text())["energy_j"] == pytest.approx(1000)
    assert (run / "report.png").read_bytes().startswith(b"\x89PNG")
    console = Console(record=True, width=120)
    console.print(report.table(written))
    text = console.export_text()
    assert re.findall(r"(\d) │ (reflection|transmission)", text) == [("0", "reflection"), ("1", "transmission")]
    for part in (
        "820",
        "20%",
        "3.820 Mbit/s",
        "1.00 kJ (200 W)",
        "19.10 kbit/J",
        "10.0 / 2.0 / 4.5 m",
        "1 / 1 / 1 / 1",
    ):
        assert part in text


def test_a_flight_that_never_reached_a_slot_has_a_report_and_no_picture(tmp_path):
    with open_session(listen=free_endpoint()) as session, Recorder(session, "t", tmp_path / "flight.mcap"):
        pass
    written = report.write(tmp_path)
    assert (written.slots, written.users, written.exit_code, written.hfi) == (0, [], None, 0.0)
    assert not (tmp_path / "report.png").exists()
    console = Console(record=True, width=120)
    console.print(report.table(written))
    (line,) = console.export_text().splitlines()
    assert line.endswith(": no slot was flown; the flight ended with: the log holds no end of the flight")


def test_what_a_flight_without_slots_contradicts_is_shown(tmp_path, record):
    log = flight_log.read(record(tmp_path, []))
    sent = Setpoints(2, {"hold": 2}, {}, 0.05, None, 0.1, ["setpoint at 3.00 s: slot 9 never opened"])
    console = Console(record=True, width=120)
    console.print(report.table(replace(report.summarise(tmp_path, log, None), setpoints=sent)))
    text = console.export_text()
    assert "setpoint at 3.00 s: slot 9 never opened" in text
    assert re.search(r"setpoints\s+│\s+2 │", text)


def test_a_disk_that_is_full_leaves_the_last_report_whole(run):
    report.write(run)
    before = {name: (run / name).read_bytes() for name in ("report.json", "report.png")}
    code = (
        "import pathlib, resource, sys\n"
        "from mission import report\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)\n"
        "try:\n    report.write(pathlib.Path(sys.argv[1]))\n"
        "except OSError as error:\n    print(error.strerror)"
    )
    for most in (100, 20_000):  # not even the numbers, and not the picture
        done = subprocess.run([sys.executable, "-c", code, run, str(most)], capture_output=True, text=True, check=True)
        assert done.stdout == "File too large\n"
        assert {path.name: path.read_bytes() for path in run.glob("report*")} == before


def test_a_recording_cut_short_still_gives_a_report_that_says_so(run):
    path = run / "flight.mcap"
    path.write_bytes(path.read_bytes()[:12000])
    written = report.write(run)
    assert not written.log_complete
    assert 0 < written.slots < 5
    console = Console(record=True, width=120)
    console.print(report.table(written))
    assert "recording cut short" in console.export_text()


def shown(written, width=80):
    console = Console(record=True, width=width)
    console.print(report.table(written))
    return console.export_text()


def slot_flyability(slot):
    worth = SlotWorth(rate_bps=Places(3e6, 2e6, 1e6), reward=Places(3.0, 2.0, 1.0))
    return SlotFlyability(
        slot=slot,
        outcome="flown",
        commanded_m=5.0,
        planned_m=1.0,
        flown_m=0.9,
        limits_m=4.0,
        tracking_rms_m=0.1,
        energy_j=Places(180.0, 190.0, 200.0),
        as_set=worth,
        anew=worth,
    )


FLYABLE = Flyability(
    difference="",
    slots=3,
    left_out=[2, 4],
    limits_rms_m=4.25,
    tracking_rms_m=0.125,
    energy_j=Total(540.0, 570.0, 600.0, 30.0, 30.0),
    as_set=Worth(rate_bps=Total(3e6, 2.5e6, 1e6, 0.5e6, 1.5e6), reward=Total(9.0, 6.5, 3.25, 2.5, 3.25)),
    anew=Worth(rate_bps=Total(4e6, 3.75e6, 3.5e6, 0.25e6, 0.25e6), reward=Total(12.0, 11.5, 10.5, 0.5, 1.0)),
    anew_by="closed_form",
    by_slot=[slot_flyability(slot) for slot in (0, 1, 3)],
)


def test_what_was_lost_to_flight_dynamics_is_shown(run):
    written = replace(report.summarise(run, flight_log.read(run), None), flyability=FLYABLE)
    lines = {
        row[1].strip(): [cell.strip() for cell in row[2:-1]]
        for line in shown(written).splitlines()
        if len(row := line.split("│")) == 8
    }
    assert lines == {
        "distance, m RMS": ["", "", "", "4.25", "0.12"],
        "rate as set, Mbit/s": ["3.000", "2.500", "1.000", "0.500", "1.500"],
        "reward as set": ["9.00", "6.50", "3.25", "2.50", "3.25"],
        "rate anew, Mbit/s": ["4.000", "3.750", "3.500", "0.250", "0.250"],
        "reward anew": ["12.00", "11.50", "10.50", "0.50", "1.00"],
        "energy, kJ": ["0.54", "0.57", "0.60", "0.03", "0.03"],
    }
    text = shown(written)
    assert "flyability: 3 slots, surface as set in flight, or set anew (closed form)" in text
    assert "left out: 2 slots that somebody else flew, the first is 2" in text
    assert "trusted" not in text
    assert "flyability cannot be trusted: slot 0 was" in shown(
        replace(written, flyability=replace(FLYABLE, difference="slot 0 was another"))
    )
    assert "anew" not in shown(replace(written, flyability=replace(FLYABLE, anew=None, anew_by=None)))


def test_the_picture_has_the_flyability_below(run, tmp_path):
    """Of slots 0, 1 and 3: the one in between is a gap."""
    log = flight_log.read(run)
    written = report.summarise(run, log, None)
    heights = []
    for flyable in (None, FLYABLE, replace(FLYABLE, anew=None, anew_by=None)):
        path = tmp_path / "picture.png"
        draw(log, replace(written, flyability=flyable), None, path)
        heights.append(struct.unpack(">I", path.read_bytes()[20:24])[0])
    assert heights[1] == heights[2] > 1.2 * heights[0]


def test_without_its_mission_a_flight_has_no_flyability_and_that_is_told(run):
    written = report.write(run)
    assert written.flyability is None
    assert "unknown: no mission.yaml" in shown(written)


def test_setpoints_and_what_contradicts_them_are_shown(run):
    written = report.summarise(run, flight_log.read(run), None)
    assert written.setpoints.by_source == {"hold": 5}
    assert "action age" not in shown(replace(written, setpoints=None))
    told = Setpoints(
        number=321,
        by_source={"transit": 300, "policy": 21},
        clipped={"fence": 4},
        longest_interval_s=0.0512,
        max_action_age_s=1.25,
        max_state_age_s=0.11,
        contradictions=["setpoint at 3.00 s: slot 9 never opened"],
    )
    text = shown(replace(written, setpoints=told))
    assert re.search(r"setpoints +│ +321 │", text)
    assert re.search(r"setpoints clipped +│ +fence 4 │", text)
    assert "0.05 / 1.25 / 0.11 s" in text
    assert "proof log: setpoint at 3.00 s: slot 9 never opened" in text
    assert "0.05 / none / 0.11 s" in shown(replace(written, setpoints=replace(told, max_action_age_s=None)))
