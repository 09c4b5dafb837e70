"""From cells to columns: the rows of header, units and data, and the lines above them."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, Sheet, decimal_comma, number

DEEPEST_HEADER = 200  # lines above the data: the longest preamble seen, of a laser's own file, has 60
NUMERIC_SHARE = 0.6  # of a column's cells: what is a number column with gaps and remarks

# How units are written -> how the manifest writes them. Lower case, blanks removed.
UNITS = {
    **dict.fromkeys(("µm", "μm", "um", "micron", "microns", "mikrometer", "micrometer"), "um"),
    **dict.fromkeys(("mm", "millimeter", "millimetre"), "mm"),
    **dict.fromkeys(("m", "meter", "metre"), "m"),
    **dict.fromkeys(("nm", "nanometer"), "nm"),
    **dict.fromkeys(("in", "inch", "inches", "zoll", '"'), "inch"),
    **dict.fromkeys(("mil", "thou", "0.001in", "1/1000in"), "thou"),
    **dict.fromkeys(("tenth", "tenths", "0.0001in", "1/10000in"), "tenths of a thou"),
    **dict.fromkeys(("1/100mm", "0.01mm", "0,01mm", "hundredths", "hundertstel", "hundertstelmm"), "1/100 mm"),
    **dict.fromkeys(("1/1000mm", "0.001mm", "0,001mm", "tausendstel"), "um"),
    **dict.fromkeys(("°c", "degc", "c", "celsius", "grad c", "℃", "gradc"), "degC"),
    **dict.fromkeys(("°f", "degf", "fahrenheit", "℉"), "degF"),
    **dict.fromkeys(("k", "kelvin"), "K"),
    **dict.fromkeys(("s", "sec", "sek", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec"), "ms"),
    **dict.fromkeys(("min", "minutes", "minuten"), "min"),
    **dict.fromkeys(("h", "hours", "std"), "h"),
    **dict.fromkeys(("°", "deg", "degree", "degrees", "grad"), "deg"),
    **dict.fromkeys(("µrad", "μrad", "urad"), "urad"),
    **dict.fromkeys(("mrad",), "mrad"),
    **dict.fromkeys(("rad",), "rad"),
    **dict.fromkeys(("arcsec", "″", "''", "asec"), "arcsec"),
    **dict.fromkeys(("a", "amp", "amps", "ampere"), "A"),
    **dict.fromkeys(("ma",), "mA"),
    **dict.fromkeys(("nm.", "n·m", "n.m", "n*m", "newtonmeter"), "N m"),
    **dict.fromkeys(("n", "newton"), "N"),
    **dict.fromkeys(("kn",), "kN"),
    **dict.fromkeys(("rpm", "1/min", "u/min", "rev/min", "min-1"), "rpm"),
    **dict.fromkeys(("mm/min",), "mm/min"),
    **dict.fromkeys(("m/min",), "m/min"),
    **dict.fromkeys(("mm/s",), "mm/s"),
    **dict.fromkeys(("m/s",), "m/s"),
    **dict.fromkeys(("mm/s2", "mm/s²", "mm/s^2"), "mm/s2"),
    **dict.fromkeys(("m/s2", "m/s²"), "m/s2"),
    **dict.fromkeys(("%", "%rh", "percent"), "%"),
    **dict.fromkeys(("hpa", "mbar"), "hPa"),
    **dict.fromkeys(
        ("counts", "count", "cnt", "cts", "inc", "ink", "inkremente", "pulses", "steps", "impulse"), "counts"
    ),
    **dict.fromkeys(("kg",), "kg"),
}
_BRACKET = re.compile(r"\s*[\[(]\s*([^\[\]()]{1,14})\s*[\])]\s*")
_AFTER = re.compile(r"^(.*\S)[\s_/,]+(?:in\s+)?([^\s_/,]{1,9})$")


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

    def column(self, header: str) -> RawColumn | None:
        """The column of a header, or None."""
        return next((c for c in self.columns if c.header == header), None)


def unit_of(text: str) -> str | None:
    """The unit that a text is, or None. Capital Nm is a torque, nm a length."""
    plain = text.strip().strip(".:")
    if plain in ("Nm", "N m"):
        return "N m"
    return UNITS.get(plain.lower().replace(" ", ""))


def split_header(text: str) -> tuple[str, str | None]:
    """'Abw. [µm]' -> ('Abw.', 'um'); 'pos_mm' -> ('pos', 'mm'); a header without a unit as it is."""
    text = " ".join(str(text).split())
    for bracket in reversed(list(_BRACKET.finditer(text))):
        if (unit := unit_of(bracket.group(1))) is not None:
            return " ".join((text[: bracket.start()] + " " + text[bracket.end() :]).split()) or text, unit
    after = _AFTER.match(text)
    if after and (unit := unit_of(after.group(2))) is not None and len(after.group(2)) > 1:
        return after.group(1).rstrip(" _/,"), unit
    return text, None


def lay_out(sheet: Sheet, stated: tuple[str, ...] = ()) -> Layout:
    """Header, units and data of a sheet. Raises DataError where there is no block of numbers.

    stated: names of the columns of a file without a header, by a person.
    """
    rows = sheet.rows
    comma = decimal_comma(rows)
    notes = list(sheet.notes) + (["decimal commas"] if comma else [])
    if sheet.header is not None:
        return _layout(sheet, [*sheet.header], [], rows, comma, [], notes)
    numbers = [[number(c, comma) for c in row] for row in rows]
    start = _first_data_row(sheet, numbers)
    head_rows = _header_rows(rows, numbers, start)
    names, units, used = _names(rows, head_rows, max(map(len, rows[start:])))
    above = [" ".join(str(c) for c in row if c not in (None, "")) for row in rows[: start - used]]
    if not used and stated:
        names = [*stated, *names[len(stated) :]]
    elif not used:
        notes.append("the file has no header: columns are numbered")
    return _layout(sheet, names, units, rows[start:], comma, [a for a in above if a], notes)


def _first_data_row(sheet: Sheet, numbers: list[list[float | None]]) -> int:
    """The first row of a run of rows of the usual width that hold numbers."""
    filled = [sum(c not in (None, "") for c in row) for row in sheet.rows]
    counts = [sum(v is not None for v in row) for row in numbers]
    widths = Counter(n for n, c in zip(filled, counts, strict=True) if c >= 2 or (c and n <= 2))
    if not widths:
        raise DataError(f"{sheet.name}: no row with two numbers (a table of measurements is needed)")
    width = max(widths, key=lambda n: (widths[n] * n, n))
    for r in range(min(len(filled), DEEPEST_HEADER)):
        block = range(r, min(r + 3, len(filled)))
        full = all(filled[i] >= max(2, 0.6 * width) and counts[i] >= max(1, 0.4 * filled[i]) for i in block)
        if full and not _is_header(sheet.rows[r], numbers, r):
            return r
    raise DataError(f"{sheet.name}: no block of numbers below a header in the first {DEEPEST_HEADER} lines")


def _is_header(row: list[Cell], numbers: list[list[float | None]], r: int) -> bool:
    """A row with a word above a column of numbers is a header even where its other cells are numbers (run 1, 2, 3)."""
    below = numbers[r + 1 : r + 6]
    for c, cell in enumerate(row):
        word = isinstance(cell, str) and bool(cell) and numbers[r][c] is None
        if word and below and sum(len(b) > c and b[c] is not None for b in below) >= 0.8 * len(below):
            return True
    return False


def _header_rows(rows: list[list[Cell]], numbers: list[list[float | None]], start: int) -> list[int]:
    """Up to three rows right above the data that are a header: words, at least two, or as `_is_header` decides."""
    header_rows: list[int] = []
    for r in range(start - 1, max(start - 4, -1), -1):
        words = [c for c in rows[r] if isinstance(c, str) and c]
        figures = sum(v is not None for v in numbers[r])
        if (len(words) >= 2 and figures == 0) or (
            len(words) >= 1 and _is_header(rows[r], numbers, r) and not header_rows
        ):
            header_rows.insert(0, r)
        else:
            break
    return header_rows


def _names(rows: list[list[Cell]], head: list[int], width: int) -> tuple[list[str], list[str | None], int]:
    """Header texts, units, and how many rows they took."""
    if not head:
        return [f"column {i + 1}" for i in range(width)], [None] * width, 0
    texts = [[str(c).strip() if c not in (None, "") else "" for c in rows[r]] + [""] * width for r in head]
    units: list[str | None] = [None] * width
    used = len(head)
    if len(texts) > 1:
        cells = [t.strip("[]() ") for t in texts[-1][:width] if t]
        if cells and all(unit_of(c) or c in ("-", "1") for c in cells):
            units = [unit_of(t.strip("[]() ")) if t else None for t in texts[-1][:width]]
            texts = texts[:-1]
    if len(texts) > 2:  # more than a group row above the names: the rest is a preamble
        used -= len(texts) - 2
        texts = texts[-2:]
    if len(texts) == 2:
        filled = sum(bool(t) for t in texts[0][:width])
        if filled < 0.34 * width and not any(texts[0][1:width]):
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
    columns = []
    count_of: Counter[str] = Counter()
    for i, text in enumerate(names):
        header, unit = split_header(text)
        stated = units[i] if i < len(units) else None
        count_of[header] += 1
        if count_of[header] > 1:
            header = f"{header} ({count_of[header]})"
        cells = [row[i] if i < len(row) else None for row in rows]
        values = np.array([v if (v := number(c, comma)) is not None else np.nan for c in cells])
        if any(c not in (None, "") for c in cells):
            columns.append(RawColumn(header, stated or unit, cells, values))
    return Layout(columns, above, notes)
