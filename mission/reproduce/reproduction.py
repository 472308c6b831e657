"""A figure reproduced, and how it is written."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure
from rich.table import Table

Cell = str | int | float


@dataclass(frozen=True)
class Data:
    """What one CSV file holds; names of quantities end in their unit."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]


@dataclass(frozen=True)
class Reproduction:
    """What reproducing a figure gave."""

    data: Mapping[str, Data]
    """By file stem."""
    figure: Figure
    tables: Sequence[Table]
    """What was found beside what the paper says."""
    note: str
    """What the numbers rest on and where they differ."""


def write(name: str, reproduction: Reproduction, folder: Path) -> list[Path]:
    """Write NAME.png and the CSV files into a folder that exists; returns their paths. Raises OSError."""
    picture = folder / f"{name}.png"
    reproduction.figure.savefig(picture, format="png", dpi=100, facecolor="white", pil_kwargs={"optimize": True})
    written = [picture]
    for stem, data in reproduction.data.items():
        path = folder / f"{stem}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(data.columns)
            rows.writerows([_text(cell) for cell in row] for row in data.rows)
        written.append(path)
    return written


def table(title: str, *columns: str) -> Table:
    """A table whose first column is text and whose others are figures."""
    made = Table(title=title, title_justify="left")
    for number, column in enumerate(columns):
        made.add_column(column, justify="left" if number == 0 else "right")
    return made


def _text(cell: Cell) -> str:
    return f"{cell:.8g}" if isinstance(cell, float) else str(cell)
