"""Every test that docs/safety.md and docs/security.md name is there, and every row of their tables names one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = {"safety.md": ("| hazard |", "| loader |"), "security.md": ("| entry point |",)}
NAMED = re.compile(r"`(tests/[\w/.]+)?(?:::(\w+))?`")


def tables(page: str, heads: tuple[str, ...]) -> list[str]:
    """Rows of the tables that begin with these heads."""
    rows, inside = [], False
    for line in (ROOT / "docs" / page).read_text(encoding="utf-8").splitlines():
        inside = line.startswith(heads) or (inside and line.startswith("|"))
        if inside and not line.startswith((*heads, "| ---")):
            rows.append(line)
    return rows


def missing(row: str) -> list[str]:
    """Named files and tests of a row that are not there; `::name` alone stands in the file named before it."""
    pair, path = [], ""
    for file, test in NAMED.findall(row):
        path = file or path
        if not path or not (ROOT / path).exists():
            pair.append(path or f"::{test}")
        elif test and not re.search(rf"^def {test}\(", (ROOT / path).read_text(encoding="utf-8"), re.M):
            pair.append(f"{path}::{test}")
    return pair


@pytest.mark.parametrize("page", PAGES)
def test_every_row_names_tests_that_are_there(page: str) -> None:
    rows = tables(page, PAGES[page])
    assert len(rows) > 15
    without = [
        row
        for row in rows
        if not re.search(r"`tests/", row) and not re.search(r"golden vectors|by construction|below \|$", row)
    ]
    assert without == []
    assert [gap for row in rows for gap in missing(row)] == []


def test_what_is_not_there_is_found() -> None:
    assert missing("| a | `tests/contract/test_gone.py` |") == ["tests/contract/test_gone.py"]
    assert missing("| a | `tests/contract/test_named_tests.py::test_gone` |") == [
        "tests/contract/test_named_tests.py::test_gone"
    ]
    assert missing("| a | `tests/contract/test_named_tests.py::missing`, `::tables`, `::none` |") == [
        "tests/contract/test_named_tests.py::none"
    ]
