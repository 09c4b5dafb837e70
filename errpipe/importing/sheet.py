"""The cells of a measurement file, before they are interpreted."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from errpipe.errors import DataError, UsageError

Cell = str | float | None
Rows = list[list[Cell]]
Numbers = list[list[float | None]]  # of the cells of rows
MOST_CELLS = 12_000_000  # cells: about 1 GB of Python objects of 80 bytes each
INVISIBLE = re.compile(
    "[\u200b\u200e\u200f\u202a-\u202e\u2066-\u2069\ufeff]"
)  # marks of the writing direction, of no width
MINUS = str.maketrans(
    {"−": "-", "–": "-", "－": "-", "＋": "+", "．": ".", "，": ",", "\u00a0": "", "\u202f": "", "\u2009": ""}
)
_USUAL = re.compile(r"[+-]?[0-9]{1,20}(\.[0-9]{0,18})?")  # equal by every rule below, without their cost
_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")  # D: the exponent of Fortran
_COMMA = re.compile(r"[+-]?\d*,\d+([eEdD][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+")
_GROUPED_BY_MARKS = re.compile(r"[+-]?\d{1,3}(['’]\d{3})+([.,]\d+)?")
_MINUS_BEHIND = re.compile(r"[\d.,]*[.,]\d+-")
_DOUBTFUL = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
_GROUPS = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}(?:\1\d{3})+")
_BLANK_WITHIN = re.compile(r"(?<=\d) (?=\d{3}(?!\d))|(?<=^[+-]) +")
_GROUPED_BY_COMMAS = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?")
_SEXAGESIMAL = re.compile(  # 15°00'01.86", -0° 0′ 2″
    r"([+-]?)(\d{1,4})\s*[°º]\s*([0-5]?\d)\s*['’′]\s*(?:([0-5]?\d(?:[.,]\d+)?)\s*(?:\"|″|”|''|′′))?"
)


@dataclass(frozen=True)
class ReaderOptions:
    """Options of a file. names: of the columns if it has no header; period: s between rows."""

    sheet: str | None = None
    names: tuple[str, ...] = ()
    period: float | None = None


@dataclass
class Sheet:
    """One table of cells. header: column names if the file states them separately; notes: remarks of the reader.

    above: lines of text that the file states outside the table.
    """

    name: str
    rows: list[list[Cell]]
    header: list[str] | None = None
    notes: list[str] = field(default_factory=list)
    above: list[str] = field(default_factory=list)

    def limited(self) -> Sheet:
        """The sheet itself. Raises DataError if it has more cells than MOST_CELLS."""
        affordable(sum(len(row) for row in self.rows), self.name)
        return self


@contextmanager
def readable(path: Path, what: str, hint: str = "export it again, or as CSV") -> Iterator[None]:
    """Raises DataError for an error within it: libraries raise many types of them for damaged files."""
    try:
        yield
    except (UsageError, DataError, MemoryError):
        raise
    except Exception as err:
        raise DataError(f"{path}: not {what} that can be read ({type(err).__name__}): {hint}") from None


def affordable(cells: int, name: object) -> None:
    """Raise DataError if so many cells, or lines, would need too much memory."""
    if cells > MOST_CELLS:
        raise DataError(f"{name}: {cells} cells (at most {MOST_CELLS} are imported; split the file)")


def cell_of(value: Any) -> Cell:
    """A value of a file's library as a cell: a number, a date in ISO 8601, a duration in s, or text."""
    if isinstance(value, str):
        return INVISIBLE.sub("", value) or None
    if value is None or isinstance(value, float):
        return value
    if isinstance(value, int):
        return float(value)
    if isinstance(value, datetime.timedelta):
        return value.total_seconds()
    return value.isoformat() if hasattr(value, "isoformat") else str(value)


