"""The report of a flight whose numbers are known."""

import json
import re
import subprocess
import sys

import pytest
from rich.console import Console

from bus.session import free_endpoint, open_session
from mission import flight_log, report
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
