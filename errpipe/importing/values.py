"""Properties of a column's values, independent of its header: sizes, even steps, statistics of scatter."""

from __future__ import annotations

import re

import numpy as np

from errpipe.importing.layout import RawColumn
from errpipe.importing.words import plain

COLDEST, HOTTEST = -40.0, 250.0  # degC: usual range of sensors in shops and machines
LEAST_OVER_DEVIATIONS = 20.0  # by judgement: deviations of 5 % of the travel are no positioning test
FARTHEST_UM = 1e4  # um: threshold: no deviation of an axis reaches a centimetre

SCATTER = "a measure of scatter by its name and its non-negative values: not a reading"


def is_even_time(column: RawColumn) -> bool:
    """Whether a column named `t ...` rises by even steps: `t_NI` of a card of that name."""
    return plain(column.header).startswith("t ") and rises_evenly(column)


def rises_evenly(column: RawColumn) -> bool:
    """Whether the values rise by even steps, as a clock's do."""
    steps = np.diff(column.values)
    return steps.size > 3 and bool(np.ptp(steps) <= 0.01 * np.median(steps) and np.median(steps) > 0)


def too_large_for_a_deviation(column: RawColumn) -> bool:
    """Whether values in um exceed the range of any deviation: positions logged in um."""
    numbers = known(column)
    return column.unit == "um" and numbers.size > 0 and float(np.ptp(numbers)) > FARTHEST_UM


def is_nano_travel(small: RawColumn, read: RawColumn) -> bool:
    """Whether a small length is the travel of a nano-stage: far longer than the range of the deviations beside it."""
    um = {"um": 1.0, "nm": 1e-3}
    ranges = [um.get(c.unit or "", np.nan) * float(np.ptp(known(c))) for c in (small, read) if known(c).size]
    return len(ranges) == 2 and ranges[0] > LEAST_OVER_DEVIATIONS * ranges[1]


def plausible_in_celsius(column: RawColumn) -> bool:
    """Whether the median reading is plausible in degC, for a shop or a machine."""
    numbers = known(column)
    return numbers.size == 0 or COLDEST <= float(np.median(numbers)) <= HOTTEST


def as_long_as_a_travel(column: RawColumn) -> bool:
    """Whether values in mm (um) exceed the range of any deviation."""
    numbers, unit = known(column), {"mm": 1e3, "um": 1.0, "m": 1e6, "inch": 25.4e3}.get(column.unit or "mm", 0.0)
    return numbers.size > 0 and float(np.ptp(numbers)) * unit > FARTHEST_UM


def known(column: RawColumn) -> np.ndarray:
    """The numbers of a column, without its empty cells."""
    return column.values[np.isfinite(column.values)]


def is_scatter(column: RawColumn) -> bool:
    """Whether a column contains a measure of scatter next to readings: `Image RMS`, `U(95) X`, `sigma`."""
    named = re.search(r"\b(rms|rmse|std ?(dev)?|stdev|sigma|noise|scatter|streuung|u ?\(?95)", plain(column.header))
    return named is not None and not bool(np.any(column.values < 0))


def numbers_targets(column: RawColumn) -> bool:
    """Whether a column has whole numbers below `Target No.` or `target_id`: of a list, not in mm."""
    named = re.search(r"(?:^|[\s.])(?:no|nr|num|number|nummer|id|idx|index|n°|#)\.?$", plain(column.header))
    return named is not None and bool(np.all(np.round(known(column)) == known(column)))
