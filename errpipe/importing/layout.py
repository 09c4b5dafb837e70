"""From cells to columns: the rows of header, units and data, and the lines above them."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.blocks import blocks, sections
from errpipe.importing.header import (
    NUMBER_AND_UNIT,
    header_rows,
    is_header,
    is_moment,
    is_word,
    lift_comments,
    named_above,
    names_of,
    with_metres,
)
from errpipe.importing.sheet import (
    Cell,
    Numbers,
    Rows,
    Sheet,
    decimal_comma,
    filled_cells,
    is_sexagesimal,
    label,
    number,
    of_one_mark,
)
from errpipe.importing.units import split_header, unit_of
from errpipe.importing.units_above import units_of_columns
from errpipe.importing.words import is_correction, is_following_error, kind_by_name

DEEPEST_HEADER = 200  # lines above the data: the longest known preamble, of a laser's own file, has 60
MOST_REMARKS = 50  # lines below a table that are kept as comments
SAMPLE_ROWS = 200  # rows in which a unit after the numbers is searched for
BY_NAME = "of the sheet or file"
COMPONENT = r"\bE[XYZABC][XYZABCUVW]\b"  # from ISO 230-1, of a moving axis
NEEDED = "needed: a table of measurements with a column per signal"
EMPTY = "columns without a value:"  # a note that an error message repeats
NUMERIC_SHARE = 0.6  # of a column's cells: minimum for a numeric column with gaps and comments

_AXIS_OF_SHEET = re.compile(
    r"^([XYZ])\d?$|\b(?:axis|achse|axe|asse|eje)[ -]?([XYZABCUVW])\b|\b([XYZABCUVW])[ -]?(?:axis|achse|axe|asse)\b",
    re.IGNORECASE,
)
_PIVOT = re.compile(  # how Excel heads the rows of a pivot table
    r"Row Labels|Zeilenbeschriftungen|[ÉE]tiquettes de lignes|Etichette di riga|Etiquetas de fila|行标签|行ラベル"
)
_LENGTHS = re.compile(r"(l(ä|ae)nge|length|samples|anzahl|no\. of values)", re.IGNORECASE)  # of columns, above them
_RULE = re.compile(r"[-=_+:~*|]{2,}")
_GRID = re.compile(r"\+([-=]{2,}\+){2,}")  # between the rows of a table in reStructuredText


class NoReadingError(DataError):
    """A table of times, as of a logger whose sensor was dead: it says nothing, and spoils no other file."""


@dataclass
class RawColumn:
    """One column: its header without the unit, the unit in canonical spelling, its cells, and their numbers."""

    header: str
    unit: str | None
    cells: list[Cell]
    values: np.ndarray  # NaN for a cell that is not a number

    def take(self, rows: np.ndarray) -> RawColumn:
        """The column with some of its rows, by number."""
        return RawColumn(self.header, self.unit, [self.cells[i] for i in rows], self.values[rows])

    @property
    def texts(self) -> list[str]:
        """The filled cells as texts."""
        return [str(cell).strip() for cell in filled_cells(self.cells)]

    @property
    def numeric(self) -> bool:
        """Whether most filled cells are numbers."""
        filled = len(self.cells) - self.cells.count(None) - self.cells.count("")
        return filled > 0 and int(np.isfinite(self.values).sum()) >= NUMERIC_SHARE * filled


@dataclass
class Layout:
    """Columns of a sheet, the text above them, and notes on decisions."""

    columns: list[RawColumn]
    above: list[str]
    notes: list[str] = field(default_factory=list)
    below: list[str] = field(default_factory=list)  # lines of text among and below the rows

    def column(self, header: str) -> RawColumn | None:
        """The column with a header, or None."""
        return next((c for c in self.columns if c.header == header), None)


def find_layout(sheet: Sheet, stated: tuple[str, ...] = ()) -> Layout:
    """Header, units and data of a sheet. Raises DataError if there is no block of numbers.

    stated: names of the columns of a file without a header, from the user.
    """
    rows = [row for row in sheet.rows if filled_cells(row) and not _is_rule(row)]
    rows = _of_a_pivot(_with_marked_header(rows))
    rows, unit_in_cells = _without_units(rows)
    comma = decimal_comma(rows)
    notes = list(sheet.notes) + (["decimal commas"] if comma else [])
    if sheet.header is not None:
        header = [*(stated if len(stated) == len(sheet.header) else sheet.header)]
        return _layout(sheet, header, [], rows, comma, [*sheet.above, *stated_by_name(sheet.name)], notes)
    numbers = [[number(c, comma) for c in row] for row in rows]
    start = _first_data_row(sheet.name, rows, numbers)
    lift_comments(rows, numbers, start)
    head_rows = header_rows(rows, numbers, start)
    names, units, used = names_of(rows, head_rows, max(map(len, rows[start:])))
    above = [" ".join(str(c) for c in row if c not in (None, "")) for row in rows[: start - used]]
    above += [*sheet.above, *stated_by_name(sheet.name)]
    called = names if used else [*stated, *names[len(stated) :]]
    units = [
        u or a or unit_in_cells.get(i)
        for i, (u, a) in enumerate(zip(units, units_of_columns(rows, start - used, called), strict=True))
    ]
    names = named_above(_merged(names, numbers[start:]), rows[: start - used])
    if stated:
        units = [u or split_header(n)[1] for u, n in zip(units, names, strict=True)]
        names = [*_stated_names(stated, len(names), used > 0), *names[len(stated) :]]
    elif not used and len(names) == 2 and all(map(is_moment, (row[0] for row in rows[start:]))):
        names[1] = sheet.name  # of a logger with one sensor: `bed_temperature.csv`
        notes.append(
            f"no header: the column has the name of the file or sheet, {sheet.name!r} (--names gives it another)"
        )
    elif not used and "column 2" in names:
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


def _with_marked_header(rows: Rows) -> Rows:
    """The rows with their names first, where marks tell them from types: TOA5 of data loggers, `#NAMES` of Ignition."""
    first = [label(row[0]) for row in rows[:DEEPEST_HEADER]]
    if len(rows) > 4 and first[0] == "TOA5":  # names, units, and how values were sampled
        units_below = [f" [{u}]" if u not in ("", None, "TS", "RN") else "" for u in rows[2]]
        return [[f"{n}{u}" for n, u in zip(rows[1], units_below, strict=False)], *rows[4:]]
    if len(rows) > 5 and (first[0], first[2], first[4]) == ("#NAMES", "#TYPES", "#ROWS"):
        return [rows[1], *rows[5:]]
    return rows


def _of_a_pivot(rows: Rows) -> Rows:
    """The rows with the title of a pivot table, `Average of Deviation (um)`, above it: not a name of its targets."""
    for r in range(1, min(len(rows), DEEPEST_HEADER)):
        if _PIVOT.fullmatch(str(rows[r][0]).strip()) and isinstance(rows[r - 1][0], str):
            return [*rows[: r - 1], rows[r - 1][:1], [None, *rows[r - 1][1:]], ["target", *rows[r][1:]], *rows[r + 1 :]]
    return rows


def _merged(names: list[str], numbers: Numbers) -> list[str]:
    """Names completed for cells merged over several columns of numbers: `Up`, `Up 2`, `Up 3`, `Down`, ...

    At least two such cells of equal width are needed: a single unnamed column is not a merged cell.
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


