"""One run of the kit, from a URL to an exit code."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from rich.console import Console

from sitl.conformance import report
from sitl.conformance.autopilots import by_name
from sitl.conformance.checks import Check
from sitl.conformance.outcome import Failed, Outcome
from sitl.conformance.run import leave, meet, run
from sitl.conformance.suite import names, selected
from sitl.conformance.vehicle import Vehicle
from sitl.conformance.wire import Logged, WireError, connect


@contextmanager
def interruptible() -> Iterator[None]:
    """SIGTERM is Ctrl-C too, and Ctrl-C is heard even when started with it ignored (a shell's `&`, nohup).

    The vehicle must not be left flying.
    """

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def main(url: str, personality: str | None, level: int, only: list[str], json: bool, tlog: Path | None) -> int:
    """The exit code. Raises WireError for a URL or log that cannot be used, ValueError for a check that is none."""
    unknown = [name for name in only if name not in names()]
    if unknown:
        raise ValueError(f"--only {unknown[0]!r}: no such check; there are {', '.join(names())}")
    checks = selected(level, frozenset(only))
    wire = connect(url)
    if tlog is not None:
        wire = Logged(wire, tlog)
    progress = Console(stderr=True)
    v = Vehicle(wire, by_name(personality) if personality else None)
    outcomes: list[Outcome] = []
    wrong: list[str] = []
    try:
        with interruptible(), progress.status("waiting for a HEARTBEAT ...") as status:

            def tell(check: Check) -> None:
                status.update(f"level {check.level}: {check.name} ...")

            try:
                meet(v)
                run(v, checks, outcomes, tell)
            except KeyboardInterrupt:
                wrong.append("interrupted")
            status.update("landing, restoring ... (Ctrl-C once more leaves the vehicle as it is)")
            wrong += leave(v)
    except (Failed, WireError) as failure:
        print(f"error: {url}: {failure}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        wrong.append("interrupted twice: the vehicle may still fly")
    finally:
        wire.close()
    autopilot = f"{v.autopilot.name} at {url}" if v.known else url
    if json:
        print(report.as_json(outcomes, autopilot, wrong))
    else:
        report.show(Console(), outcomes, autopilot, wrong)
    return 1 if wrong or any(outcome.verdict == "fail" for outcome in outcomes) else 0
