"""Columns that qualify a neighbouring value: its quality (OPC UA, historians, data loggers), or its unit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from errpipe.importing.layout import Layout
from errpipe.importing.sheet import Cell, label
from errpipe.importing.units import unit_of
from errpipe.importing.units_above import UNITS
from errpipe.importing.words import kind_by_name, plain

_FLAG = re.compile(r".*\b(valid(ity|e)?|gueltig(keit)?)\b'*")  # 1 or 0, true or false
_NAMED = re.compile(rf"{_FLAG.pattern}|.*\b(quality|qualitaet|qualite|calidad|qualita|status|status ?code)\b'*")
_GOOD_WORDS = re.compile(
    r"good.*|gut|ok|okay|valid|gueltig|192|0x0+|0|normal|bon|buono|buena?|true|wahr|yes|ja|no (?:error|fault)s?"
    r"|keine? (?:fehler|stoerung)"
)
# Not `fail` and `nok`: next to deviations they mean that a tolerance was exceeded.
_BAD_WORDS = re.compile(
    r"(?:bad|uncertain|invalid|ungueltig|schlecht|stale|questionable|not connected|no data|comm|mauvais|malo|substitut"
    r"|last known|sensor|0x[48c]|false|falsch|no$|nein$|beam|signal|lost|over ?(?:range|flow)|saturat|time ?out"
    r"|no reading|error|fault|stoerung)\w*.*"
)
GOOD, UNCERTAIN = 192, 0x40000000  # of OPC DA, and of OPC UA (Part 4, StatusCode)
MOST_OTHERS = 0.2  # share of the rows; above it the words are states of a program
_KEPT = ("time", "run", "group", "direction", "command", "position")


def is_quality(header: str) -> bool:
    """Whether a column is named as a quality or a status."""
    return _NAMED.fullmatch(plain(header)) is not None


def bad(cells: Sequence[Cell], header: str) -> np.ndarray:
    """Which values are not good, shape (cells,); none if the labels are not those of a quality.

    As numbers: 192 is good, less is not (OPC DA); 0 is good, 0x40000000 and above are not (OPC UA); of a column that
    says `valid`, 0 is not.
    """
    words = [plain(label(c)) for c in cells]
    if _FLAG.fullmatch(plain(header)) and {*words} == {"0", "1"}:
        return np.array([w == "0" for w in words])
    codes = [float(w) for w in words if re.fullmatch(r"\d{1,10}(\.0)?", w)]
    if codes and len(codes) == sum(map(bool, words)):
        least = GOOD if GOOD in codes and max(codes) < 256 else 0.0
        most = UNCERTAIN if all(c == 0 or c >= UNCERTAIN for c in codes) else np.inf
        return np.array([bool(w) and not least <= float(w) < most for w in words])
    out = np.array([_BAD_WORDS.fullmatch(w) is not None for w in words])
    known = all(_GOOD_WORDS.fullmatch(w) or _BAD_WORDS.fullmatch(w) for w in words if w)
    return out if known else np.zeros(out.size, dtype=bool)


def blank(layout: Layout) -> None:
    """Empty the values that a quality column to their right marks as bad, with a note.

    A quality applies to the numeric columns before it, up to another quality; times and positions are not emptied.
    """
    begin = 0
    for k, c in enumerate(layout.columns):
        if not is_quality(c.header):
            continue
        out = bad(c.cells, c.header)
        words = [plain(label(cell)) for cell in c.cells if cell not in (None, "")]
        others = [w for w in words if not (_GOOD_WORDS.fullmatch(w) or _BAD_WORDS.fullmatch(w) or w.isdecimal())]
        if 0 < len(others) < MOST_OTHERS * len(words):
            says = f"{len(others)} rows have {others[0]!r} in {c.header!r}: kept (if they are no readings, empty them)"
            layout.notes.append(says)
        for of in layout.columns[begin:k] if out.any() else []:
            if of.numeric and kind_by_name(of.header) not in _KEPT and np.isfinite(of.values[out]).any():
                of.cells = [None if o else cell for o, cell in zip(out, of.cells, strict=True)]
                of.values = np.where(out, np.nan, of.values)
                layout.notes.append(f"{of.header}: {int(out.sum())} values marked as bad by {c.header!r} were excluded")
        begin = k + 1


def apply_unit_columns(layout: Layout) -> None:
    """A unit column, named as such, states the unit of the numbers to its left: `Value;Unit`, in every row `mm`."""
    for of, c in pairwise([*layout.columns]):
        written = {label(cell) for cell in c.cells if cell not in (None, "")}
        unit = unit_of(next(iter(written))) if len(written) == 1 else None
        if unit is not None and of.numeric and of.unit is None and UNITS.fullmatch(plain(c.header).strip("' ")):
            of.unit = unit
            layout.columns = [other for other in layout.columns if other is not c]
            layout.notes.append(f"{of.header}: in {unit}, from column {c.header!r} next to it")