def stated_by_name(name: str, of: str = "") -> list[str]:
    """Lines that state the axis, the component, and whether corrections, from the name of a sheet, file or folder."""
    text = name.replace("_", " ")
    kind = [of + text] if is_correction(text) or is_following_error(text) else []
    axis = [f"Axis: {letter} ({BY_NAME} {name!r})" for letter in axis_of_name(name)]
    return [*kind, *axis, *(f"Component: {found} ({BY_NAME})" for found in re.findall(COMPONENT, text))]


def axis_of_name(name: str) -> list[str]:
    """The axis in the name of a sheet or file: `Y`, `Achse Y`, `y-axis_2026`, `laser_Y_run1`; not `b1`, `X_Y`."""
    name = name.replace("_", " ")
    match, alone = _AXIS_OF_SHEET.search(name), re.findall(r"(?:^|(?<=[ +-]))[XYZ](?=[ +-]|$)", name)
    return [next(filter(None, match.groups())).upper()] if match else alone if len(alone) == 1 else []


def _is_rule(row: list[Cell]) -> bool:
    """Whether a row is a drawn line, as below the header of a table in Markdown."""
    cells = filled_cells(row)
    alone = len(cells) == 1 and not _GRID.fullmatch(str(cells[0]))
    return all(isinstance(c, str) and _RULE.fullmatch(c) for c in cells) and not alone


def _stated_names(stated: tuple[str, ...], width: int, header: bool) -> tuple[str, ...]:
    """The names from the user. Raises DataError if their number differs from that of the columns."""
    if len(stated) > width or (header and len(stated) != width):
        raise DataError(f"--names gives {len(stated)} names, the table has {width} columns")
    return stated


def _unit_behind(text: str) -> str | None:
    """The unit behind a number: `68.2 F` is a temperature, while `Error F` is of a forward pass."""
    return "degF" if text == "F" else unit_of(text)


