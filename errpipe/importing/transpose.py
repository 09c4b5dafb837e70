"""Sheets with targets across and runs down, as printed in ISO 230-2: transposed to one row per target.

A row of target positions precedes the readings; the approach direction is in a row below it, or
in a line above each block of runs.
"""

from __future__ import annotations

import re
from itertools import pairwise

from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing.layout import DEEPEST_HEADER
from errpipe.importing.sheet import Cell, Rows, Sheet, decimal_comma, label, number, of_one_mark
from errpipe.importing.units import split_header
from errpipe.importing.wide import run_and_side, statistic

Figures = list[float | None]
FEWEST_TARGETS = 4  # positions in a row of targets; with fewer it is another kind of table
_TARGETS = re.compile(r"(target|soll|nominal|position|ziel|cible|目標|目标)", re.IGNORECASE)
_READINGS = re.compile(r"(deviation|abweich|error|fehler|ecart|scostamento|偏差|误差)", re.IGNORECASE)


def transposed(sheet: Sheet) -> Sheet:
    """The sheet with one row per target if its targets are in a row; any other sheet unchanged."""
    comma = decimal_comma(sheet.rows)
    rows = [] if sheet.header is not None else sheet.rows[:DEEPEST_HEADER]
    at = next((r for r, row in enumerate(rows) if _are_targets(row, rows[r + 1 : r + 4], comma)), None)
    if at is None:
        return sheet
    try:
        targets = [number(c, comma) for c in of_one_mark(sheet.rows[at], comma)]
    except ValueError as err:
        raise DataError(
            f"targets: {err} has an ambiguous thousands or decimal separator (write it without thousands separators)"
        ) from None
    places = [i for i, v in enumerate(targets) if v is not None]
    sides = _sides(sheet.rows[at + 1], places) if at + 1 < len(sheet.rows) else None
    out: list[tuple[str | None, str, float | None, Figures]] = []
    run, side, title = 0, None, ""
    for row in sheet.rows[at + 1 + (sides is not None) :]:
        name = label(row[0]) if row else ""
        figures = [number(row[i], comma) if i < len(row) else None for i in range(len(targets))]
        if sum(figures[i] is not None for i in places) < 0.5 * len(places):
            text = " ".join(label(c) for c in row if c)
            stated = run_and_side(text)[1]
            if stated is not None:
                side, run = stated, 0
            title = text if _READINGS.search(text) else title
        elif not statistic(name):
            run += 1
            own_run, own_side = run_and_side(name)
            out.append((own_run, str(run), side if own_side is None else own_side, figures))
    named = any(own is not None for own, *_ in out)  # then a row without a number is a statistic over the runs
    readings = [(own or count, way, figures) for own, count, way, figures in out if own or not named]
    if not readings:
        return sheet
    bare = [i for i in range(places[0], len(targets)) if targets[i] is None and any(f[i] for *_, f in readings)]
    if bare and sides is None:
        raise DataError(f"column {bare[0] + 1}: readings without a target in the row above (is a target missing?)")
    return _of_readings(sheet, at, title, targets, sides, readings)


def _of_readings(
    sheet: Sheet,
    at: int,
    title: str,
    targets: Figures,
    sides: dict[int, float] | None,
    readings: list[tuple[str, float | None, Figures]],
) -> Sheet:
    """The sheet with one row per target. sides: of every column of the first row that states them, else None."""
    name, unit = split_header(label(sheet.rows[at][0]))
    reading_unit = split_header(title)[1]
    mark = {1.0: "+", -1.0: "-", None: ""}
    header = [f"target [{unit}]" if unit else "target m" if re.search(r"[ _/]m$", name) else "target"]
    columns: list[dict[float, float | None]] = []
    for run, side, figures in readings:
        for way in (1.0, -1.0) if sides else (side,):
            values: dict[float, float | None] = {}
            place: float | None = None
            for i, target in enumerate(targets):
                place = target if target is not None else place if sides else None  # a cell merged over both directions
                if place is not None and figures[i] is not None and (sides is None or sides.get(i) == way):
                    values[place] = figures[i]
            columns.append(values)
            header.append(f"run {run} {mark[way]}" + (f" [{reading_unit}]" if reading_unit else ""))
    rows: Rows = [[t, *(c.get(t) for c in columns)] for t in dict.fromkeys(targets) if t is not None]
    above: Rows = [[c for c in row if c is not None] for row in sheet.rows[:at]]
    if title:
        above.append([title])
    note = f"targets across, runs down: {len(rows)} targets, {len(readings)} rows of readings"
    return Sheet(sheet.name, [*above, [*header], *rows], notes=[*sheet.notes, note])


def _are_targets(row: list[Cell], below: Rows, comma: bool) -> bool:
    """A row of increasing or decreasing numbers after a word for targets, or above rows labelled with run and side."""
    if not row or not isinstance(row[0], str) or None not in run_and_side(row[0]):  # a row of readings
        return False
    named = len(below) > 1 and all(r and None not in run_and_side(label(r[0])) for r in below)
    if not named and not _TARGETS.search(row[0]):
        return False
    try:
        cells = of_one_mark(row[1:], comma)
    except ValueError:
        cells = row[1:]
    values = [v for c in cells if (v := number(c, comma)) is not None]
    words = sum(isinstance(c, str) and bool(c) and number(c, comma) is None for c in cells)
    repeated = any(a == b for a, b in pairwise(values))  # once for each direction
    if repeated and (not below or _sides(below[0], [*range(1, len(values) + 1)]) is None):
        return False
    values = [*dict.fromkeys(values)]
    steps = [b - a for a, b in pairwise(values)]
    counted = values == [1.0 + k for k in range(len(values))]  # run numbers
    ordered = all(s > 0 for s in steps) or all(s < 0 for s in steps)
    return len(values) >= FEWEST_TARGETS and not words and not counted and ordered


def _sides(row: list[Cell], places: list[int]) -> dict[int, float] | None:
    """The approach direction of each column, if a row below the targets states both."""
    sides = {i: s for i, c in enumerate(row) if i and isinstance(c, str) and (s := guessing.side(c)) is not None}
    return sides if len(sides) >= len(places) and len(set(sides.values())) == 2 else None
