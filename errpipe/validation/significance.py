"""Whether a correction is better than none by more than chance: a paired test over runs, never over rows.

Rows of one run share their thermal state and their noise, so they are one observation, not hundreds. Two paired tests
over runs are made, and the smaller p is doubled (Bonferroni): Student's t of the difference of the mean squares, and
of the logarithm of their ratio, which is the more powerful one where few runs agree.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.judging import HeldOut
from errpipe.fitting.quantiles import student_tail

# Largest p of an exported correction. Chosen on: random offsets by run, 3,000 draws for each of 3 to 20 runs, of which
# the mean offset is exported in 0.1 to 1.3 %; at 0.05 it is up to 3.3 %.
LEVEL = 0.02
QUIET = 0.1  # of the rms over all runs, added to both sides of the ratio: runs below it hardly count there
MIN_RUNS = 2  # runs; one alone says nothing about the next


def p_value(recording: Recording, folds: Sequence[HeldOut], gain: float) -> float:
    """Probability that chance alone makes the correction at this gain look as good on the held-out runs; 0..1."""
    before, after = _mean_squares(recording, folds, gain)
    if before.size < MIN_RUNS:
        return 1.0
    floor = (QUIET**2) * float(before.mean()) + 1e-30
    ratio = np.log((before + floor) / (after + floor))
    return min(1.0, 2.0 * min(_one_sided(ratio), _one_sided(before - after)))


def independent_runs(recording: Recording, folds: Sequence[HeldOut]) -> int:
    """How many observations the test has."""
    return int(np.unique(_units(recording, folds)).size)


def _one_sided(gained: np.ndarray) -> float:
    """One-sided p-value of a mean above zero, by Student's t."""
    spread = float(gained.std(ddof=1))
    mean = float(gained.mean())
    if spread <= 1e-12 * max(abs(mean), 1e-300):
        return 0.0 if mean > 0 else 1.0
    return student_tail(mean / (spread / np.sqrt(gained.size)), gained.size - 1)


def _mean_squares(recording: Recording, folds: Sequence[HeldOut], gain: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean squares of every independent run without and with the correction, shape (runs,)."""
    unit = _units(recording, folds)
    before = np.concatenate([f.before for f in folds])
    after = (1.0 - gain) * before + gain * np.concatenate([f.after for f in folds])
    number = np.unique(unit, return_inverse=True)[1]
    count = np.bincount(number)
    return np.bincount(number, before**2) / count, np.bincount(number, after**2) / count


def _units(recording: Recording, folds: Sequence[HeldOut]) -> np.ndarray:
    """Number of the observation that each held-out row belongs to: its run, or its fold where folds divide runs."""
    run = np.concatenate([recording.run_codes()[f.rows] for f in folds])
    fold = np.repeat(np.arange(len(folds)), [f.rows.size for f in folds])
    divided = any(np.unique(fold[run == code]).size > 1 for code in np.unique(run))
    return fold if divided else run
