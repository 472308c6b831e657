import json
import os
import signal
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot_bridge.parameter_journal import (
    Change,
    JournalError,
    ParameterJournal,
    journal_name,
    outstanding,
    same,
    state_folder,
)

NAMES = st.sampled_from(["A", "B", "C"])
VALUES = st.floats(allow_nan=False, allow_infinity=False, width=32)
STEPS = st.lists(st.one_of(st.tuples(NAMES, VALUES), NAMES), max_size=20)


@given(STEPS, st.integers(min_value=0))
def test_killed_anywhere_it_knows_what_was_before(tmp_path_factory, steps, cut):
    """Against a model: an autopilot whose parameters are set only once the journal has said so."""
    path = tmp_path_factory.mktemp("journal") / "vehicle.jsonl"
    journal = ParameterJournal(path)
    vehicle = {"A": 1.0, "B": 2.0, "C": 3.0}
    begun, seen = dict(vehicle), []
    for step in steps:
        if isinstance(step, tuple):
            name, value = step
            journal.changing(name, vehicle[name], value)
            vehicle[name] = value
        elif step in journal.outstanding:
            vehicle[step] = journal.outstanding[step].before
            journal.settled(step)
        seen.append(path.read_bytes())
    journal.close()
    again = ParameterJournal(path)
    assert {
        name: vehicle[name] if name not in again.outstanding else again.outstanding[name].before for name in vehicle
    } == begun
    assert all(again.outstanding[name].values[-1] == vehicle[name] for name in again.outstanding)
    again.close()
    if seen:  # killed while the last line was written
        path.write_bytes(seen[-1][: len(seen[-1]) - cut % (len(seen[-1]) + 1)])
        torn = ParameterJournal(path)
        torn.changing("A", 5.0, 6.0)
        torn.close()
        assert "A" in outstanding(path.read_text())


def test_the_file_is_empty_when_nothing_is_left(tmp_path):
    path = tmp_path / "new" / "vehicle.jsonl"
    journal = ParameterJournal(path)
    journal.changing("A", 0.0, 3.0)
    journal.changing("A", 3.0, 4.0)
    assert [json.loads(line)["before"] for line in path.read_text().splitlines()] == [0.0, 3.0]
    assert journal.outstanding == {"A": Change(0.0, (3.0, 4.0))}
    journal.settled("A")
    assert path.read_text() == ""
    journal.close()


@pytest.mark.parametrize(
    "line",
    [
        "nonsense",
        "[]",
        "3",
        "{}",
        '{"set": "A"}',
        '{"set": "A", "before": "0", "value": 1}',
        '{"set": "A", "before": NaN, "value": 1}',
    ],
)
def test_a_line_that_is_none_is_named(tmp_path, line):
    path = tmp_path / "vehicle.jsonl"
    path.write_text(f'{{"set": "B", "before": 0, "value": 1}}\n{line}\n')
    with pytest.raises(JournalError, match=r"vehicle.jsonl: line 2 is not readable"):
        ParameterJournal(path)


def test_two_bridges_do_not_share_it_and_a_dead_ones_lock_is_gone(tmp_path):
    path = tmp_path / "vehicle.jsonl"
    program = f"""
import sys, time
from pathlib import Path
from autopilot_bridge.parameter_journal import ParameterJournal
journal = ParameterJournal(Path({str(path)!r}))
journal.changing("A", 0.0, 3.0)
print("set", flush=True)
time.sleep(60)
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]
    )
    assert process.stdout.readline() == "set\n"
    with pytest.raises(JournalError, match="in use by another bridge"):
        ParameterJournal(path)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    journal = ParameterJournal(path)
    assert journal.outstanding == {"A": Change(0.0, (3.0,))}
    journal.close()


def test_a_full_disk_is_told_and_leaves_no_half_line(tmp_path):
    program = f"""
import resource, signal
from pathlib import Path
from autopilot_bridge.parameter_journal import JournalError, ParameterJournal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
journal = ParameterJournal(Path({str(tmp_path / "vehicle.jsonl")!r}))
journal.changing("A", 0.0, 3.0)
try:
    for _ in range(10):
        journal.changing("B", 0.0, 3.0)
except JournalError as error:
    print(error)
"""
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parents[2], timeout=60
    )
    assert "vehicle.jsonl" in result.stdout, result.stderr
    text = (tmp_path / "vehicle.jsonl").read_text()
    assert text.endswith("\n")
    assert set(outstanding(text)) == {"A", "B"}


def test_a_place_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(JournalError, match=r"parameter journal .*file/vehicle.jsonl"):
        ParameterJournal(tmp_path / "file" / "vehicle.jsonl")


def test_it_lies_with_the_users_state(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_folder() == tmp_path / "aerialstar"
    monkeypatch.setenv("XDG_STATE_HOME", "relative")  # to be ignored, says the XDG specification
    monkeypatch.setenv("HOME", "/home/somebody")
    assert state_folder() == Path("/home/somebody/.local/state/aerialstar")


def test_vehicles_are_told_apart_by_their_hardware():
    assert journal_name("00AB12", "udpin://127.0.0.1:14540", 1) == "parameters-00ab12-1.jsonl"
    for simulated in ("", "0000", "0001"):
        assert journal_name(simulated, "udpin://127.0.0.1:14540", 2) == "parameters-udpin-127.0.0.1-14540-2.jsonl"


@given(VALUES)
def test_what_the_wire_rounds_is_the_same(value):
    assert same(value, struct.unpack("<f", struct.pack("<f", value))[0])
    assert not same(0.0, 3.0)
