"""Arithmetic of the season model: zeros of runs, groups, ridge on triangles, conformal widths."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.between_readings import rows_between
from errpipe.errors import DataError
from errpipe.fitting.design import response_name
from errpipe.fitting.solve import one_thread
from errpipe.fitting.statistics import normal_quantile, student_quantile
from errpipe.fitting.validity import LONGEST_HELD

# A prediction starts at zero in a run's first row, its deviation counts from the mean of the first few rows, and the
# residual may count from either. Half-way is best: 3.5 um on held-out runs of a turning centre with both datums;
# 3.3 and 4.0 or 4.3 and 3.3 at the ends.
DATUM_SHARE = 0.5
BLOCKS = 5  # inner groups of a run if there are fewer than `FEWEST_RUNS`
FEWEST_RUNS = 3  # for leave-one-run-out
# Limit of the sum, as share of the span of deviations beyond the largest of them. 0.25 to 1 are equal on seeds 1 to 3
# of trials.thermal; a turning centre's winter, fitted on spring, has 7.1 um with 0.25 and 6.9 with 0.5 and more.
SPAN_BEYOND = 0.5
MOST_FITTED = 0.8  # of the measured rows: with fewer, the fit reports it (by judgement)
MUCH_BY_PLACE = 0.3  # of the squared residual explained by a straight line over position, from which it is reported
FEWEST_PASSES = (
    4  # of a run through the middle of its places; with fewer a drift looks like a profile (both by judgement)
)
# Roles that a thermal model reads. In a merged log of several devices each is empty in the rows of the others.
READ_BY_A_TABLE = ("temperature", "spindle_speed", "coolant")
SEEN_BEYOND = 0.25  # of the span; with more a failed sensor cost over 1.3 of healthy on a turning centre


def since_start(values: np.ndarray, run: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Values minus the mean of each run's first `rows` finite rows, and that mean; shapes (n,), (n,)."""
    zero = np.full(values.size, np.nan)
    for code in np.unique(run):
        own_rows = np.flatnonzero(run == code)
        finite = own_rows[np.isfinite(values[own_rows])][:rows]
        zero[own_rows] = values[finite].mean() if finite.size else np.nan
    return values - zero, zero


def held_readings(recording: Recording) -> Recording:
    """The recording as a prediction reads it: every run separately, short gaps of temperatures filled from before.

    If runs follow each other within minutes, heat of the previous run must not enter a fit: `predict` restarts with
    each run, and a fit that used more history had a larger residual there than in validation.
    """
    return short_gaps_held(recording.each_run_alone())


def short_gaps_held(
    recording: Recording, names: Iterable[str] | None = None, longest: int | None = LONGEST_HELD
) -> Recording:
    """The recording with inputs (default: `READ_BY_A_TABLE`) as a controller has them: held between readings.

    Readings missing at the start of a run take its first one. Gaps of more than `longest` readings, at the rate at
    which the sensor is logged, stay empty (None: no gap does).
    """
    held = {}
    for name in [n for role in READ_BY_A_TABLE for n in recording.names(role)] if names is None else names:
        values = recording.frame[name]
        if values.count() in (0, len(values)):
            continue
        limit = None if longest is None else longest * rows_between(values.to_numpy(dtype=float))
        runs = values.groupby(recording.run_codes())
        held[name] = runs.ffill(limit=limit).where(runs.ffill().notna(), runs.bfill(limit=limit)).to_numpy()
    return recording.with_columns(held, {}) if held else recording


def sampled_less_often(recording: Recording, names: Iterable[str]) -> list[str]:
    """Those sensors with a reading in at most every second row."""
    return [n for n in names if rows_between(recording.array(n)) > 1]


def longest_silence(recording: Recording, names: Iterable[str]) -> dict[str, float]:
    """Sensor sampled less often than the rows -> time in s after which it counts as failed; empty without times.

    LONGEST_HELD times the usual time between two of its readings.
    """
    if recording.name("time") is None:
        return {}
    time, names = recording.time(), sampled_less_often(recording, names)
    steps = {n: np.diff(time[np.isfinite(recording.array(n))]) for n in names}
    return {name: LONGEST_HELD * float(np.nanmedian(step)) for name, step in steps.items()}


