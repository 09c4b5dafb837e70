"""From cells to columns: the rows of header, units and data, and the lines above them."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.blocks import COMMENT, blocks, sections
from errpipe.importing.facts import OF_A_FACT
from errpipe.importing.sheet import Cell, Sheet, decimal_comma, filled_cells, label, number, of_one_mark
from errpipe.importing.units import split_header, unit_of
from errpipe.importing.units_above import units_of_columns
from errpipe.importing.words import kind_by_name

DEEPEST_HEADER = 200  # lines above the data: the longest preamble seen, of a laser's own file, has 60
MOST_REMARKS = 50  # lines below a table that are kept as remarks
SAMPLE_ROWS = 200  # rows in which a unit behind the numbers is looked for
BY_NAME = "of the sheet or file"
COMPONENT = r"\bE[XYZABC][XYZABCUVW]\b"  # by ISO 230-1, of an axis that moves
EMPTY = "columns without a value:"  # a note that an error repeats
NUMERIC_SHARE = 0.6  # of a column's cells: what is a number column with gaps and remarks

_NUMBER_AND_UNIT = re.compile(r"\s*([+\-−–]?[\d.,'’]*\d)\s*([^\d\s.,+\-][^\s]{0,8})\s*")
_WORD = re.compile(
    r"(?!(n/?a|nan|null|none|#n/a|#?wert!?|ol|---?|open|burn ?out|over ?(range|flow)|no ?sensor)$).*[^\W\d_]",
    re.IGNORECASE,
)  # no missing value
_AXIS_OF_SHEET = re.compile(
    r"^([XYZ])\d?$|\b(?:axis|achse|axe|asse|eje)[ -]?([XYZABCUVW])\b|\b([XYZABCUVW])[ -]?(?:axis|achse|axe|asse)\b",
    re.IGNORECASE,
)
_MOMENT = re.compile(
    r"(?=.*\d:\d|.*\d[./-]\d+[./-]\d)\d[\d.:/\-T ,+Z]*( ?[AaPp]\.?[Mm]\.?)?"
    r"|\d{1,2}[-. ]{1,2}[^\W\d_]{3,9}[-. ]{1,2}\d{2,4}( \d.*)?"
)
_DATE_FORM = re.compile(
    r"[yY]{2,4}[./-][mM]{1,2}[./-][dD]{1,2}|[dD]{1,2}[./-][mM]{1,2}[./-][yY]{2,4}|[hH]{1,2}:[mM]{2}(:[sS]{2})?|NO\."
)
_RULE = re.compile(r"[-=_+:~*|]{2,}")


@dataclass
class RawColumn:
    """One column: its header without the unit, the unit as written here, its cells, and the numbers among them."""

    header: str
    unit: str | None
    cells: list[Cell]
    values: np.ndarray  # NaN where a cell is no number

    @property
    def numeric(self) -> bool:
        """Whether most filled cells are numbers."""
        filled = sum(c not in (None, "") for c in self.cells)
        return filled > 0 and int(np.isfinite(self.values).sum()) >= NUMERIC_SHARE * filled


@dataclass
class Layout:
    """Columns of a sheet, the text above them, and notes on what was decided."""

    columns: list[RawColumn]
    above: list[str]
    notes: list[str] = field(default_factory=list)
    below: list[str] = field(default_factory=list)  # lines of text among and below the rows

    def column(self, header: str) -> RawColumn | None:
        """The column of a header, or None."""
        return next((c for c in self.columns if c.header == header), None)


def is_word(cell: Cell) -> bool:
    """Whether a cell is a word, and not one of those for a missing value."""
    return isinstance(cell, str) and _WORD.match(cell) is not None and not is_moment(cell)


def lay_out(sheet: Sheet, stated: tuple[str, ...] = ()) -> Layout:
    """Header, units and data of a sheet. Raises DataError where there is no block of numbers.

    stated: names of the columns of a file without a header, by a person.
    """
    rows = [row for row in sheet.rows if filled_cells(row) and not _is_rule(row)]
    if len(rows) > 4 and rows[0][:1] == ["TOA5"]:  # of a data logger: names, units, and how values were taken
        units_below = [f" [{u}]" if u not in ("", None, "TS", "RN") else "" for u in rows[2]]
        rows = [[f"{n}{u}" for n, u in zip(rows[1], units_below, strict=False)], *rows[4:]]
    rows, unit_in_cells = _without_units(rows)
    comma = decimal_comma(rows)
    notes = list(sheet.notes) + (["decimal commas"] if comma else [])
    if sheet.header is not None:
        return _layout(sheet, [*sheet.header], [], rows, comma, [*sheet.above, *_said_by_name(sheet.name)], notes)
    numbers = [[number(c, comma) for c in row] for row in rows]
    start = _first_data_row(sheet.name, rows, numbers)
    _lift_comments(rows, numbers, start)
    head_rows = _header_rows(rows, numbers, start)
    names, units, used = _names(rows, head_rows, max(map(len, rows[start:])))
    above = [" ".join(str(c) for c in row if c not in (None, "")) for row in rows[: start - used]]
    above += [*sheet.above, *_said_by_name(sheet.name)]
    units = [
        u or a or unit_in_cells.get(i)
        for i, (u, a) in enumerate(zip(units, units_of_columns(rows, start - used, names), strict=True))
    ]
    names = _merged(names, numbers[start:]) if used else names
    if stated:
        units = [u or split_header(n)[1] for u, n in zip(units, names, strict=True)]
        names = [*_stated_names(stated, len(names), used > 0), *names[len(stated) :]]
    elif not used:
        notes.append("the file has no header: columns are numbered (--names gives them names)")
    remarks = [row for row, of_row in zip(rows[start:], numbers[start:], strict=True) if all(v is None for v in of_row)]
    below = [" ".join(map(str, filled_cells(row))) for row in remarks[:MOST_REMARKS]]
    if used:
        title = filled_cells(rows[start - 1 - used]) if start > used else []
        names, rows = blocks(names, rows, numbers, start, notes, used)
        names, rows = sections(names, rows, str(title[0]) if len(title) == 1 else "", notes)
        units += [None] * (len(names) - len(units))
    else:
        rows = rows[start:]
    laid = _layout(sheet, names, units, rows, comma, [a for a in above if a], notes)
    laid.below = below
    return laid


def _merged(names: list[str], numbers: list[list[float | None]]) -> list[str]:
    """Names with those of cells that were merged over several columns of numbers: `Up`, `Up 2`, `Up 3`, `Down`, ...

    At least two such cells, of one width: else a column without a name is one.
    """
    out, width = list(names), Counter[int]()
    last = -1
    for i, name in enumerate(names):
        filled = sum(len(row) > i and row[i] is not None for row in numbers)
        if name != f"column {i + 1}":
            last = i
        elif last >= 0 and filled >= NUMERIC_SHARE * len(numbers):
            width[last] += 1
            out[i] = f"{names[last]} {width[last] + 1}"
    return out if len(width) > 1 and len(set(width.values())) == 1 else names


def _said_by_name(name: str) -> list[str]:
    """Lines that state the axis, and the component, by which a sheet or file is named."""
    axis = [f"Axis: {letter} ({BY_NAME} {name!r})" for letter in _axis_of_sheet(name)]
    return axis + [f"Component: {found} ({BY_NAME})" for found in re.findall(COMPONENT, name.replace("_", " "))]


def _axis_of_sheet(name: str) -> list[str]:
    """The axis by which a sheet or file is named: `Y`, `Achse Y`, `y-axis_2026`, `laser_Y_run1`; not `b1`, `X_Y`."""
    name = name.replace("_", " ")
    match, alone = _AXIS_OF_SHEET.search(name), re.findall(r"(?:^|(?<=[ -]))[XYZ](?=[ -]|$)", name)
    return [next(filter(None, match.groups())).upper()] if match else alone if len(alone) == 1 else []


def _is_rule(row: list[Cell]) -> bool:
    """Whether a row is a line drawn with signs, as below the header of a table in Markdown."""
    return all(isinstance(c, str) and _RULE.fullmatch(c) for c in filled_cells(row)) and len(filled_cells(row)) != 1


def _stated_names(stated: tuple[str, ...], width: int, header: bool) -> tuple[str, ...]:
    """The names that a person stated. Raises DataError where they are not as many as the columns of a header."""
    if len(stated) > width or (header and len(stated) != width):
        raise DataError(f"--names gives {len(stated)} names, the table has {width} columns")
    return stated


def _without_units(rows: list[list[Cell]]) -> tuple[list[list[Cell]], dict[int, str]]:
    """The rows without units behind their numbers (`12,5 µm`), and the unit of each column that had one."""
    counts: dict[int, Counter[str]] = {}
    for row in rows[:SAMPLE_ROWS]:
        for i, cell in enumerate(row):
            if isinstance(cell, str) and (match := _NUMBER_AND_UNIT.fullmatch(cell)) and unit_of(match.group(2)):
                counts.setdefault(i, Counter())[match.group(2)] += 1
    written = {i: c.most_common(1)[0][0] for i, c in counts.items() if len(c) == 1 and c.total() > 2}
    if not written:
        return rows, {}

    def bare(i: int, cell: Cell) -> Cell:
        match = _NUMBER_AND_UNIT.fullmatch(cell) if i in written and isinstance(cell, str) else None
        return match.group(1) if match and match.group(2) == written[i] else cell

    units = {i: unit for i, text in written.items() if (unit := unit_of(text)) is not None}
    return [[bare(i, cell) for i, cell in enumerate(row)] for row in rows], units


def _first_data_row(name: str, rows: list[list[Cell]], numbers: list[list[float | None]]) -> int:
    """The first row of a run of rows of the usual width that hold numbers."""
    filled, counts = _widths(rows, numbers)
    widths = Counter(n for n, c in zip(filled, counts, strict=True) if c >= 2 or (c and n <= 2))
    if not widths:
        raise DataError(f"{name}: no row with two numbers (needed: a table of measurements with a column per signal)")
    width = max(widths, key=lambda n: (widths[n] * n, n))
    for r in range(min(len(filled), DEEPEST_HEADER)):
        block = range(r, min(r + 3, len(filled)))
        full = all(filled[i] >= max(2, 0.6 * width) and counts[i] >= max(1, 0.4 * filled[i]) for i in block)
        if full and not _is_header(rows[r], numbers, r):
            return r
    raise DataError(f"{name}: no block of numbers below a header in the first {DEEPEST_HEADER} lines")


def _widths(rows: list[list[Cell]], numbers: list[list[float | None]]) -> tuple[list[int], list[int]]:
    """Filled cells and numbers of each row; of rows of numbers those of the widest one near.

    A log of several devices fills some columns in one row and others in the next.
    """
    filled = [len(filled_cells(row)) for row in rows]
    words = [any(map(is_word, row)) for row in rows]
    counts = [
        sum(v is not None or (not word and is_moment(c)) for c, v in zip(row, of_row, strict=True))
        for row, of_row, word in zip(rows, numbers, words, strict=True)
    ]
    bare = [c > 0 and not word for c, word in zip(counts, words, strict=True)]
    near = [[j for j in range(max(i - 2, 0), min(i + 3, len(rows))) if bare[j]] for i in range(len(rows))]
    widest = [max(js, key=lambda j: counts[j]) if b else i for i, (b, js) in enumerate(zip(bare, near, strict=True))]
    return [filled[j] for j in widest], [counts[j] for j in widest]


def is_moment(cell: Cell) -> bool:
    """Whether a cell is a date or a clock time in figures."""
    return isinstance(cell, str) and _MOMENT.fullmatch(cell.strip()) is not None


def _is_header(row: list[Cell], numbers: list[list[float | None]], r: int) -> bool:
    """A row with a word above a column of numbers is a header even where its other cells are numbers (run 1, 2, 3)."""
    below = numbers[r + 1 : r + 6]
    alone = len(filled_cells(row)) == 1 and max((sum(v is not None for v in b) for b in below), default=0) > 1
    for c, cell in enumerate([] if alone else row):
        word = isinstance(cell, str) and _WORD.match(cell) is not None and numbers[r][c] is None
        if word and below and sum(len(b) > c and b[c] is not None for b in below) >= 0.8 * len(below):
            return True
    return _counts_runs(row, numbers, r, r + 1)


def _counts_runs(row: list[Cell], numbers: list[list[float | None]], r: int, start: int) -> bool:
    """A row of run numbers below names of groups: `;1;2;3;1;2;3`, with nothing above the column of targets.

    start: row of the first data.
    """
    counts, below = [v for v in numbers[r] if v is not None], numbers[start : start + 5]
    gap = not row or row[0] not in (None, "") or not all(b and b[0] is not None for b in below) or not below
    if gap or len(counts) < 2 or len(counts) < len(filled_cells(row)) or r == 0 or any(numbers[r - 1]):
        return False
    return counts[0] == 1 and all(b in (a, a + 1, 1) for a, b in pairwise(counts))


def _lift_comments(rows: list[list[Cell]], numbers: list[list[float | None]], start: int) -> None:
    """Put comments between a header and its data above the header, in place. start: row of the first data."""
    head = start - 1
    while head > 0 and _is_comment(rows[head], numbers[head]):
        head -= 1
    texts = [label(c) for c in filled_cells(rows[head])]
    wide = len(texts) >= max(2, 0.6 * len(filled_cells(rows[start])))
    if head == start - 1 or not wide or any(v is not None for v in numbers[head]) or texts[0].startswith(COMMENT):
        return
    rows[head:start] = [*rows[head + 1 : start], rows[head]]
    numbers[head:start] = [*numbers[head + 1 : start], numbers[head]]


def _is_comment(row: list[Cell], numbers: list[float | None]) -> bool:
    """Whether a row is a remark: it begins with a mark of comments, or is a text alone that is no unit."""
    texts = [label(c) for c in filled_cells(row)]
    alone = len(texts) == 1 and not any(v is not None for v in numbers) and not _are_units(texts)
    return bool(texts) and (texts[0].startswith(COMMENT) or alone)


def _header_rows(rows: list[list[Cell]], numbers: list[list[float | None]], start: int) -> list[int]:
    """Up to three rows right above the data that are a header: words, at least two, or as `_is_header` decides."""
    header_rows: list[int] = []
    for r in range(start - 1, max(start - 4, -1), -1):
        if header_rows and label(rows[r][0] if rows[r] else None).startswith(("#", "%", "//")):
            break  # a remark above the header
        words = [c for c in rows[r] if isinstance(c, str) and c]
        figures = sum(v is not None for v in numbers[r])
        above_units = all(_are_units([label(c) for c in rows[k]]) for k in header_rows)  # or none stand there
        named = above_units and _counts_runs(rows[r], numbers, r, start)
        named = named or (not header_rows and bool(words) and _is_header(rows[r], numbers, r))
        if (len(words) >= 2 and figures == 0) or named:
            header_rows.insert(0, r)
        else:
            break
    return header_rows


def _names(rows: list[list[Cell]], head: list[int], width: int) -> tuple[list[str], list[str | None], int]:
    """Header texts, units, and how many rows they took."""
    if not head:
        return [f"column {i + 1}" for i in range(width)], [None] * width, 0
    texts = [[label(c) for c in rows[r]] + [""] * width for r in head]
    units: list[str | None] = [None] * width
    used = len(head)
    if len(texts) > 1:
        of_units = next((k for k in range(len(texts) - 1, 0, -1) if _are_units(texts[k][:width])), None)
        if of_units is not None:
            units = [unit_of(t.strip("[]() ")) if t else None for t in texts.pop(of_units)[:width]]
    if len(texts) > 2:  # more than a group row above the names: the rest is a preamble
        used -= len(texts) - 2
        texts = texts[-2:]
    if len(texts) == 2:
        filled = sum(bool(t) for t in texts[0][:width])
        if (
            (filled < 0.34 * width and not any(texts[0][1:width]))
            or _are_positions(texts[1])
            or _is_preamble(texts[0], texts[1][:width])
            or any(map(_is_amount, texts[0]))
        ):
            used -= 1
            texts = texts[-1:]
    if len(texts) == 2:
        last = ""
        group = []
        for text in texts[0][:width]:
            last = text or last
            group.append(last)
        names = [f"{g} {n}".strip() if g != n else n for g, n in zip(group, texts[1][:width], strict=True)]
    else:
        names = texts[0][:width]
    return [n or f"column {i + 1}" for i, n in enumerate(names)], units, used


def _are_units(texts: list[str]) -> bool:
    cells = [t.strip("[]() ") for t in texts if t]
    return any(map(unit_of, cells)) and all(unit_of(c) or c in ("-", "1") or _DATE_FORM.fullmatch(c) for c in cells)


def _metres(names: list[str]) -> list[str]:
    """`x_m` as `x [m]` where another header ends so too, or it is a target: alone it may be a measured x."""
    ending = [n for n in names if re.fullmatch(r".*\w[_ ]m", n)]
    bare = any("[" not in n and "(" not in n and split_header(n)[1] for n in names)  # `Deviation um` beside it
    metres = ending if len(ending) > 1 else [n for n in ending if bare and kind_by_name(n[:-2]) == "command"]
    return [f"{n[:-2]} [m]" if n in metres else n for n in names]


def _is_preamble(group: list[str], names: list[str]) -> bool:
    """Whether a row above the names is a fact (`Machine;VMC 3`), not a group of columns."""
    cells = [i for i, text in enumerate(group) if text]
    words = [n for n in names if n]
    complete = len(set(words)) == len(words) and all(_WORD.match(n) for n in words)
    named = len(words) > 2 or re.match(OF_A_FACT, group[0], re.IGNORECASE) is not None
    return complete and named and cells in ([0], [0, 1])


def _is_amount(text: str) -> bool:
    """Whether a cell above the names is a number with its unit, a fact: `100,000 mm`."""
    match = _NUMBER_AND_UNIT.fullmatch(text)
    return match is not None and unit_of(match.group(2)) is not None


def _are_positions(header: list[str]) -> bool:
    """Whether the names of most columns are rising or falling numbers, and no count: a column per target."""
    values = [v for text in header if text and (v := number(text, "," in text)) is not None]
    steps = np.diff(values)
    counted = np.array_equal(values, 1.0 + np.arange(len(values)))
    return len(values) > 3 and not counted and bool((steps > 0).all() or (steps < 0).all())


def _layout(
    sheet: Sheet,
    names: list[str],
    units: list[str | None],
    rows: list[list[Cell]],
    comma: bool,
    above: list[str],
    notes: list[str],
) -> Layout:
    width = max([len(names), *map(len, rows)])
    names = names + [f"column {i + 1}" for i in range(len(names), width)]
    columns, empty = [], []
    count_of: Counter[str] = Counter()
    for i, text in enumerate(_metres(names)):
        header, unit = split_header(text)
        stated = units[i] if i < len(units) else None
        if stated and unit and stated != unit:
            raise DataError(f"column {header!r}: its name states {unit}, its cells or a line above it {stated}")
        count_of[header] += 1
        if count_of[header] > 1:
            header += "'" * (count_of[header] - 1)  # no number, which would be taken for that of a run
        cells = [row[i] if i < len(row) else None for row in rows]
        try:
            thousands = (stated or unit) not in ("degC", "degF", "K") and kind_by_name(header) != "temperature"
            cells = of_one_mark(cells, comma, thousands)
        except ValueError as err:
            raise DataError(
                f"column {header!r}: {err} may have a mark of thousands or of decimals (write its numbers without "
                "thousands, with the mark of the other columns)"
            ) from None
        values = np.array([v if (v := number(c, comma)) is not None else np.nan for c in cells])
        part, _, base = (stated or unit or "").partition(" ")
        if base == "degC" and part.startswith("0."):  # `Bed [0.1 °C]`
            values, stated = values * float(part), base
            notes.append(f"{header}: {part} degC written as degC")
        if any(c not in (None, "") for c in cells):
            columns.append(RawColumn(header, stated or unit, cells, values))
        elif not header.startswith("column "):
            empty.append(header)
    if empty:
        notes.append(f"{EMPTY} {', '.join(map(repr, empty))} (in a workbook: formulas that were never computed)")
    return Layout(columns, above, notes)