def _without_units(rows: Rows) -> tuple[Rows, dict[int, str]]:
    """The rows without units after their numbers (`12,5 µm`), and the unit of each column that had one."""
    counts: dict[int, Counter[str]] = {}
    for row in rows[:SAMPLE_ROWS]:
        for i, cell in enumerate(row):
            if isinstance(cell, str) and (match := NUMBER_AND_UNIT.fullmatch(cell)) and _unit_behind(match.group(2)):
                counts.setdefault(i, Counter())[match.group(2)] += 1
    written = {i: c.most_common(1)[0][0] for i, c in counts.items() if len(c) == 1 and c.total() > 2}
    if not written:
        return rows, {}

    def bare(i: int, cell: Cell) -> Cell:
        match = NUMBER_AND_UNIT.fullmatch(cell) if i in written and isinstance(cell, str) else None
        return match.group(1) if match and match.group(2) == written[i] else cell

    units = {i: unit for i, text in written.items() if (unit := _unit_behind(text)) is not None}
    return [[bare(i, cell) for i, cell in enumerate(row)] for row in rows], units


def _first_data_row(name: str, rows: Rows, numbers: Numbers) -> int:
    """The first row of a run of rows of the usual width that contain numbers."""
    filled, counts = _widths(rows, numbers)
    widths = Counter(n for n, c in zip(filled, counts, strict=True) if c >= 2 or (c and n <= 2))
    if not widths:
        raise DataError(f"{name}: no row with two numbers ({NEEDED})")
    width = max(widths, key=lambda n: (widths[n] * n, n))
    for r in range(min(len(filled), DEEPEST_HEADER)):
        block = range(r, min(r + 3, len(filled)))
        full = all(filled[i] >= max(2, 0.6 * width) and counts[i] >= max(1, 0.4 * filled[i]) for i in block)
        fact = counts[r] == 1 and width > 2 == filled[r] and is_word(rows[r][0])
        fact |= _LENGTHS.fullmatch(str(rows[r][0]).strip(" :")) is not None
        if full and not fact and not is_header(rows[r], numbers, r):
            return r
    if width == 1 and not counts[0] and len(filled_cells(rows[0])) > 1:
        raise NoReadingError(f"{name}: no value below {', '.join(map(repr, filled_cells(rows[0])[1:]))}")
    raise DataError(f"{name}: no block of numbers below a header in the first {DEEPEST_HEADER} lines ({NEEDED})")


def _widths(rows: Rows, numbers: Numbers) -> tuple[list[int], list[int]]:
    """Filled cells and numbers of each row; for rows of numbers those of the widest one nearby.

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


def _layout(
    sheet: Sheet, names: list[str], units: list[str | None], rows: Rows, comma: bool, above: list[str], notes: list[str]
) -> Layout:
    width = max([len(names), *map(len, rows)])
    names = names + [f"column {i + 1}" for i in range(len(names), width)]
    columns, empty = [], []
    count_of: Counter[str] = Counter()
    for i, text in enumerate(with_metres(names)):
        header, unit = split_header(text)
        stated = units[i] if i < len(units) else None
        if stated and unit and stated != unit:
            raise DataError(f"column {header!r}: its name states {unit}, but its cells or a line above it {stated}")
        count_of[header] += 1
        if count_of[header] > 1:
            header += "'" * (count_of[header] - 1)  # not a number, which would be read as that of a run
        cells = [row[i] if i < len(row) else None for row in rows]
        try:
            thousands = (stated or unit) not in ("degC", "degF", "K") and kind_by_name(header) != "temperature"
            cells = of_one_mark(cells, comma, thousands)
        except ValueError as err:
            raise DataError(
                f"column {header!r}: {err} has an ambiguous thousands or decimal separator (write its numbers without "
                "thousands separators, with the decimal separator of the other columns)"
            ) from None
        values = np.array([v if (v := number(c, comma)) is not None else np.nan for c in cells])
        if any(map(is_sexagesimal, cells)):
            stated = "deg"
        part, _, base = (stated or unit or "").partition(" ")
        if base == "degC" and part.startswith("0."):  # `Bed [0.1 °C]`
            values, stated = values * float(part), base
            notes.append(f"{header}: {part} degC converted to degC")
        if any(c not in (None, "") for c in cells):
            columns.append(RawColumn(header, stated or unit, cells, values))
        elif not header.startswith("column "):
            empty.append(header)
    if empty:
        notes.append(f"{EMPTY} {', '.join(map(repr, empty))} (in a workbook: formulas that were never computed)")
    return Layout(columns, above, notes)