def no_usable_row(recording: Recording, component: str) -> DataError:
    """The error to raise if no row can be fitted: names the temperature with most gaps."""
    return DataError(
        f"thermal model of {component}: no row has a deviation and all temperatures without a long gap since "
        f"the start of its run ({_sensor_with_most_gaps(recording)})"
    )


def failed_sensors(recording: Recording, component: str) -> list[str]:
    """Temperatures without a reading at the end of the recording, from before most deviations; none if all have failed.

    The machine to be compensated no longer has them, and a fit with them would lack the later rows.
    """
    measured = np.flatnonzero(np.isfinite(recording.array(response_name(recording, component))))
    names = recording.names("temperature")
    known = {n: np.isfinite(recording.array(n)[measured]) for n in names}
    dead = [n for n in names if measured.size and not known[n][-1] and known[n].mean() < MOST_FITTED]
    return dead if len(dead) < len(names) else []


def working_sensors(recording: Recording, component: str) -> Recording:
    """The recording, with readings held, without failed temperatures (`failed_sensors`)."""
    recording = held_readings(recording)
    dead = failed_sensors(recording, component)
    return replace(recording, frame=recording.frame.drop(columns=dead)) if dead else recording


def all_known(recording: Recording) -> np.ndarray:
    """Mask of the rows on which every temperature has a value, (rows,)."""
    return np.isfinite(sum((recording.array(n) for n in recording.names("temperature")), np.zeros(len(recording))))


def few_rows_fitted(recording: Recording, component: str, fitted: int) -> str:
    """A note if a sensor has failed, if many measured rows lack a temperature, or all rows of a run; else ''.

    recording: with short gaps filled (`held_readings`).
    """
    if dead := failed_sensors(recording, component):
        return f"; without {', '.join(dead)}, without readings at the end of the recording"
    measured = np.isfinite(recording.array(response_name(recording, component)))
    rows = int(measured.sum())
    if fitted > MOST_FITTED * rows:
        run, known = recording.run_codes(), all_known(recording)
        empty = [recording.run_labels()[k] for k in np.unique(run[measured]) if not known[measured & (run == k)].any()]
        return f"; without {', '.join(empty)} ({_sensor_with_most_gaps(recording)})" if empty else ""
    return f"; fitted to {fitted} of {rows} rows, the others lack a temperature ({_sensor_with_most_gaps(recording)})"


def changes_with_place(recording: Recording, left: np.ndarray) -> str:
    """A note if a straight line over a position, per run, explains much of the residual (um, (rows,)); else ''."""
    run = recording.run_codes()
    for name in recording.names("position"):
        place, before, after = recording.array(name), 0.0, 0.0
        known = np.isfinite(left) & np.isfinite(place)
        for code in np.unique(run[known]):
            x, y = (values[known & (run == code)] for values in (place, left))
            if np.count_nonzero(np.diff(x > x.mean())) >= FEWEST_PASSES:  # else position and time are collinear
                before += float(np.sum((y - y.mean()) ** 2))
                after += float(np.sum((y - np.polyval(np.polyfit(x, y, 1), x)) ** 2))
        if before - after > MUCH_BY_PLACE * before:
            return (
                f"; {100 * (1 - after / before):.0f} % of the residual is a straight line over {name} in each run: a "
                "thermal family is the same at every place, fit terms over position instead"
            )
    return ""


def _sensor_with_most_gaps(recording: Recording) -> str:
    empty = recording.frame[list(recording.names("temperature"))].isna().sum()
    name = empty.idxmax()
    return f"most gaps: {name}, no reading in {empty.max()} of {len(recording)} rows; `role: ignore` excludes it"


def since_start_of(recording: Recording, component: str, rows: int = 1) -> np.ndarray:
    """Deviation of a component since the start of each run (mean of its first `rows` rows), um, shape (rows,)."""
    return since_start(recording.array(response_name(recording, component)), recording.run_codes(), rows)[0]


