"""Significance of a correction against none: a paired test over runs, never over rows.

Rows of one run share their thermal state and their noise, so they are one observation, not hundreds. Two paired tests
over runs are made, and the smaller p is doubled (Bonferroni): Student's t of the difference of the mean squares, and
of the logarithm of their ratio, which is more powerful with few consistent runs.

For one run (or two) only halves predict each other, and neighbouring rows of both series are correlated: two
independent drifts correlate by chance. So their correlation is tested with the effective number of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.fitting.judging import HeldOut
from errpipe.fitting.statistics import chi2_tail, student_tail

# Largest p of an exported correction. Chosen on: random offsets by run, 3,000 draws for each of 3 to 20 runs, whose
# mean offset is exported in 0.1 to 1.3 %; at 0.05 it is up to 3.3 %.
LEVEL = 0.02
SMALL_SHARE = 0.1  # of the rms over all runs, added to both sides of the ratio: runs below it have little weight
MIN_RUNS = 2  # runs; one alone does not predict the next
# Largest share of the rms that a correction shown by two runs may leave. Two runs that predict each other are one
# observation (the inner product of both curves is the same either way): their spread shows little. Chosen on 600 pairs
# of independent runs with 1, 3 and 8 free shapes (seed 7): without it 4, 9 and 9 % are exported, with it 3, 1 and 0 %.
PAIR_LEFT = 0.6
# Largest p from halves. Chosen on single days (seed 901: 36 of `trials.thermal`, 60 of machines by formulas, 36 with a
# drifting deviation or an unmeasured heat source): 1e-4 exports 84 and makes two later ones worse; 2e-4 seven.
HALVES_LEVEL = 1e-4
# Largest p from halves, and residual share of blocks predicted by all others of the run, of a correction that is
# exported although halves alone are inconclusive: a day of steady warming is worth three rows. Chosen on 62 single days
# of machines (formulas and `trials.thermal`, seed 41001): four that help have 0.04 to 0.21, five that harm 0.3 to 1.0.
HALVES_LIKELY, INSIDE = 1e-2, 0.12
UNLIKE = 0.05  # product of autocorrelations below which rows are independent
MIN_DEGREES = 0.5  # of freedom of a correlation, however few rows the series are worth


def p_value(recording: Recording, folds: Sequence[HeldOut], gain: float) -> float:
    """Probability that the correction at this gain looks as good on the held-out runs by chance; 0..1."""
    before, after = _mean_squares(recording, folds, gain)
    if before.size < MIN_RUNS or (before.size == MIN_RUNS and after.sum() > PAIR_LEFT**2 * before.sum()):
        return 1.0
    floor = (SMALL_SHARE**2) * float(before.mean()) + 1e-30
    ratio = np.log((before + floor) / (after + floor))
    return min(1.0, 2.0 * min(_one_sided(ratio), _one_sided(before - after)))


def p_between_halves(folds: Sequence[HeldOut], gain: float) -> tuple[float, int]:
    """p of a correction at a gain on halves of one run that predict each other, and the effective number of rows.

    Prediction and deviation are correlated after removing their mean over the run (drift) and per half (shape), with
    the effective number of rows of two autocorrelated series (Quenouille 1952; Bretherton et al. 1999, J. Climate 12,
    1990), and both one-sided p combined by Fisher's method. The zero of a run is the mean of a few readings: its error
    is in both halves and would predict itself. folds: blocks of the first half, then as many of the second.
    """
    halves = folds[: len(folds) // 2], folds[len(folds) // 2 :]
    before = [np.concatenate([f.before for f in half]) for half in halves]
    after = [np.concatenate([f.after for f in half]) for half in halves]
    predicted = [gain * (b - a) for b, a in zip(before, after, strict=True)]
    whole = ([x - np.concatenate(series).mean() for x in series] for series in (predicted, before))
    drift, worth = _correlated(*whole)
    shape, _ = _correlated(*([x - x.mean() for x in series] for series in (predicted, before)))
    return chi2_tail(-2.0 * float(np.log(drift) + np.log(shape)), 4), int(worth)


def helps_between_halves(p: float, left_inside: Callable[[], float]) -> bool:
    """Whether a correction validated on halves of one run is exported. p: of `p_between_halves`; left_inside: residual
    share of blocks that all others of the run predict, 1; called if p is inconclusive.
    """
    return p <= HALVES_LEVEL or (p <= HALVES_LIKELY and left_inside() <= INSIDE)


def _correlated(one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> tuple[float, float]:
    """One-sided p of a positive correlation of two series in stretches, and their effective number of rows."""
    size = np.sqrt(sum(float(x @ x) for x in one) * sum(float(y @ y) for y in other))
    worth = sum(_effective_rows(x, y) for x, y in zip(one, other, strict=True))
    if size == 0.0:
        return 1.0, worth
    correlation = min(sum(float(x @ y) for x, y in zip(one, other, strict=True)) / size, 1.0 - 1e-9)
    degrees = max(worth - 2.0, MIN_DEGREES)
    p = student_tail(correlation * np.sqrt(degrees / (1.0 - correlation**2)), degrees)
    return max(p, 1e-300), worth


def _effective_rows(one: np.ndarray, other: np.ndarray) -> float:
    """Effective number of independent rows of two series of a stretch for their correlation."""
    alike = _autocorrelation(one) * _autocorrelation(other)
    unlike = np.flatnonzero(alike < UNLIKE)
    return float(one.size / (1.0 + 2.0 * alike[1 : unlike[0] if unlike.size else alike.size].sum()))


def _autocorrelation(values: np.ndarray) -> np.ndarray:
    """At lags of 0 rows and more, about zero, (rows,); 0 of a series that is zero."""
    padded = np.fft.rfft(values, 2 * values.size)
    products = np.fft.irfft(np.abs(padded) ** 2)[: values.size]
    return products / products[0] if products[0] > 0.0 else np.zeros(values.size)


def independent_runs(recording: Recording, folds: Sequence[HeldOut]) -> int:
    """Number of observations of the test."""
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
    """Number of the observation of each held-out row: its run, or its fold if folds divide runs."""
    run = np.concatenate([recording.run_codes()[f.rows] for f in folds])
    fold = np.repeat(np.arange(len(folds)), [f.rows.size for f in folds])
    divided = any(np.unique(fold[run == code]).size > 1 for code in np.unique(run))
    return fold if divided else run
