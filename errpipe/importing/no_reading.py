"""Cells without a reading: emptied if certain, queried if they may be readings."""

from __future__ import annotations

import re

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.dates import is_date
from errpipe.importing.layout import Layout, RawColumn
from errpipe.importing.words import kind_by_name

LARGEST = 1e30  # in any unit; SCPI instruments write 9.91e37 for a missing reading
FILLED_IN = (  # markers of missing values: nines, and the largest integer
    *(999, 999.9, 999.99, 9999, 9999.9, 9999.99, 99999, 99999.9, 99999.99, 999999, 999999.9),
    *(32767, 32768, 65535, 2147483647),
)
_IN_BRACKETS = re.compile(r"\(\s*\d[\d.,]*\s*\)")
_MARKED = re.compile(r"[+-]?\d[\d.,' ]*[.,'][\d.,']*")

_DEGREES = {None: (1.0, 0.0), "degC": (1.0, 0.0), "degF": (1.0 / 1.8, -32.0 / 1.8), "K": (1.0, -273.15)}
COLDEST, WARM, HOTTEST = -60.0, 120.0, 300.0  # degC: beyond them a broken or shorted sensor (-200, -127, 850, 1372)


def _of_no_machine(c: RawColumn) -> np.ndarray:
    """Temperatures that are implausible for a machine, next to others of which none is hotter than WARM."""
    factor, shift = _DEGREES.get(c.unit, (0.0, 0.0))
    if factor == 0.0 or (c.unit is None and kind_by_name(c.header) != "temperature"):
        return np.zeros(c.values.size, dtype=bool)
    degrees = factor * c.values + shift
    beyond = (degrees < COLDEST) | (degrees > HOTTEST)
    others = degrees[np.isfinite(degrees) & ~beyond]
    return beyond if others.size > beyond.sum() and others.max(initial=0.0) < WARM else np.zeros(beyond.size, bool)


def blank(layout: Layout) -> None:
    """Empty numbers beyond any quantity, and -9999 far from the others, with a note.

    Raises DataError for a number in brackets (negative, as in accounting, or doubtful) and for a cell that is not a
    number although it consists of digits and marks.
    """
    for c in layout.columns:
        texts = [str(c.cells[i]) for i in np.flatnonzero(np.isnan(c.values))] if c.numeric else []
        if doubtful := next((x for x in texts if _IN_BRACKETS.fullmatch(x)), None):
            raise DataError(
                f"column {c.header!r}: {doubtful!r}: negative, or doubtful? (write -1.5, or leave it empty)"
            )
        if other := next((x for x in texts if _MARKED.fullmatch(x) and not is_date(x)), None):
            raise DataError(f"column {c.header!r}: {other!r} is not a number like the others (correct or empty it)")
        beyond = (np.abs(c.values) > LARGEST) | _of_no_machine(c)
        filled = np.isin(np.abs(c.values), FILLED_IN)
        others = np.abs(c.values[np.isfinite(c.values) & ~filled & ~beyond])
        if filled.any() and others.size and np.abs(c.values[filled]).min() > 10.0 * others.max():
            beyond |= filled
        if beyond.any():
            first = c.values[np.argmax(beyond)]
            c.cells = [None if out else cell for cell, out in zip(c.cells, beyond, strict=True)]
            c.values = np.where(beyond, np.nan, c.values)
            layout.notes.append(f"{c.header}: {int(beyond.sum())} values are treated as missing (the first: {first:g})")
