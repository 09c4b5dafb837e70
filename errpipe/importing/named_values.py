"""Logs with a name before every value: prints of NC programs (DPRNT, FN16, WRITE), line protocols."""

from __future__ import annotations

import re
from collections import Counter

from errpipe.importing.sheet import Cell, Sheet, filled_cells, label, number
from errpipe.importing.units import unit_of

_VALUE = r"[+-]?\s?(?:\d+(?:[.,]\d+)*|[.,]\d+)(?:[eE][+-]?\d+)?"
_PAIR = re.compile(  # `X_SOLL=1.5`, `RUN*1`, `SOLLWERT X : 1,5 MM`, `#5061=1.5`, `DIR=PLUS`
    rf"\s*([^\W\d][^=:*]*?|#\d+)\s*[=:*]\s*({_VALUE}|[^\W\d][\w.]*|[+-](?![\w.]))(?:\s*(?!\w+\s*[=:*])([^\W\d]{{1,4}}|\")(?=[\s;,]|$))?[\s;,]*"
)
_TICKS = re.compile(r"\d{10,19}")  # of a line protocol: the time stamp after all values
FEWEST_ROWS = 3  # of a table
MOSTLY = 0.8  # share of the lines that are names and values; share of the rows that contain a name


def tabled(sheet: Sheet) -> Sheet:
    """The sheet with one column per name, if its lines are names and values; any other sheet unchanged.

    A row ends where the first of the names that occur in every row repeats, in the same line or in a later one.
    """
    cells = [[label(c) for c in filled_cells(row)] for row in sheet.rows]
    for mark in (" ", ",") if sheet.header is None else ():  # a decimal comma may have split the cells
        lines = [line for row in cells if re.search(r"\w", line := mark.join(row))]
        found = [_pairs(line) for line in lines]
        count = Counter(name for of_line in found for name, _, _ in of_line)
        most = max(count.values(), default=0)
        names = [name for name, n in count.items() if n >= MOSTLY * most]
        named = [any(name in names for name, _, _ in of_line) for of_line in found]
        if most >= FEWEST_ROWS and len(names) > 1 and sum(named) >= MOSTLY * len(lines):
            above = [line for line, of_rows in zip(lines, named, strict=True) if not of_rows]
            return _table(sheet, names, [pair for of_line in found for pair in of_line if pair[0] in names], above)
    return sheet


def _table(sheet: Sheet, names: list[str], pairs: list[tuple[str, str, str]], above: list[str]) -> Sheet:
    rows, units = list[dict[str, str]](), dict[str, str]()
    for name, value, unit in pairs:
        if not rows or name == names[0] or name in rows[-1]:
            rows.append({})
        rows[-1][name] = value
        units |= {name: unit} if unit_of(unit) else {}
    if max(sum(number(v, "," in v) is not None for v in row.values()) for row in rows) < 2:
        return sheet
    header = [f"{name} [{units[name]}]" if name in units else name for name in names]
    cells: list[list[Cell]] = [[row.get(name) for name in names] for row in rows]
    notes = [*sheet.notes, f"values with their names: {len(names)} names became columns"]
    return Sheet(sheet.name, cells, header, notes, [*sheet.above, *above])


def _pairs(line: str) -> list[tuple[str, str, str]]:
    """Names, values and units of a line; empty if it contains anything else."""
    out = [(m[1].strip(), m[2], m[3] or "") for m in _PAIR.finditer(line)]
    rest = _PAIR.sub("", line).strip()
    return [*out, ("time stamp", rest, "")] if out and _TICKS.fullmatch(rest) else [] if rest else out
