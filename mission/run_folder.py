"""The run folder: made before the flight, so that whatever happens there is a place that says what was tried."""

import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import distribution, version
from pathlib import Path

from mission.fleet import Fleet
from mission.flight_log import FILE_NAME as LOG_NAME
from mission.mission_file import Mission, MissionError, Shared, dump

MISSION_NAME = "mission.yaml"
VERSIONS_NAME = "versions.json"
SOURCE = Path(__file__).resolve().parents[1]


def make(mission: Mission | Fleet) -> Path:
    """Make `<output>/<UTC time>_<name>/` with the resolved mission, the versions and `logs/`.

    Of several vehicles each has a folder in it, by its name, with the mission resolved for it alone.

    Raises MissionError when the output folder cannot be written.
    """
    started = datetime.now(UTC)
    base = f"{started:%Y%m%dT%H%M%SZ}_{mission.name}"
    try:
        mission.output.mkdir(parents=True, exist_ok=True)
        run = _new_folder(mission.output, base)
        (run / "logs").mkdir()
        (run / MISSION_NAME).write_text(dump(mission), encoding="utf-8")
        if isinstance(mission, Fleet):
            for one in mission.missions:
                folder = vehicle_folder(run, mission, one)
                folder.mkdir()
                (folder / MISSION_NAME).write_text(dump(one), encoding="utf-8")
        (run / VERSIONS_NAME).write_text(json.dumps(_versions(mission, started), indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise MissionError(
            f"output: {str(mission.output)!r} cannot be written ({error.strerror}); name a writable folder"
        ) from error
    return run


def vehicle_folder(run: Path, mission: Mission | Fleet, vehicle: Mission) -> Path:
    """Where a vehicle's recordings and report lie: the run folder, or one in it when there are several."""
    return run / vehicle.vehicle.name if isinstance(mission, Fleet) else run


def recorded(run: Path) -> list[Path]:
    """The folders with a recording: the run folder itself, or its vehicles' when there are several."""
    vehicles = sorted(log.parent for log in run.glob(f"*/{LOG_NAME}"))
    return vehicles if vehicles and not (run / LOG_NAME).exists() else [run]


def _new_folder(output: Path, base: str) -> Path:
    number = 1
    while True:
        run = output / (base if number == 1 else f"{base}-{number}")
        try:
            run.mkdir()
        except FileExistsError:
            number += 1
        else:
            return run


def _versions(mission: Shared, started: datetime) -> dict[str, object]:
    requirements = distribution("aerial-star").requires or []
    names = sorted({_name(line) for line in requirements if "extra ==" not in line})
    return {
        "started": started.isoformat(timespec="seconds"),
        "seed": mission.seed,
        "aerial-star": version("aerial-star"),
        "commit": _commit(),
        "python": platform.python_version(),
        "libraries": {name: version(name) for name in names},
        "machine": {
            "system": platform.platform(),
            "processor": platform.machine(),
            "cores": os.cpu_count(),
        },
        "command": sys.argv,
    }


def _name(requirement: str) -> str:
    end = next((at for at, letter in enumerate(requirement) if not (letter.isalnum() or letter in "-_.")), None)
    return requirement[:end]


def _commit() -> str | None:
    """The source's commit, with `+` when it was changed since; None outside a git checkout."""
    if not (SOURCE / ".git").exists():
        return None
    try:
        commit = _git("rev-parse", "HEAD")
        return commit + ("+" if _git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(SOURCE), *arguments], capture_output=True, text=True, check=True, timeout=5)
    return done.stdout.strip()
