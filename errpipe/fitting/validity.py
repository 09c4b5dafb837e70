"""The validity box: the ranges of the inputs of the fit, and the distance of a row outside them.

The box covers sufficient rows, not the extremes: a few rows beyond a gap (three readings of
60 degC among 1,770 below 25) do not widen it. They remain in the fit, and a note states it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from errpipe.domain.error_model import Validity
from errpipe.domain.recording import Recording
from errpipe.errors import MissingColumn, did_you_mean

MARGIN = 0.5  # of a range: distance over which a table fades out (by judgement)
MIN_MARGIN = {"temperature": 2.0}  # K
FEW = 0.01  # of the rows: at most so many beyond a gap are ignored; chosen on: a thermal state of a day has more
GAP = 0.25  # of the range of the other rows; chosen on: the targets of an ISO 230-2 test (five or more) are closer
LONGEST_HELD = 3  # readings of a sensor at its usual rate: one or two empty cells; unknown after a longer gap
HELD_AT_THE_END = ("position", "command", "velocity", "force")  # beyond these inputs' ranges a table does not fade
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
            ranges[name] = covered(values)
            margins[name] = _margin(column.role, ranges[name])
    return Validity(ranges=ranges, margins=margins)


def _margin(role: str, ends: tuple[float, float]) -> float:
    return max(MARGIN * (ends[1] - ends[0]), MIN_MARGIN.get(role, 1e-6))


def extended(validity: Validity, earlier: Mapping[str, tuple[float, float]], recording: Recording) -> Validity:
    """The box extended to the ranges of an earlier model of the machine; `seen` keeps the range of the rows themselves.

    Raises MissingColumn if `earlier` names a column that is not in the recording.
    """
    columns = recording.manifest.columns
    for name in earlier:
        if name not in columns:
            raise MissingColumn(f"also_valid: the recording has no column {name}.{did_you_mean(name, columns)}")
    wider = {
        n: (min(low, earlier[n][0]), max(high, earlier[n][1]))
        for n, (low, high) in validity.ranges.items()
        if n in earlier
    }
    wider = {n: ends for n, ends in wider.items() if ends != validity.ranges[n]}
    return validity.model_copy(
        update={
            "ranges": validity.ranges | wider,
            "seen": {n: validity.ranges[n] for n in wider},
            "margins": validity.margins | {n: _margin(columns[n].role, ends) for n, ends in wider.items()},
        }
    )


def as_in_a_table(recording: Recording, validity: Validity) -> tuple[Recording, np.ndarray]:
    """The recording with the faded inputs clipped to their ranges, and the remaining share of the correction, (rows,).

    As in the steady state of a table; a missing reading leaves all.
    """
    held, left = {}, np.ones(len(recording))
    for name, (low, high) in fading(validity, recording).items():
        values = recording.array(name)
        held[name] = np.clip(values, low, high)
        margin = validity.margins.get(name) or MARGIN * max(high - low, 1e-3)
        left = np.fmin(left, 1.0 - np.abs(values - held[name]) / margin)
    return recording.with_columns(held, {}), np.maximum(left, 0.0)


def fading(validity: Validity, recording: Recording) -> dict[str, tuple[float, float]]:
    """The ranges beyond which a table fades: not those of positions, at whose ends it holds its profiles."""
    columns = recording.manifest.columns
    kept = (n for n in validity.ranges if n in columns and columns[n].role not in HELD_AT_THE_END)
    return {n: validity.ranges[n] for n in kept} if validity.fades else {}


def covered(values: np.ndarray) -> tuple[float, float]:
    """Ends of the range of finite values, without few rows beyond a gap; shape (n,), any order."""
    ordered = np.sort(values)
    few = int(FEW * ordered.size)
    lowest, highest = ordered[: few + 1], -ordered[::-1][: few + 1]
    low, high = float(lowest[_beyond_gap(lowest, -highest[-1])]), -float(highest[_beyond_gap(highest, -lowest[-1])])
    return low, high


def _beyond_gap(lowest: np.ndarray, top: float) -> int:
    """Number of the lowest values that are beyond a gap; at most all but the last. top: highest of the other rows."""
    above = lowest[1:]
    gaps = above - lowest[:-1] > GAP * np.maximum(top - above, 1e-300)
    return int(np.flatnonzero(gaps)[-1]) + 1 if gaps.any() else 0


def few_rows_outside(recording: Recording, validity: Validity, rows: np.ndarray) -> list[str]:
    """A sentence per column on rows of the fit outside the box: they influence the fit and do not widen the box."""
    notes = []
    for name, (low, high) in validity.ranges.items():
        values = recording.array(name)[rows]
        outside = values[(values < low) | (values > high)]
        if outside.size:
            unit = recording.manifest.columns[name].unit or ""
            share = _leverage(values, outside)
            notes.append(
                f"{name}: {outside.size} of {int(np.isfinite(values).sum())} rows ({outside.min():.4g} to "
                f"{outside.max():.4g} {unit}) are beyond a gap; the model is not valid there ({low:.4g} to {high:.4g} "
                f"{unit}), and these rows have {100 * share:.0f} % of the leverage on a slope over {name}"
            )
    return notes


def _leverage(values: np.ndarray, few: np.ndarray) -> float:
    """Share of a few of the values in the sum of squared distances from the mean, 0..1."""
    mean = float(np.nanmean(values))
    return float(np.sum((few - mean) ** 2) / max(float(np.nansum((values - mean) ** 2)), 1e-300))


def distance(validity: Validity, recording: Recording) -> np.ndarray:
    """Distance of each row outside the box, shape (rows,): 0 inside, else summed over columns in range widths.

    A missing value counts as a whole range outside.
    """
    total = np.zeros(len(recording))
    for name, (low, high) in (validity.ranges | validity.seen).items():
        width = max(high - low, validity.margins.get(name, 0.0), 1e-12)
        values = recording.array(name) if name in recording else np.full(len(recording), np.nan)
        excess = np.maximum(np.maximum(low - values, values - high), 0.0) / width
        total += np.where(np.isnan(values), 1.0, excess)
    return total
