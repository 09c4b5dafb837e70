"""The cells of a measurement file, before they are interpreted."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

from errpipe.errors import DataError

Cell = str | float | None
MOST_CELLS = 12_000_000  # about 1 GB of Python objects at 80 bytes each would be 12 million
MINUS = str.maketrans({"−": "-", "–": "-", "\u00a0": "", "\u202f": "", "\u2009": ""})
_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+")
_GROUPED_BY_MARKS = re.compile(r"[+-]?\d{1,3}(['’]\d{3})+([.,]\d+)?")
_MINUS_BEHIND = re.compile(r"[\d.,]*[.,]\d+-")
_GROUPED_BY_COMMAS = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d+)?")


@dataclass(frozen=True)
class DoorOptions:
    """Options of a file. names: of the columns where it has no header; period: s between rows."""

    sheet: str | None = None
    names: tuple[str, ...] = ()
    period: float | None = None


@dataclass
class Sheet:
    """One table of cells. header: its column names where the file states them apart; notes: remarks of the door."""

    name: str
    rows: list[list[Cell]]
    header: list[str] | None = None
    notes: list[str] = field(default_factory=list)

    def limited(self) -> Sheet:
        """The sheet itself. Raises DataError where it holds more cells than MOST_CELLS."""
        affordable(sum(len(row) for row in self.rows), self.name)
        return self


def affordable(cells: int, name: object) -> None:
    """Raise DataError where so many cells, or lines, are more than memory should be spent on."""
    if cells > MOST_CELLS:
        raise DataError(f"{name}: {cells} cells (at most {MOST_CELLS} are imported; split the file)")


def number(cell: Any, comma: bool) -> float | None:
    """A cell as a number, or None. comma: whether the file writes decimal commas."""
    if isinstance(cell, float):
        return cell
    if isinstance(cell, int):
        return float(cell)
    if not cell:
        return None
    text = str(cell).strip().translate(MINUS).replace(" ", "")
    if len(text) > 40:
        return None
    if _MINUS_BEHIND.fullmatch(text):  # as some planning systems write: 5,2-
        text = f"-{text[:-1]}"
    if _GROUPED_BY_MARKS.fullmatch(text):
        text = text.replace("'", "").replace("’", "")
    if comma and (_COMMA.fullmatch(text) or _GROUPED.fullmatch(text)):
        text = text.replace(".", "").replace(",", ".")
    elif not comma and _GROUPED_BY_COMMAS.fullmatch(text):
        text = text.replace(",", "")
    return float(text) if _PLAIN.fullmatch(text) else None


def label(cell: Cell) -> str:
    """A cell as the name of a run or group: 1.0 -> '1'."""
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    return "" if cell is None else str(cell).strip()


def decimal_comma(rows: list[list[Cell]]) -> bool:
    """Whether the numbers of a file have decimal commas: more cells are numbers with them than with points."""
    commas = points = 0
    for row in rows[:2000]:
        for cell in row:
            if isinstance(cell, str) and cell:
                text = cell.strip().translate(MINUS)
                commas += _COMMA.fullmatch(text) is not None or _GROUPED.fullmatch(text) is not None
                points += "." in text and (_PLAIN.fullmatch(text) or _GROUPED_BY_COMMAS.fullmatch(text)) is not None
    return commas > points
