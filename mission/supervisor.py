"""The processes of a mission: started, watched, and never left behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

TERMINATE_S = 5.0
"""How long a process may take to end after SIGTERM before it is killed."""


class Node:
    """One process of the mission; what it prints goes to `logs/<name>.log`.

    It leads a session of its own, so that a Ctrl-C in the terminal reaches the mission process only, and so that the
    loop flies on when that one is gone.
    """

    def __init__(self, name: str, command: Sequence[str], logs: Path) -> None:
        self.name = name
        self.log = logs / f"{name}.log"
        self._command = list(command)
        self.starts = 0
        self._process = self._start()

    def _start(self) -> subprocess.Popen[bytes]:
        self.starts += 1
        environment = os.environ | {"PYTHONUNBUFFERED": "1", "OMP_NUM_THREADS": "1"}  # nodes share the cores
        with self.log.open("ab") as log:
            return subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=environment,
            )

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """None while it runs; negative when a signal ended it."""
        return self._process.poll()

    @property
    def running(self) -> bool:
        return self.exit_code is None

    @property
    def last_words(self) -> str:
        """The last line it printed that is not empty."""
        lines = [line.strip() for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
        return lines[-1] if lines else "(it printed nothing)"

    def printed(self, start: str) -> str | None:
        """What follows `start` on the first line that begins with it; None while there is no such line."""
        for line in self.log.read_text(errors="replace").splitlines(keepends=True):
            if line.startswith(start) and line.endswith("\n"):
                return line.removeprefix(start).strip()
        return None

    def restart(self) -> None:
        """Start it again, on the same log."""
        self._process = self._start()

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; False when it still runs after `timeout_s`."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def kill(self) -> None:
        """SIGKILL, which a stopped process hears too."""
        self._process.kill()
        self._process.wait()

    def end(self) -> None:
        """SIGTERM, then SIGKILL; returns when it is gone."""
        if self.running:
            self._process.terminate()
            if not self.wait(TERMINATE_S):
                self.kill()


def describe_exit(code: int) -> str:
    """`exit 1`, or the name of the signal."""
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    return f"exit {code}"


def end_all(nodes: Sequence[Node], patience_s: float) -> None:
    """Give nodes that end by themselves time to do so, then end what is left."""
    deadline = time.monotonic() + patience_s
    for node in nodes:
        node.wait(max(0.0, deadline - time.monotonic()))
    for node in nodes:
        node.end()


def python(*arguments: str) -> list[str]:
    """A command line that runs a module with this interpreter."""
    return [sys.executable, "-m", *arguments]
