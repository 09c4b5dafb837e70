"""Runs in which deviations and inputs were logged by clocks that differ: daylight saving time, a clock never set.

A held-out prediction is shifted in time until it fits the deviations of its run best. A model that is late is late in
all runs, so each is compared with the shift that is best for all. Chosen on three simulated machines (ISO 230-3 tests
of 8 to 12 h): a shift is worth 11 % of the residual of a sound run at most, and half of that of a run an hour off.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.judging import HeldOut

LONGEST, STEP = 7200.0, 300.0  # s: two hours, as of two time zones; a drift shows no less than some minutes
SMALLEST = 1200.0  # s, against the shift that is best for all runs: clocks set by hand differ by less
WORTH = 0.6  # of the residual without a shift: the most that is left
EXPLAINED = 0.6  # of the deviation's scatter: the most that is left of half of the runs; a useless model fits by chance
SURE = 0.1  # of the residual: with more left, the model was fitted to several runs with wrong clocks, and is between
MOST = 0.75  # of the runs that a shift must suit to be the model's own; clocks that differ suit some and not others
MIN_ROWS = 30  # judged rows of a run, at least as far from its ends as the longest shift
SHIFTS = np.arange(-LONGEST, LONGEST + STEP, STEP)


def shifted_runs(recording: Recording, folds: Sequence[HeldOut]) -> list[dict[str, Any]]:
    """Runs whose inputs are shifted against their deviations: run, shift in s (positive: inputs late), share left.

    Empty for deviations over a position, without times, and for a single run.
    """
    if recording.names("position") or recording.names("command") or recording.name("time") is None:
        return []
    t, run = recording.time(), recording.run_codes()
    curves = [
        (recording.run_labels()[code], curve)
        for fold in folds
        for code in np.unique(run[fold.rows])
        if (curve := _scatter_left(t, fold, np.flatnonzero(run[fold.rows] == code))) is not None
    ]
    if len(curves) < 2 or np.median([curve.min() for _, curve in curves]) > EXPLAINED:
        return []
    left = np.array([curve for _, curve in curves])
    none, usual = SHIFTS.size // 2, int(np.argmin(np.sum(np.log(left), axis=0)))
    if np.mean(left[:, usual] <= left[:, none]) < MOST:
        usual = none
    found = []
    for label, curve in curves:
        k, share = int(np.argmin(curve)), float(curve.min() / min(curve[usual], curve[none]))
        if share < WORTH and abs(SHIFTS[k] - SHIFTS[usual]) >= SMALLEST and 0 < k < SHIFTS.size - 1:
            found.append({"run": label, "shift": float(SHIFTS[k] - SHIFTS[usual]), "left": share})
    return found


def _scatter_left(t: np.ndarray, fold: HeldOut, own: np.ndarray) -> np.ndarray | None:
    """Scatter that a shifted prediction leaves of one run, share of the deviation's, (shifts,); None if too short."""
    own = own[np.argsort(t[fold.rows[own]], kind="stable")]
    at, y = t[fold.rows[own]], fold.before[own]
    inner = (at >= at[0] + LONGEST) & (at <= at[-1] - LONGEST)
    if inner.sum() < MIN_ROWS:
        return None
    predicted = y - fold.after[own]
    left = np.array([np.std(y[inner] - np.interp(at[inner] + shift, at, predicted)) for shift in SHIFTS])
    return (left + 1e-9) / (np.std(y[inner]) + 1e-9)  # 1e-9 um: a run of simulated rows may be without any


def in_words(figures: Mapping[str, Any], before: str = "") -> str:
    """What was found in a component (its figures of `validation.json`), and what to do; "" if there is nothing."""
    found = figures.get("clocks", ())
    runs = (
        f"{c['run']} by {'about ' * (c['left'] > SURE)}{abs(c['shift']) / 60:.0f} min (times of the inputs too "
        f"{'late' if c['shift'] > 0 else 'early'}, or of the deviations too {'early' if c['shift'] > 0 else 'late'}; "
        f"shifted, {100 * c['left']:.0f} % of the residual are left)"
        for c in found
    )
    groups = "; one of these two groups is right" if len({c["shift"] > 0 for c in found}) > 1 else ""
    words = (
        f"{before}{figures['component']}: deviations and inputs were logged by clocks that differ, against the other "
        f"runs: {', '.join(runs)}{groups}. Daylight saving time? Shift the times of the wrong files, and import again"
    )
    return words if found else ""
