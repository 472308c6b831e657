"""The failure matrix is one table: its rows are those that are flown, and those that docs/safety.md shows."""

import re
from pathlib import Path

from tests.failure_matrix.rows import ROWS, table

ROOT = Path(__file__).parents[2]


def test_the_documents_table_is_the_matrix():
    text = (ROOT / "docs" / "safety.md").read_text()
    section = text.split("## Who acts when what fails", 1)[1].split("\n## ", 1)[0]
    shown = [line for line in section.splitlines() if line.startswith("|")]
    assert shown[: len(table())] == table(), "python -m tests.failure_matrix.rows"


def test_every_row_is_flown():
    sources = "".join(path.read_text() for path in sorted((ROOT / "tests").glob("*/test_failure_matrix_*.py")))
    quoted = re.findall(r'"([^"\n]*)"', sources)
    for node in ("agent", "rf"):
        quoted += [text.replace("{node}", node) for text in quoted if text.startswith("{node}")]
    assert set(ROWS) <= set(quoted), set(ROWS) - set(quoted)
