"""Logs with a name before every value: prints of NC programs (DPRNT, FN16, WRITE), line protocols."""

from __future__ import annotations

import re
from collections import Counter

from errpipe.importing.sheet import Cell, Rows, Sheet, filled_cells, label, number
from errpipe.importing.units import unit_of

_VALUE = r"[+-]?\s?(?:\d+(?:[.,]\d+)*|[.,]\d+)(?:[eE][+-]?\d+)?"
_CLOCK = r"(?:(?<=\s\d)|(?<=\s\d\d)):\d\d(?!\d)"  # in `Day 1 20:00`
_PAIR = re.compile(  # `X_SOLL=1.5`, `RUN*1`, `SOLLWERT X : 1,5 MM`, `#5061=1.5`, `DIR=PLUS`
    rf"\s*([^\W\d][^=:*]*?|#\d+)\s*(?!{_CLOCK})[=:*]\s*({_VALUE}|[^\W\d][\w.]*|[+-](?![\w.]))(?:\s*(?!\w+\s*[=:*])([^\W\d]{{1,4}}|\")(?=[\s;,]|$))?[\s;,]*"
)
_WORDS = re.compile(rf"\s*([A-Za-z]{{1,12}})\s*({_VALUE})()(?=[\s,;]|$)[\s,;]*")  # `X 1.5, DIAL 0.002`, `B30. C0. X1.5`
_STAMP = re.compile(  # a time stamp or a counter before the values
    r"\s*[\[(]?((?:\d{2,4}[-./]\d\d?[-./]\d{2,4}[ T])?\d\d?:\d\d:\d\d(?:[.,]\d+)?Z?|\d+(?:\.\d+)?)[\])]?"
    r"(?:\s*(?:->|[,;|-])\s*|\s+)(?:\[?(?:DEBUG|INFO|NOTICE)\]?:?\s+(?:[\w.-]+:\s+(?=[^=]*=))?)?(?=[^\W\d])"
)
_INDEX = re.compile(r"\[\d+\]$|(?<=#)\d+$")  # `VC[12]`, `#101`: values with an index instead of a name
_TICKS = re.compile(r"\d{10,19}")  # of a line protocol: the time stamp after all values
_OF_A_MEASUREMENT = re.compile(r"([^\s,=]+(?:,[^\s,=]+=[^\s,=]+)*) ([^\s,=]+=\S+) (\d{10,19})")
SAMPLE_ROWS = 500  # spread over the file
_STRIDE = 7919  # rows: a prime, so that a record of a few lines is not met at the same line each time
FEWEST_ROWS = 3  # of a table
MOSTLY = 0.8  # share of the lines that are names and values; share of the rows that contain a name


def tabled(sheet: Sheet) -> Sheet:
    """The sheet with one column per name, if its lines are names and values; any other sheet unchanged.

    A row ends where the first of the names that occur in every row repeats, in the same line or in a later one.
    """
    if sheet.header is None and not _may_name_values(sheet):
        return sheet
    cells = [[label(c) for c in filled_cells(row)] for row in sheet.rows]
    for mark in (" ", ",") if sheet.header is None else ():  # a decimal comma may have split the cells
        lines = [line for row in cells if re.search(r"\w", line := mark.join(row))]
        if (series := _of_measurements(sheet, lines)) is not None:
            return series
        found = [_pairs(line) for line in lines]
        each = {name for of_line in found for name, _, _ in of_line}
        if len(each) > len(lines) and all(map(_INDEX.search, each)):
            found = [[(f"{_INDEX.sub('', n)} {k}", v, u) for k, (n, v, u) in enumerate(of, 1)] for of in found]
        count = Counter(name for of_line in found for name, _, _ in of_line)
        most = max(count.values(), default=0)
        names = [name for name, n in count.items() if n >= MOSTLY * most]
        named = [any(name in names for name, _, _ in of_line) for of_line in found]
        if most >= FEWEST_ROWS and len(names) > 1 and sum(named) >= MOSTLY * len(lines):
            above = [line for line, of_rows in zip(lines, named, strict=True) if not of_rows]
            return _table(sheet, names, [pair for of_line in found for pair in of_line if pair[0] in names], above)
    return sheet


def _may_name_values(sheet: Sheet) -> bool:
    """Whether a sample of the rows has enough lines of names and values: the rows of a long table are not all tried."""
    sample = [[label(c) for c in filled_cells(row)] for row in _sampled(sheet.rows)]
    lines = [[line for row in sample if re.search(r"\w", line := mark.join(row))] for mark in (" ", ",")]
    return any(sum(bool(_pairs(line)) for line in of_mark) >= MOSTLY / 2.0 * len(of_mark) for of_mark in lines)


def _sampled(rows: Rows) -> Rows:
    return [rows[k * _STRIDE % len(rows)] for k in range(min(SAMPLE_ROWS, len(rows)))]


def _of_measurements(sheet: Sheet, lines: list[str]) -> Sheet | None:
    """A row per time of a line protocol of several measurements, `probe,tag=x field=1 time`; None for other lines.

    A column has the names of measurement and field, and the tags that differ between lines.
    """
    parts = [m.groups() for line in lines if (m := _OF_A_MEASUREMENT.fullmatch(line))]
    if len(parts) < len(lines) or len({head for head, _, _ in parts}) < 2:
        return None
    heads = {head: re.split(r"[,=]", head) for head, _, _ in parts}
    shared = set.intersection(*(set(words[1:]) for words in heads.values()))
    keys = {key for words in heads.values() for key in words[1::2]}
    table: dict[str, dict[str, Cell]] = {}
    for head, fields, time in parts:
        named = " ".join(w for k, w in enumerate(heads[head]) if not k or (w not in shared and w not in keys))
        for field in fields.split(","):
            name, _, value = field.partition("=")
            table.setdefault(time, {})[f"{named} {name}"] = re.sub(r"(?<=\d)[iu]$", "", value)
    names = dict.fromkeys(name for values in table.values() for name in values)
    rows: list[list[Cell]] = [[time, *map(table[time].get, names)] for time in sorted(table, key=int)]
    return Sheet(sheet.name, rows, ["time stamp", *names], [*sheet.notes, f"{len(heads)} series in one column each"])


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
    """Names, values and units of a line, with a time stamp before or after; empty if it contains anything else."""
    stamp = _STAMP.match(line)
    own = [("time" if ":" in stamp[1] else "unnamed", stamp[1], "")] if stamp else []
    line = line[stamp.end() :] if stamp else line
    pattern = _PAIR if re.search(r"[=:*]", line) else _WORDS
    out = [(m[1].strip(), m[2], m[3] or "") for m in pattern.finditer(line)]
    rest = pattern.sub("", line).strip()
    if not out or (pattern is _WORDS and (len(out) < 2 or {*"GMNFSTO"} & {n for n, _, _ in out})):  # of an NC program
        return []
    return [*own, *out, ("time stamp", rest, "")] if _TICKS.fullmatch(rest) else [] if rest else own + out