def conformal_half_width(
    error: np.ndarray, group: np.ndarray, coverage: float, run_count: int | None = None, raised: bool = True
) -> float:
    """Half width that covers a row of a new group: group-balanced quantile of |error|, with finite-group correction.

    Each group counts once regardless of its length; the level is raised by (groups + 1) / groups, as for
    exchangeable groups (split conformal prediction over groups), but by at most half of the remaining probability:
    with few groups the full level would be the worst row ever recorded. For the small sample
    the width is multiplied by the ratio of Student's quantile to the normal one.
    raised: whether level and width are raised; if not, the stated coverage is met on average instead of guaranteed.
    run_count: independent groups if fewer than the labels (blocks of one run count once).
    """
    labels = np.unique(group)
    order = np.argsort(error)
    weight = np.zeros(error.size)
    for label in labels:
        own_rows = group == label
        weight[own_rows] = 1.0 / np.count_nonzero(own_rows)
    reached = np.cumsum(weight[order]) / labels.size
    upper, level, few = (1.0 + coverage) / 2, coverage, 1.0
    if raised:
        level = min(upper, coverage * (labels.size + 1) / labels.size)
        freedom = max((labels.size if run_count is None else run_count) - 1, 1)
        few = student_quantile(upper, freedom) / normal_quantile(upper)
    return few * float(error[order][min(int(np.searchsorted(reached, level - 1e-12)), error.size - 1)])


def centred(
    columns: np.ndarray, run: np.ndarray, rows: int, measured: np.ndarray, share: float = DATUM_SHARE
) -> np.ndarray:
    """Columns (n, p) minus a share of the mean of each run's first `rows` measured rows (see `DATUM_SHARE`).

    measured: whether a row has a deviation, (n,): temperatures are often sampled faster, and both count from the same
    rows.
    """
    out = columns.copy()
    for code in np.unique(run):
        own_rows = np.flatnonzero(run == code)
        datum = own_rows[measured[own_rows]][:rows]
        out[own_rows] -= share * columns[datum if datum.size else own_rows[:rows]].mean(axis=0)
    return out


def predicted_since_start(values: np.ndarray, run: np.ndarray, rows: int, measured: np.ndarray) -> np.ndarray:
    """Predictions minus their mean in each run's first `rows` measured rows, as `since_start` of deviations, (n,)."""
    return values - since_start(np.where(measured, values, np.nan), run, rows)[1]


def inner_groups(run: np.ndarray, rows: np.ndarray, blocks: int = BLOCKS) -> np.ndarray:
    """Runs, or blocks of time within them if there are fewer than three."""
    if np.unique(run[rows]).size >= FEWEST_RUNS:
        return run.copy()
    group = run * blocks
    for code in np.unique(run[rows]):
        own_rows = np.flatnonzero(rows & (run == code))
        group[own_rows] += np.arange(own_rows.size) * blocks // own_rows.size
    return group


def ridge_gains(
    triangle: np.ndarray, response: np.ndarray, rows: float, strength: float, scale: np.ndarray | None = None
) -> np.ndarray:
    """Ridge gains, (p,), from a triangle (k, p) that represents `rows` rows.

    strength: 1, for columns of unit root mean square; `scale`: theirs (default: that of the triangle).
    """
    if triangle.shape[1] == 0:
        return np.empty(0)
    size = np.sqrt(np.sum(triangle**2, axis=0) / rows) if scale is None else scale
    size = np.where(size > 0, size, 1.0)
    system = np.vstack([triangle / size, np.sqrt(strength * rows) * np.eye(size.size)])
    with one_thread():
        scaled_gains = np.linalg.lstsq(system, np.r_[response, np.zeros(size.size)], rcond=None)[0]
    return scaled_gains / size


def slope(y: np.ndarray, x: np.ndarray, rows: np.ndarray, low: float = 0.0, high: float = 1.0) -> float:
    """Least-squares slope of y on x, clipped to low..high; 0 if x is constant."""
    below = float(np.sum(x[rows] ** 2))
    return float(np.clip(np.sum(x[rows] * y[rows]) / below, low, high)) if below > 0 else 0.0


def limits(y: np.ndarray, seen_only: bool = False) -> tuple[float, float]:
    """Lowest and highest deviation that may be predicted, um: gains fitted on warming are valid for equal cooling.

    A gantry frame's first block, fitted on cooling days only: residual 7.8 um, 24 with a limit that follows the sign.
    seen_only: the range of deviations and SEEN_BEYOND of its span instead; zero is always inside.
    """
    low, high = min(float(y.min()), 0.0), max(float(y.max()), 0.0)
    if seen_only:
        return low - SEEN_BEYOND * (high - low), high + SEEN_BEYOND * (high - low)
    reach = float(np.abs(y).max()) + SPAN_BEYOND * (high - low)
    return -reach, reach
