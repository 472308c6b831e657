"""The command line answers at once: `--help` imports none of the heavy libraries."""

import subprocess
import sys

import pytest

HEAVY = ("torch", "numba", "matplotlib", "zenoh", "numpy", "pymavlink", "gymnasium", "foxglove")
COMMANDS = ("fly", "sitl", "rf", "agent", "bridge", "train", "report", "replay", "reproduce")


@pytest.mark.parametrize(
    "arguments",
    [["--help"], *([command, "--help"] for command in COMMANDS), ["rf", "evaluate", "--help"]],
    ids=" ".join,
)
def test_help_is_there_on_every_level_without_heavy_imports(arguments):
    code = (
        "import sys\n"
        "from mission.cli import app\n"
        f"app({arguments!r}, standalone_mode=False)\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip() == "[]"
    assert "Usage:" in done.stdout
    if arguments == ["--help"]:
        assert all(command in done.stdout for command in COMMANDS)


def test_the_installed_command_is_this_one():
    done = subprocess.run([sys.executable, "-m", "mission", "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "aerialstar" in done.stdout or "mission" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["report", "{tmp}"], "no flight.mcap"),
        (["replay", "{tmp}"], "mission.yaml"),
        (["fly", "{tmp}/none.yaml"], "none.yaml: No such file"),
        (["fly"], "MISSION"),
        (["fly", "{tmp}/none.yaml", "--seed", "seven"], "--seed"),
        (["fly", "{tmp}/none.yaml", "--sped", "2"], "--speed"),
        (["flee"], "flee"),
        (["sitl", "--speed", "nan"], "--speed"),
        (["sitl", "--param", "NONSENSE"], "NONSENSE"),
        (["sitl", "--home", "nowhere"], "--home"),
        (["rf", "--mission", "{tmp}/none.yaml", "--connect", "nonsense"], "'nonsense' must be PROTOCOL/ADDRESS"),
        (["rf", "--mission", "{tmp}/none.yaml", "--vehicle", "a", "--vehicle", "a"], "'a' is given twice"),
        (["rf", "--mission", "{tmp}/none.yaml", "--vehicle", "a", "--vehicle", "b/c"], "'b/c' must be"),
        (["agent", "--mission", "{tmp}/none.yaml", "--listen", "nonsense"], "'nonsense' must be PROTOCOL/ADDRESS"),
        (["rf"], "--mission"),
        (["rf", "--vehicle", "star1"], "--mission"),
        (["rf", "evaluat"], "evaluat"),
        (["rf", "evaluate"], "SNAPSHOT"),
        (["rf", "evaluate", "{tmp}/none.yaml"], "none.yaml: No such file"),
        (["train", "{tmp}"], "--offline"),
        (["train", "--offline"], "--offline"),
        (["train", "--preset", "big", "--out", "{tmp}/out"], "physical_small"),
        (["train", "--episodes", "0", "--out", "{tmp}/out"], "episodes: 0 is not allowed"),
        (["train", "--out", "/proc/x"], "--out: '/proc/x' cannot be made"),
        (["train", "--config", "{tmp}/none.yaml"], "none.yaml"),
        (["train", "--offline", "{tmp}"], "mission.yaml"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_2(tmp_path, arguments, named):
    command = [sys.executable, "-m", "mission", *(part.format(tmp=tmp_path) for part in arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert named in line
