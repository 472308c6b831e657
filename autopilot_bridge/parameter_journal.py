"""What a flight changes of the autopilot's parameters, on disk before it is changed, so that it can be put back.

One file per vehicle, JSON lines, each on disk (fsync) before the parameter is set:

    {"set": "COM_OBL_RC_ACT", "before": 0.0, "value": 3.0}
    {"settled": "COM_OBL_RC_ACT"}

A parameter that is set twice keeps the first `before`. A line without its end was being written when we were killed:
what it announces was not done. When nothing is left to put back the file is empty. While a bridge lives it holds a lock
on the file, which the kernel takes back at its death, so that no other one puts back what a living one has set.
"""

import fcntl
import json
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path

NO_UID = re.compile("0*1?")
"""What a simulator says of its hardware."""


class JournalError(RuntimeError):
    """The journal cannot be read or written, or is another bridge's; the text names the file."""


@dataclass(frozen=True)
class Change:
    """One parameter as it was, and what it was set to since; a value may have been announced and never sent."""

    before: float
    values: tuple[float, ...]


def outstanding(text: str) -> dict[str, Change]:
    """What is still to be put back, by name, after these lines. Raises ValueError naming the line that is none."""
    changes: dict[str, Change] = {}
    for number, line in enumerate(text.split("\n")[:-1], 1):
        try:
            _apply(json.loads(line), changes)
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"line {number} is not readable: {line[:80]!r}") from error
    return changes


def _apply(entry: dict[str, object], changes: dict[str, Change]) -> None:
    match entry:
        case {"set": str(name), "before": float() | int() as before, "value": float() | int() as value, **rest} if (
            not rest and math.isfinite(before) and math.isfinite(value)
        ):
            first = changes.get(name, Change(before, ()))
            changes[name] = Change(first.before, (*first.values, value))
        case {"settled": str(name), **rest} if not rest:
            changes.pop(name, None)
        case _:
            raise ValueError(entry)


def same(one: float, other: float) -> bool:
    """Whether two values of a parameter are one as far as the wire's float32 can tell."""
    return math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-12)


def state_folder() -> Path:
    """Where a user's programs keep what must outlast them: $XDG_STATE_HOME/aerialstar, ~/.local/state by default."""
    base = os.environ.get("XDG_STATE_HOME", "")
    return (Path(base) if base.startswith("/") else Path.home() / ".local" / "state") / "aerialstar"


def journal_name(uid: str, url: str, system_id: int) -> str:
    """The file of a vehicle: by its hardware's id (hex digits), or where it has none by where it is reached."""
    vehicle = re.sub(r"[^A-Za-z0-9.]+", "-", url) if NO_UID.fullmatch(uid) else uid.lower()
    return f"parameters-{vehicle}-{system_id}.jsonl"


class ParameterJournal:
    """The file at `path`, which is made if need be. Raises JournalError."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
        except OSError as error:
            raise JournalError(f"parameter journal {path}: {error.strerror}") from error
        try:
            self._lock_and_read()
        except BaseException:
            os.close(self._file)
            raise

    def _lock_and_read(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise JournalError(
                f"parameter journal {self.path}: in use by another bridge; two must not fly one vehicle"
            ) from error
        try:
            text = self.path.read_text(encoding="utf-8")
            self.outstanding = outstanding(text)
            """What is still to be put back, by name."""
            if text and not text.endswith("\n"):
                os.ftruncate(self._file, len(text[: text.rfind("\n") + 1].encode()))
            self._sync_folder()
        except ValueError as error:
            raise JournalError(
                f"parameter journal {self.path}: {error}; set the autopilot's parameters right, then remove the file"
            ) from error
        except OSError as error:
            raise JournalError(f"parameter journal {self.path}: {error.strerror}") from error

    def changing(self, name: str, before: float, value: float) -> None:
        """On disk when this returns. Raises JournalError, and then the parameter must not be set."""
        self._write({"set": name, "before": before, "value": value})

    def settled(self, name: str) -> None:
        """Put back, or no longer ours to put back. Raises JournalError."""
        self._write({"settled": name})
        if not self.outstanding:
            try:
                os.ftruncate(self._file, 0)
            except OSError as error:
                raise JournalError(f"parameter journal {self.path}: {error.strerror}") from error

    def close(self) -> None:
        os.close(self._file)

    def _write(self, entry: dict[str, object]) -> None:
        line = json.dumps(entry) + "\n"
        size = os.fstat(self._file).st_size
        try:
            if os.write(self._file, line.encode()) != len(line.encode()):
                os.ftruncate(self._file, size)  # half a line would spoil the next one
                raise OSError(0, "the disk is full")
            os.fsync(self._file)
        except OSError as error:
            raise JournalError(f"parameter journal {self.path}: {error.strerror}") from error
        _apply(entry, self.outstanding)

    def _sync_folder(self) -> None:
        """So that the file's name is on disk too."""
        folder = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)
