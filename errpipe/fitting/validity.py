"""The validity box: the ranges of what drove the fit, and how far outside of it a row lies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from errpipe.domain.error_model import Validity
from errpipe.domain.recording import Recording

MARGIN = 0.5  # of a range, the distance over which a table fades out: half of what was seen (from taste)
LEAST_MARGIN = {"temperature": 2.0}  # K
UNBOXED = ("run", "group", "time", "direction", "coolant", "ignore", "error", "simulated")


def box(recording: Recording, names: Sequence[str], rows: np.ndarray) -> Validity:
    """Ranges of the columns in `names` over the rows of a mask; time, directions and labels have none."""
    ranges, margins = {}, {}
    for name in names:
        column = recording.manifest.columns[name]
        if column.role in UNBOXED:
            continue
        values = recording.array(name)[rows]
        values = values[np.isfinite(values)]
        if values.size:
            low, high = float(values.min()), float(values.max())
            ranges[name] = (low, high)
            margins[name] = max(MARGIN * (high - low), LEAST_MARGIN.get(column.role, 1e-6))
    return Validity(ranges=ranges, margins=margins)


def distance(validity: Validity, recording: Recording) -> np.ndarray:
    """How far each row lies outside the box, shape (rows,): 0 inside, else summed over columns in ranges' widths.

    A missing value counts as a whole range outside.
    """
    total = np.zeros(len(recording))
    for name, (low, high) in validity.ranges.items():
        width = max(high - low, validity.margins.get(name, 0.0), 1e-12)
        values = recording.array(name) if name in recording.frame.columns else np.full(len(recording), np.nan)
        beyond = np.maximum(np.maximum(low - values, values - high), 0.0) / width
        total += np.where(np.isnan(values), 1.0, beyond)
    return total
