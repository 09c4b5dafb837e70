"""Wide layouts: one row per target, one column per run (and direction); unfolded into one reading per row."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing import order as of_rows
from errpipe.importing.layout import Layout, RawColumn
from errpipe.importing.sheet import label, number
from errpipe.importing.units_above import UNITS_OF_READINGS, unit_above
from errpipe.importing.words import THERE_AND_BACK, kind_by_name

_TOKEN = re.compile(r"\d+|[^\W\d_]+|[+\-−↑↓→←<>]+")
_RUN_AND_LETTER = re.compile(r"([^\W\d_]*|#) ?(\d+) ?([a-z])")  # `R1f`, `run 2 r`
_RUN_AND_MARK = re.compile(r"\d{1,3}[ ._-]?[rbu]")  # `1 R` beside `1 L`: a pass; `2 s` is twice a standard deviation
_LETTER_AND_RUN = re.compile(r"[a-z] ?\d+|\d+ ?[a-z]")
_DATE_WITHIN = re.compile(r"\b\d{1,4}([./-])\d{1,2}\1\d{2,4}(T[\d:.]+)?")  # of a run named by its date
_NO_NAME = re.compile(r"column \d+'*")  # of a column without a header
_INSTRUMENT = re.compile(r"\b(laser|sensor|enc|encoder|probe|gauge|dial|channel|ch|kanal|taster|uhr|messuhr|t)\W?\d+\b")
OF_COLUMN = "\0"  # in the name of a run: the run that a column's header names
ARROWS = "↑↓→←"
_AVERAGE = "moyenne|media|promedio|srednia|ortalama|gemiddelde|medel|medelvaerde|prumer|среднее|средние|평균"
_STATISTIC = re.compile(
    r"\b(mittel\w*|mw|mean|average|avg|median|sigma|std\w*|stabw\w*|streuung|umkehrspanne|reversal|hysteres[ei]s?|range|spanne"
    r"|max\w*|min\w*|sum\w*|([smrbu]|[bsx]i)(?=[ ↑↓]|$)|\d ?s(igma)?|standard\w*"
    r"|repeatab\w*|reproduc\w*|uncertainty|unsicherheit|ecart type|maks\w*"
    r"|odchyl\w* (?:std|stand\w*)|desvio padrao|std sapma"
    rf"|{_AVERAGE})\b\.?|(?:平均|最大|最小|標準|标准)(?:値|值|偏差)?"
)
# Next to targets: the reversal of VDI/DGQ 3441, statistics of ISO 230-2; not axes U or B.
_FIGURE = re.compile("[UBMRS]")
_MEAN = re.compile(r"\b(mean|average|avg|mittel\w*|mw|" + _AVERAGE + r")\b|[Øø∅\u0304\u0305]|平均")
MEASURED = ("command", "position", "actual", "error", "time")
KINDS = ("ignore", "error", "run", "direction", "actual", "position", "command")


@dataclass
class Wide:
    """The target column, the run and side (+1, -1, None) of every column of readings, and columns of statistics.

    run, way: the columns that name the run, and the side, of each row if the headers do not, or None.
    """

    target: RawColumn
    readings: list[tuple[RawColumn, str, float | None]]
    statistics: list[RawColumn]
    run: RawColumn | None = None
    way: RawColumn | None = None


def run_and_side(header: str) -> tuple[str | None, float | None]:
    """'Lauf 2 auf' -> ('2', +1); '3-' -> ('3', -1); 'F1' -> ('1', +1); '3.5.2024' -> ('3.5.2024', None)."""
    if signed := re.fullmatch(r"([+\-−])\s?(\d{1,3})", header.strip()):
        return signed.group(2), guessing.side(signed.group(1))
    if grouped := re.fullmatch(r"([+\-−])\s+([^\W\d_].*)", header.strip()):  # `+` above a group of columns
        run, way = run_and_side(grouped.group(2))
        return run, guessing.side(grouped.group(1)) if way is None else way
    if dated := _DATE_WITHIN.search(header):
        return dated.group(), run_and_side(header.replace(dated.group(), " "))[1]
    if _NO_NAME.fullmatch(header) or _INSTRUMENT.search(guessing.plain(header)):
        return None, None
    numbered = _RUN_AND_LETTER.fullmatch(guessing.plain(header))
    of_run = numbered and (numbered[1] in ("", "r", "l", "#") or kind_by_name(numbered[1]) == "run")
    if numbered and of_run and (way := guessing.side(numbered[3])) is not None:
        return numbered[2], way
    tokens = _TOKEN.findall(re.sub(r"([+-])ve\b", r"\1", guessing.plain(header)))
    letters = [t for t in tokens if not t.isdigit()]
    numbers = [t for t in tokens if t.isdigit()]
    single = len(letters) == 1 and len(tokens) <= 2  # `F1`, `1u`: otherwise a letter is an axis or a unit
    side = None
    for k, token in enumerate(reversed(tokens)):
        mark = not token[0].isalnum()
        sign_within = k > 0 and mark and token not in ARROWS  # a sign counts only at the end: `Soll-Ist`, `1-2`
        letter = len(token) == 1 and token.isascii() and not mark
        if token.isdigit() or token == "pos" or (letter and not single) or sign_within:
            continue
        if (side := guessing.side(token)) is not None:
            break
    return (numbers[-1] if numbers else None), side


def find(layout: Layout, guesses: guessing.Guesses) -> Wide | None:
    """The wide layout of a table, or None if a row is one reading."""
    left_out = [header for header, g in guesses.items() if g.kind == "ignore" and not g.why]  # by the user
    numeric, repeated = [c for c in layout.columns if c.numeric and c.header not in left_out], []
    headers = {c.header.lower() for c in numeric}
    stated = {c.header: run_and_side(_positive_side(c.header, headers)) for c in numeric}
    targets = _targets(numeric, stated, guesses)
    if len(targets) > 1 and all(np.array_equal(c.values, targets[0].values, equal_nan=True) for c in targets):
        repeated, targets = targets[1:], targets[:1]  # tables side by side, each with the targets
    if len(targets) != 1:
        return None
    readings: list[tuple[RawColumn, str, float | None]] = []
    statistics = []
    runs = {stated[c.header][0] for c in numeric if not statistic(c.header)} - {None}
    for c in numeric:
        run, side = stated[c.header]
        of_targets = any(c is t for t in (targets[0], *repeated))
        if of_targets or guesses[c.header].kind not in KINDS or (run is None and side is None):
            continue
        if kind_by_name(c.header) == "ignore":  # `Tol+`, `Tol-`
            continue
        words = re.sub(r"\b[^\W\d_]\b", " ", c.header)  # `B 1` beside `F 1`: backwards
        lettered = run in runs and not statistic(words)
        if statistic(c.header) and not lettered:
            statistics.append(c)
        else:
            again = len(c.header) - len(c.header.rstrip("'")) if not repeated else 0  # `Fwd;Rev;Fwd;Rev`: runs
            readings.append((c, run or str(1 + again), side))
    if not readings:  # a report with only the means: one run
        readings = [(c, "mean", stated[c.header][1]) for c in statistics if _is_mean(c.header)]
        statistics = [c for c in statistics if not any(c is r for r, _, _ in readings)]
    kinds = {guesses[c.header].kind for c, _, _ in readings}
    if "command" in kinds and kinds & {"actual", "position"}:
        return None  # `0 X command`, `1 X actual`: channels
    letters = all(_LETTER_AND_RUN.fullmatch(guessing.plain(c.header)) for c, _, _ in readings)
    alone = letters and len({side for _, _, side in readings}) == 1  # `R1`, `R2`: readings, if there is no `F1`
    if alone or any(side is None for _, _, side in readings):  # `1a`, `1b`: b alone is not a direction
        readings = [(c, run, None) for c, run, _ in readings]
    others = [c for c in layout.columns if not any(c is r for r, _, _ in readings)]
    labels = [c for c in others if guesses[c.header].kind == "run"]
    named = len({stated[c.header][0] for c, _, _ in readings} - {None}) > bool(labels)  # `+1`, `-1`: sides
    if len(readings) < 2:
        return None
    if len({(run, side) for _, run, side in readings}) < len(readings):
        _refuse_runs_without_sides(readings)
        return None
    ways = [c for c in others if guesses[c.header].kind == "direction"]
    way = ways[0] if ways and all(side is None for _, _, side in readings) else None
    return Wide(targets[0], readings, statistics, labels[0] if labels and not named else None, way)


def _targets(
    numeric: list[RawColumn], stated: dict[str, tuple[str | None, float | None]], guesses: guessing.Guesses
) -> list[RawColumn]:
    """The columns that may hold the targets."""
    places = [c for c in numeric if guesses[c.header].kind in ("command", "position")]
    places = [c for c in places if len(places) == 1 or not (_counts(c) or is_figure(c.header))]
    targets = [c for c in places if stated[c.header] == (None, None)]
    targets = targets or [c for c in places if stated[c.header][0] is None]
    names = [re.sub(r"\d+", "", guessing.plain(c.header)) for c in numeric[:2]]
    alike = len(names) == 2 and names[0] == names[1] != ""  # `j1`, `j2`: joints
    first = numeric[0].header if numeric else ""
    spectrum = not first or kind_by_name(first) == "ignore"
    if not targets and not (spectrum or alike or guesses[first].kind == "time") and _rises(numeric[0]):
        unsaid = [
            c
            for c in numeric[1:]
            if stated[c.header] == (None, None) and _rises(c) and kind_by_name(c.header) != "time"
        ]
        targets = numeric[:1] if not _counts(numeric[0]) else [c for c in unsaid if not _counts(c)][:1]
    return targets


def _refuse_runs_without_sides(readings: list[tuple[RawColumn, str, float | None]]) -> None:
    """Raise DataError for several columns of one run without a side; not for `theta_1`, `tau_1` of joints."""
    if len({run for _, run, _ in readings}) < 2 or any(side is not None for _, _, side in readings):
        return
    first, other = next((a, b) for a, ra, _ in readings for b, rb, _ in readings if ra == rb and a is not b)
    words = [{*re.findall(r"[^\W\d_]{2,}", guessing.plain(c.header))} for c in (first, other)]
    if not all(words) or words[0] & words[1]:
        raise DataError(
            f"columns {first.header!r} and {other.header!r} are both of one run, but neither states from which "
            "side its targets were approached: write + and -, up and down, or fwd and rev into the header"
        )


def _positive_side(header: str, headers: set[str]) -> str:
    """The header with `pos` read as a side if another header has `neg` in its place; else `pos` is a position."""
    words = re.compile(r"\bpos(?![^\W\d_])", re.IGNORECASE)
    return words.sub("+", header) if words.sub("neg", header).lower() in headers - {header.lower()} else header


def statistic(name: str) -> bool:
    """Whether a header or the name of a row is that of a statistic over the runs: a mean, a standard deviation."""
    if _RUN_AND_MARK.fullmatch(guessing.plain(name)):
        return False
    return _STATISTIC.search(guessing.plain(name)) is not None or re.search("[Øø∅\u0304\u0305]", name) is not None


def is_figure_over_runs(name: str) -> bool:
    """Whether a run is named only by a statistic over the runs: `Mean`, `Mean up`; `max load` is a run."""
    rest = _STATISTIC.sub(" ", guessing.plain(name))
    return statistic(name) and all(guessing.side(w) is not None for w in re.findall(r"[^\W\d_]+", rest))


def _is_mean(header: str) -> bool:
    """Whether a header names a mean, also as a bar over a letter; `x̄ + 2s` is a bound, not a mean."""
    text = guessing.plain(header)
    named = _MEAN.search(text) or re.search("[\u0304\u0305]", header)
    return named is not None and re.search(r"\d ?s(igma)?\b|\d ?σ", text) is None


def is_figure(header: str) -> bool:
    """Whether a header next to the targets names a statistic over the runs, although its letter is that of an axis."""
    return _FIGURE.fullmatch(header) is not None or statistic(header)


def _counts(c: RawColumn) -> bool:
    values = c.values[np.isfinite(c.values)]
    return values.size > 2 and np.array_equal(values, np.arange(1, values.size + 1))


def _rises(c: RawColumn) -> bool:
    x = c.values[np.isfinite(c.values)]
    return x.size > 2 and bool(np.all(np.diff(x) > 0) or np.all(np.diff(x) < 0))


def unpivot(layout: Wide) -> tuple[np.ndarray, list[str], np.ndarray, np.ndarray]:
    """Row of the table, run, side and reading of every reading, sorted by run.

    A pass down visits the targets in descending order. Raises DataError if no row has a target and a reading.
    """
    target, readings = layout.target.values, [c for c, _, _ in layout.readings]
    keep = np.isfinite(target) & np.any([np.isfinite(c.values) for c in readings], axis=0)
    names = ["" for _ in target] if layout.run is None else [label(c) for c in layout.run.cells]
    keep &= np.array([not is_figure_over_runs(name) for name in names])  # the mean of each target is not a run
    rows = np.flatnonzero(keep)
    if not rows.size:
        raise DataError("no row contains a target and a reading")
    of_row = np.full(target.size, np.nan) if layout.way is None else guessing.sides(layout.way)
    refuse_there_and_back([c.header for c in readings], target[rows])
    if layout.run is None:
        names = _runs_of_blocks(layout, rows, of_row, names)
    order, run, side, value = [], [], [], []
    for name in dict.fromkeys(names[i] for i in rows):
        block = np.array([i for i in rows if names[i] == name])
        sided = [
            (c, number_of_run, of_rows if way is None else way, rows_of_side)
            for c, number_of_run, way in layout.readings
            for of_rows, rows_of_side in _by_side(block, of_row)
        ]
        for c, number_of_run, way, part in sided:
            own = part[np.isfinite(c.values[part])]
            rising = own.size > 1 and target[own[-1]] > target[own[0]]
            own = own if way is None or rising == (way > 0) else own[::-1]
            order.append(own)
            run += [name.replace(OF_COLUMN, number_of_run) or number_of_run] * own.size
            side += [np.nan if way is None else way] * own.size
            value.append(c.values[own])
    return np.concatenate(order), run, np.array(side), np.concatenate(value)


def _runs_of_blocks(layout: Wide, rows: np.ndarray, side: np.ndarray, names: list[str]) -> list[str]:
    """The names, with a number per block of rows if the targets start again; OF_COLUMN: the run of a column."""
    x, known = np.round(layout.target.values[rows], 6), bool(np.isfinite(side[rows]).all())
    if np.unique(x).size == x.size:  # listed in any order, once each
        return names
    blocks = of_rows.visits(x, side[rows]) if known else of_rows.sweeps(x, None)
    several = len({run for _, run, _ in layout.readings}) > 1
    for row, block in zip(rows.tolist(), blocks, strict=True) if len({*blocks}) > 1 else ():
        names[row] = f"{block}-{OF_COLUMN}" if several else block
    return names


def _by_side(rows: np.ndarray, side: np.ndarray) -> list[tuple[float | None, np.ndarray]]:
    """The rows of each side, from below first; all of them with None unless every row has a side."""
    if not np.isfinite(side[rows]).all():
        return [(None, rows)]
    return [(way, rows[side[rows] == way]) for way in (1.0, -1.0) if (side[rows] == way).any()]


def side_by_side(layout: Layout, guesses: guessing.Guesses) -> Layout:
    """Two tables side by side, with targets in different order, in the order of the first: the return pass."""
    kinds = [guesses[c.header].kind for c in layout.columns]
    at = [k for k, c in enumerate(layout.columns) if kinds[k] in ("command", "position") and c.numeric]
    stated = [run_and_side(c.header)[1] for k, c in enumerate(layout.columns) if k not in at and c.numeric]
    if len(at) != 2 or at[0] != 0 or at[1] + 1 == len(kinds) or at[1] == 1 or {*stated} != {1.0, -1.0}:
        return layout
    here, there = (layout.columns[k].values for k in at)
    same = np.array_equal(np.sort(here), np.sort(there)) and np.unique(here).size == here.size
    if not same or np.array_equal(here, there):
        return layout
    rows = np.argsort(there)[np.argsort(np.argsort(here))]
    turned_columns = [c if k < at[1] else c.take(rows) for k, c in enumerate(layout.columns)]
    note = f"two tables side by side: the rows from {layout.columns[at[1]].header!r} on follow the targets of the first"
    return Layout(turned_columns, layout.above, [*layout.notes, note], layout.below)


def merged_targets(layout: Layout, guesses: guessing.Guesses) -> Layout:
    """The layout with each target also in the row of its other side, if both share one merged cell.

    Raises DataError if more than one in ten rows has a reading and no target.
    """
    kinds = {c.header: guesses[c.header].kind for c in layout.columns}
    places = [c for c in layout.columns if kinds[c.header] in ("command", "position") and c.numeric]
    ways = [c for c in layout.columns if kinds[c.header] == "direction"]
    read = [
        np.isfinite(c.values)
        for c in layout.columns
        if kinds[c.header] in ("error", "actual")
        or (c.unit in UNITS_OF_READINGS and kinds[c.header] in ("ignore", "run"))
    ]
    if len(places) != 1 or not read or "time" in kinds.values():
        return layout
    place = places[0]
    side = guessing.sides(ways[0]) if ways else np.full(place.values.size, np.nan)
    filled = np.isfinite(place.values)
    at, reading = np.arange(filled.size), np.any(read, axis=0)
    for r in np.flatnonzero(~filled[1:] & reading[1:] & np.isfinite(side[1:])) + 1:
        at[r] = r - 1 if filled[r - 1] and side[r - 1] == -side[r] else r
    within = np.arange(filled.size) < np.flatnonzero(filled)[-1]
    for c in layout.columns:
        within |= _labelled_alike(c, filled) if kinds[c.header] == "run" and c.unit is None else False
    left = ~np.isfinite(place.values[at]) & reading & within
    for r in np.flatnonzero(left):  # `Mean` of each target is not a reading
        left[r] = not any(isinstance(c.cells[r], str) and statistic(str(c.cells[r])) for c in layout.columns)
    if left.sum() > max(1.0, 0.1 * filled.size):
        raise DataError(
            f"{int(left.sum())} rows contain readings but no {place.header!r} (first: row {int(np.argmax(left)) + 1} "
            "of the table): write the target into each row, and in a column of directions + (from below) or -"
        )
    if np.array_equal(at, np.arange(filled.size)):
        return layout
    shared = int((at != np.arange(filled.size)).sum())
    note = f"{shared} rows share the {place.header!r} of the row above (merged cells)"
    whole = place.take(at)
    columns = [whole if c is place else c for c in layout.columns]
    return Layout(columns, layout.above, [*layout.notes, note], layout.below)


def _labelled_alike(c: RawColumn, rows: np.ndarray) -> np.ndarray:
    """Whether each row has a label as these rows have, but for digits: `Run 2` beside `Run 1`, not `Accuracy A`."""
    texts = [re.sub(r"\d+", "0", label(cell)) for cell in c.cells]
    known = {text for text, of in zip(texts, rows.tolist(), strict=True) if of and text}
    return np.array([text in known for text in texts])


def refuse_there_and_back(names: Sequence[str], targets: np.ndarray) -> None:
    """Raise DataError if targets fall and names state forward and return pass: forward may be up or down."""
    words = [t for name in names for t in _TOKEN.findall(guessing.plain(name)) if THERE_AND_BACK.fullmatch(t)]
    steps = np.diff(targets)
    if words and steps.size and not (steps > 0).any():
        raise DataError(
            f"the targets fall from {targets[0]:g} to {targets[-1]:g}, and {words[0]!r} may be the way down or up"
            ": write + (approached from below) and - (from above) instead"
        )


def unpivoted(layout: Layout) -> Layout:
    """A table with one row per run and one column per target (headers that are positions) as one reading per row."""
    places = {c.header: v for c in layout.columns if c.numeric and (v := _place(c.header)) is not None}
    others = [c for c in layout.columns if c.header not in places]
    x = np.array(list(places.values()))
    ordered = x.size > 3 and bool(np.all(np.diff(x) > 0) or np.all(np.diff(x) < 0))
    counted = not others and np.array_equal(x, x[:1] + np.arange(x.size))  # 1, 2, 3 ...: numbers of columns
    if not ordered or counted or any(c.numeric and guessing.guess(c).kind in MEASURED for c in others):
        return layout
    readings = np.stack([c.values for c in layout.columns if c.header in places], axis=1)
    read = np.isfinite(readings).any(axis=1)  # not `Unit: um`
    readings, others = readings[read], [c.take(np.flatnonzero(read)) for c in others]
    others = [part for c in others for part in split_labels(c)]
    stated = next((c for c in others if guessing.guess(c).kind == "direction"), None)
    refuse_there_and_back([] if stated is None else [label(cell) for cell in stated.cells], x)
    ways = None if stated is None else guessing.sides(stated)
    pairs = [
        (r, k)
        for r in range(len(readings))
        for k in (range(x.size) if ways is None or not (ways[r] * (x[-1] - x[0]) < 0) else range(x.size - 1, -1, -1))
    ]
    rows, at = np.array(pairs).T
    columns = [c.take(rows) for c in others]
    units = {c.unit for c in layout.columns if c.header in places} - {None}
    unit = units.pop() if len(units) == 1 else None
    columns.append(RawColumn("target", unit, [float(v) for v in x[at]], x[at]))
    values = readings[rows, at]
    columns.append(RawColumn("error", unit_above(layout.above, values), [float(v) for v in values], values))
    note = f"one row per run, one column per target: {x.size} targets from {x.min():g} to {x.max():g}"
    return Layout(columns, layout.above, [*layout.notes, note])


def split_labels(c: RawColumn) -> list[RawColumn]:
    """A column that names run and side of every row but statistics (`Lauf 1 auf`) as two; any other unchanged."""
    if guessing.guess(c).kind not in ("ignore", "run") or c.numeric:
        return [c]
    labels = [
        (text, run_and_side(text)[1] or 1.0) if statistic(text := label(x)) else run_and_side(text) for x in c.cells
    ]
    if any(run is None or way is None for run, way in labels) or len({way for _, way in labels}) < 2:
        return [c]  # `r01` of a run is not a return pass
    no_numbers = np.full(len(labels), np.nan)
    ways: list[str | float | None] = ["+" if way == 1.0 else "-" for _, way in labels]
    return [
        RawColumn("run", None, [run for run, _ in labels], no_numbers),
        RawColumn("direction", None, ways, no_numbers),
    ]


def _place(header: str) -> float | None:
    """The position if a header is nothing else: '50', '50,0', '-12.5'."""
    value = number(header, comma=False)
    return value if value is not None else number(header, comma=True)
