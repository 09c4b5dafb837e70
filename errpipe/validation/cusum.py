"""Two-sided cumulative sums (CUSUM, Page 1954) of a figure per run, with a threshold for a stated false-alarm rate."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

REFERENCE = 1.0  # standard errors: half of the shift to be detected fastest (Page 1954)
FALSE_ALARMS = 0.02  # share of years without drift with an alarm, any sensor, normal noise; measured: docs/trials.md
HORIZON = 365  # runs for which that is valid: a year of nights
SIMULATED = 4000  # simulated years without drift per threshold
MIN_THRESHOLD = 5.0  # standard errors; with less, one outlying run would be an alarm
MIN_REFERENCE_RUNS = 4  # reference runs needed to estimate the scatter between runs


@lru_cache
def threshold(freedom: int, share: float) -> float:
    """Threshold of the CUSUM, standard errors: exceeded in a stated share of the years of runs without drift.

    freedom: degrees of freedom of the standard deviation by which residuals are divided.
    """
    rng = np.random.default_rng(1)
    freedom = max(freedom, 1)
    sd = np.sqrt(rng.chisquare(freedom, SIMULATED) / freedom)
    most, totals = np.zeros(SIMULATED), np.zeros((2, SIMULATED))
    for _ in range(HORIZON):
        z = rng.standard_normal(SIMULATED) / sd
        totals = np.maximum(0.0, totals + np.stack([z, -z]) - REFERENCE)
        most = np.maximum(most, totals.max(axis=0))
    return max(float(np.quantile(most, 1.0 - share)), MIN_THRESHOLD)


def cusum(z: np.ndarray) -> tuple[float, int]:
    """Largest two-sided cumulative sum of standardised values, and the start of the excursion that reached it."""
    best, begin = 0.0, 0
    for sign in (1.0, -1.0):
        total, start = 0.0, 0
        for i, value in enumerate(sign * np.asarray(z)):
            if total == 0.0:
                start = i
            total = max(0.0, total + value - REFERENCE)
            if total > best:
                best, begin = total, start
    return float(best), begin


def level_drift(old: Sequence[float], new: Sequence[float]) -> tuple[float, int] | None:
    """CUSUM of a figure per run with a constant level, such as a champion's mean residual, and the start of the drift.

    None below its threshold, or with too few reference runs.
    """
    count = len(old)
    if count < MIN_REFERENCE_RUNS or not len(new):
        return None
    scale = max(float(np.std(old, ddof=1)), 1e-9)
    values = np.array([*old, *new], dtype=float)
    seen = np.arange(count, values.size)  # runs before each new one, whose mean is its reference
    before = np.cumsum(values)[count - 1 : -1] / seen
    alarm, begin = cusum((values[count:] - before) / (scale * np.sqrt(1.0 + 1.0 / seen)))
    found = alarm >= MIN_THRESHOLD and alarm >= threshold(count - 1, FALSE_ALARMS)  # simulated only where it decides
    return (alarm, begin) if found else None
