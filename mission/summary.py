"""What the flights of a mission of several vehicles came to, a line each."""

from collections.abc import Mapping

from rich.table import Table

from autopilot_bridge.endings import AS_PLANNED, ERROR, FAILSAFE
from mission.report import Report

ENDED: dict[int | None, str] = {AS_PLANNED: "as planned", ERROR: "error", FAILSAFE: "by failsafe"}


def summary(codes: Mapping[str, int | None], reports: Mapping[str, Report]) -> Table:
    """A row for each vehicle by name: its exit code, and what its report says when there is one."""
    table = Table("vehicle", "ended", "slots", "actions flown", "mean sum rate", "energy", box=None)
    for name, code in codes.items():
        ended = ENDED.get(code, "not at all")
        report = reports.get(name)
        if report is None:
            table.add_row(name, ended)
            continue
        actions = ", ".join(f"{count} {outcome}" for outcome, count in report.actions.items() if count)
        table.add_row(
            name,
            ended,
            f"{report.slots} of {report.slots_planned}",
            actions,
            f"{report.sum_rate_bps / 1e6:.2f} Mbit/s",
            f"{report.energy_j / 1e3:.1f} kJ",
        )
    return table
