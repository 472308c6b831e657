"""`aerialstar reproduce`: files that hold the numbers, the same for the same seed."""

import csv
import io
import subprocess
import sys

import pytest
from PIL import Image
from rich.console import Console

from mission.reproduce import FIGURES
from mission.reproduce.run import run

COLUMNS = {
    "power_vs_speed": {"speed_mps", "power_w", "marker"},
    "hfi_vs_jfi": {"p_max_dbm", "below_qos_share", "below_qos_half_width_95"},
    "efficiency_vs_elements": {"elements", "efficiency_bit_per_j", "efficiency_half_width_95_bit_per_j"},
    "ris_types": {"surface", "reward", "reward_half_width_95", "reward_over_dual"},
    "complexity": {"operations", "parameters"},
}


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module", params=FIGURES)
def reproduced(request, tmp_path_factory):
    """A figure, its folder, and what was printed."""
    folder = tmp_path_factory.mktemp(request.param)
    told = io.StringIO()
    run(request.param, folder, seed=3, episodes=2, console=Console(file=told, width=80))
    return request.param, folder, told.getvalue()


def test_every_figure_writes_a_picture_and_its_numbers_and_says_where(reproduced):
    name, folder, printed = reproduced
    with Image.open(folder / f"{name}.png") as picture:
        assert picture.width > 800
        assert picture.convert("L").getextrema()[0] < 60  # something is drawn on the white
    found = rows(folder / f"{name}.csv")
    assert COLUMNS[name] <= set(found[0])
    for path in folder.iterdir():
        assert str(path) in printed
    assert "…" not in printed  # nothing is cut off in a narrow terminal
    for row in found:
        assert all(cell != "nan" for cell in row.values())
    assert "paper" in printed
    assert "prototype" in printed or name == "power_vs_speed"


def test_the_same_seed_writes_the_same_bytes_and_another_other_ones(reproduced, tmp_path):
    name, folder, _ = reproduced
    for seed in (3, 4):
        run(name, tmp_path / str(seed), seed=seed, episodes=2, console=Console(quiet=True))
    random = name not in ("power_vs_speed", "complexity")
    for path in folder.glob("*.csv"):
        assert (tmp_path / "3" / path.name).read_bytes() == path.read_bytes()
        if random and path.stem == name:
            assert (tmp_path / "4" / path.name).read_bytes() != path.read_bytes()


def test_markers_in_the_file_are_the_least_of_their_curves(tmp_path):
    run("power_vs_speed", tmp_path, seed=0, episodes=None, console=Console(quiet=True))
    found = rows(tmp_path / "power_vs_speed.csv")
    for induced in ("sqrt", "printed"):
        for elements in ("0", "16", "64", "256", "1024"):
            curve = [row for row in found if (row["induced"], row["elements"]) == (induced, elements)]
            speeds = [float(row["speed_mps"]) for row in curve]
            assert speeds == sorted(speeds)
            assert speeds[0] == 0
            assert speeds[-1] == 30
            least = min(curve, key=lambda row: float(row["power_w"]))
            furthest = min(curve[1:], key=lambda row: float(row["power_w"]) / float(row["speed_mps"]))
            assert (least["marker"], furthest["marker"]) == ("max_endurance", "max_range")


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["fig_7"], "'fig_7' is not one of power_vs_speed, hfi_vs_jfi, efficiency_vs_elements, ris_types, complexity"),
        (["complexity", "--out", "/proc/x"], "--out: '/proc/x' cannot be made"),
        (["complexity", "--episodes", "1"], "--episodes"),
        (["complexity", "--seed", "-1"], "--seed"),
        ([], "FIGURE"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_2(arguments, named):
    command = [sys.executable, "-m", "mission", "reproduce", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert named in line
