"""Outcomes as a table, and as JSON."""

import json
from collections import Counter
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table

from sitl.conformance.outcome import Outcome

COLOURS = {"pass": "green", "fail": "red", "skip": "yellow"}


def counted(outcomes: Sequence[Outcome]) -> dict[str, int]:
    counts: Counter[str] = Counter(outcome.verdict for outcome in outcomes)
    return {verdict: counts[verdict] for verdict in COLOURS}


def show(console: Console, outcomes: Sequence[Outcome], autopilot: str, wrong: Sequence[str]) -> None:
    """One row per check."""
    table = Table(box=box.SIMPLE_HEAD, title=f"Conformance of {autopilot}", title_justify="left")
    table.add_column("level", justify="right")
    table.add_column("check", no_wrap=True)
    table.add_column("")
    table.add_column("seen", overflow="fold")
    table.add_column("clause", style="dim", overflow="fold")
    for level, name, verdict, seen, clause, _ in outcomes:
        table.add_row(str(level), name, f"[{COLOURS[verdict]}]{verdict}[/]", escaped(seen), escaped(clause))
    console.print(table)
    counts = counted(outcomes)
    console.print(", ".join(f"{number} {verdict}" for verdict, number in counts.items()))
    for sentence in wrong:
        console.print(f"[red]{escaped(sentence)}[/]")


def escaped(text: str) -> str:
    """Text that may hold brackets."""
    return text.replace("[", r"\[")


def as_json(outcomes: Sequence[Outcome], autopilot: str, wrong: Sequence[str]) -> str:
    """One object: autopilot, counts, what could not be restored, checks."""
    return json.dumps(
        {
            "autopilot": autopilot,
            "counts": counted(outcomes),
            "not_restored": list(wrong),
            "checks": [outcome._asdict() for outcome in outcomes],
        },
        indent=2,
    )
