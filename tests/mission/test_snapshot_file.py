"""`aerialstar rf evaluate`: what people and other languages get from it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from mission.snapshot_file import evaluate_file, tables, to_json
from rf_model.snapshot import SnapshotError

EXAMPLE = Path(__file__).parents[2] / "missions" / "snapshot.yaml"


def run(*arguments, stdin=""):
    command = [sys.executable, "-m", "mission", "rf", "evaluate", *map(str, arguments)]
    return subprocess.run(command, input=stdin, capture_output=True, text=True, check=False)


def test_json_is_one_object_also_of_json_on_standard_input():
    done = run("-", "--json", stdin=json.dumps(yaml.safe_load(EXAMPLE.read_text())))
    assert (done.returncode, done.stderr) == (0, "")
    told = json.loads(done.stdout)
    assert told == json.loads(to_json(evaluate_file(EXAMPLE)))
    assert list(told) == [
        *("links", "regions", "noise_w", "transmit_power_w", "sinr", "rate_bps", "below_qos"),
        *("sum_rate_bps", "fair_rate_bps", "hfi", "jfi", "power_terms_w", "power_w", "energy_j", "reward"),
        *("channels", "trc", "beamforming"),
    ]
    assert list(told["power_terms_w"]) == ["blade", "induced", "parasite", "climb", "panel_drag"]
    assert told["sum_rate_bps"] == pytest.approx(sum(told["rate_bps"]))
    assert [len(told["channels"][link]) for link in ("direct", "bs_ris", "ris_user")] == [2, 4, 2]


def test_an_answer_pasted_into_the_question_is_the_same_answer(tmp_path):
    told = json.loads(to_json(evaluate_file(EXAMPLE)))
    fields = yaml.safe_load(EXAMPLE.read_text()) | {name: told[name] for name in ("channels", "trc", "beamforming")}
    path = tmp_path / "again.json"
    path.write_text(json.dumps(fields))
    assert evaluate_file(path).sinr == pytest.approx(told["sinr"])


def test_people_get_tables_with_every_number_of_the_slot():
    done = run(EXAMPLE)
    assert done.returncode == 0, done.stderr
    evaluation = evaluate_file(EXAMPLE)
    for number in (
        f"{evaluation.links.bs_ris.path_loss_los_db:.2f}",
        f"{evaluation.links.direct[1].path_loss_nlos_db:.2f}",
        f"{evaluation.rate_bps[0] / 1e6:.4f}",
        f"{evaluation.sum_rate_bps / 1e6:.4f}",
        f"{evaluation.power_terms_w['panel_drag']:.2f}",
        f"{evaluation.power_w:.2f}",
        f"{evaluation.hfi:.4f}",
        f"{evaluation.jfi:.4f}",
        f"{evaluation.reward:.4f}",
    ):
        assert number in done.stdout
    assert [table.title for table in tables(evaluation)] == ["links", "users", "the slot"]


def test_silence_has_no_decibels(tmp_path):
    path = tmp_path / "s.yaml"
    fields = yaml.safe_load(EXAMPLE.read_text()) | {"beamforming": [[[0, 0]] * 2] * 2}
    path.write_text(yaml.safe_dump(fields))
    evaluation = evaluate_file(path)
    assert (evaluation.hfi, evaluation.sinr) == (0, [0, 0])
    links, users, slot = tables(evaluation)
    assert list(users.columns[2].cells) == ["-", "-"]
    assert "-" in list(slot.columns[1].cells)
    assert links.row_count == 5


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "must hold a mapping of fields (scenario, seed, position_enu"),
        ("[1", "not YAML"),
        ("seed: 1\nseed: 2", "seed: given twice, in lines 1 and 2"),
        ("scenario: physical_small", "position_enu: missing (and 1 more)"),
        ("scenario: physical_small\npositon_enu: [0, 0, 60]", "positon_enu: unknown key, did you mean position_enu or"),
        ('{"scenario": "physical_small", "position_enu": [NaN, 0, 0]}', "position_enu.0: 'NaN' is not allowed"),
    ],
)
def test_bad_input_is_one_line_that_names_file_and_fault(tmp_path, text, part):
    path = tmp_path / "s.yaml"
    path.write_text(text)
    with pytest.raises(SnapshotError) as caught:
        evaluate_file(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert part in line
    assert "\n" not in line


def test_bad_input_is_exit_2_and_nothing_on_stdout():
    done = run("-", "--json", stdin="scenario: physical_small\nposition_enu: [0, 0, .nan]\nusers_enu: [[1, 2, 1.5]]")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "error: -: position_enu.2: nan is not allowed: input should be a finite number\n"


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SnapshotError, match=r"none\.yaml: No such file"):
        evaluate_file(tmp_path / "none.yaml")