def number(cell: Any, comma: bool) -> float | None:
    """A cell as a number, or None. comma: whether the file writes decimal commas."""
    if isinstance(cell, float):
        return cell
    if isinstance(cell, int):
        return float(cell)
    if not cell:
        return None
    if isinstance(cell, str) and _USUAL.fullmatch(cell):
        return float(cell)
    text = str(cell).strip().translate(MINUS)
    if " " in text:  # thousands separator, or after a sign: `12 345`, `- 5.2`
        text = _BLANK_WITHIN.sub("", text)
    if len(text) > 40:
        return None
    if (parts := _SEXAGESIMAL.fullmatch(text)) is not None:
        degrees = int(parts[2]) + int(parts[3]) / 60.0 + float((parts[4] or "0").replace(",", ".")) / 3600.0
        return -degrees if parts[1] == "-" else degrees
    if _MINUS_BEHIND.fullmatch(text):  # as some planning systems write: 5,2-
        text = f"-{text[:-1]}"
    if _GROUPED_BY_MARKS.fullmatch(text):
        text = text.replace("'", "").replace("’", "")
    if comma and (_COMMA.fullmatch(text) or _GROUPED.fullmatch(text)):
        text = text.replace(".", "").replace(",", ".")
    elif not comma and _GROUPED_BY_COMMAS.fullmatch(text):
        text = text.replace(",", "")
    return float(text.upper().replace("D", "E")) if _PLAIN.fullmatch(text) else None


def is_sexagesimal(cell: Cell) -> bool:
    """Whether a cell is an angle in degrees, minutes and seconds, which `number` reads in degrees."""
    return isinstance(cell, str) and _SEXAGESIMAL.fullmatch(cell.strip().translate(MINUS)) is not None


def of_one_mark(cells: list[Cell], comma: bool, thousands: bool = True) -> list[Cell]:
    """The cells of a column as `number` reads them, whichever decimal and thousands separators it has.

    comma: whether the file writes decimal commas. `75.000` there is 75000 if the column shows it: it contains commas,
    `1.234.567`, or `0` with `75.000`. thousands: whether the quantity can reach thousands, unlike a
    temperature. Raises ValueError with an ambiguous cell.
    """
    other = "." if comma else ","
    texts = {
        i: c.strip().translate(MINUS).lstrip("+-") for i, c in enumerate(cells) if isinstance(c, str) and other in c
    }
    marked = {i: t for i, t in texts.items() if re.fullmatch(rf"\d*\{other}\d+|\d{{1,3}}(\{other}\d{{3}})+", t)}
    if not marked:
        return cells
    groups = [t.split(other) for t in marked.values()]
    irregular = any(len(g) == 2 and (len(g[1]) != 3 or not 0 < len(g[0]) <= 3 or g[0].startswith("0")) for g in groups)
    if irregular or not thousands:
        if comma:
            return cells
        return [str(c).replace(",", ".") if i in marked else c for i, c in enumerate(cells)]
    rest = [str(c).strip().translate(MINUS).lstrip("+-") for i, c in enumerate(cells) if i not in marked and c]
    mixed = any(re.fullmatch(r"\d*" + (r"(\.\d{3})*," if comma else r"(,\d{3})*\.") + r"\d+", t) for t in rest)
    whole = any(re.fullmatch(r"\d{1,3}", t) for t in rest) and any(t.endswith("0") for t in marked.values())
    if not (mixed or whole or any(len(g) > 2 for g in groups)):
        raise ValueError(next(iter(marked.values())))
    return [str(c).replace(other, "") if i in marked else c for i, c in enumerate(cells)]


def label(cell: Cell) -> str:
    """A cell as the name of a run or group: 1.0 -> '1'."""
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return "" if cell is None else str(cell).strip()


def filled_cells(row: list[Cell]) -> list[Cell]:
    """The cells of a row that are not empty."""
    return [c for c in row if c not in (None, "")]


def decimal_comma(rows: list[list[Cell]]) -> bool:
    """Whether the numbers of a file have decimal commas: more cells are numbers with them than with points.

    A separator before three digits may be one of thousands: it counts if no other cell shows more.
    """
    commas = points = doubtful = 0
    for row in rows[:2000]:
        for cell in row:
            if isinstance(cell, str) and cell:
                text = cell.strip().translate(MINUS)
                if _DOUBTFUL.fullmatch(text):
                    doubtful += 1 if "," in text else -1
                    continue
                if groups := _GROUPS.fullmatch(text):  # 1,000,000: the decimal separator is the other one
                    points, commas = points + (groups[1] == ","), commas + (groups[1] == ".")
                    continue
                commas += _COMMA.fullmatch(text) is not None or _GROUPED.fullmatch(text) is not None
                points += "." in text and (_PLAIN.fullmatch(text) or _GROUPED_BY_COMMAS.fullmatch(text)) is not None
    return commas > points or (commas == points > 0 and doubtful > 0)
