"""Readings of healthy sensors, and what is asked of them: lags, estimates of each from the others, rare extremes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions

SHIFT = 36000.0  # s: estimates are learnt from what changes within one
LAGS = (300.0, 900.0, 3600.0, 14400.0)  # s: heat reaches one sensor later than another, some much later
BLOCK = 7200.0  # s: largest values are taken per two hours, beyond which residuals know little of each other
LIGHTEST = 0.25  # shape of the law of largest values: lighter is not believed of few hours


@dataclass(frozen=True)
class Healthy:
    """Readings of healthy sensors, shape (rows, sensors), and how they are to be looked at."""

    x: np.ndarray
    run: np.ndarray
    t: np.ndarray
    group: np.ndarray
    filter_s: float
    horizon_s: float

    @cached_property
    def stacked(self) -> np.ndarray:
        """Rises since the start of the run and their lags, shape (rows, 1 + lags, sensors)."""
        rise = rises(self.x, self.run)
        return np.stack([rise, *(self.lagged(rise, tau) for tau in LAGS)], axis=1)

    def lagged(self, values: np.ndarray, tau: float) -> np.ndarray:
        """Columns through a first-order lag, tau in s; shape as values."""
        return lagged(values, self.run, self.t, tau)

    def recent(self, values: np.ndarray) -> np.ndarray:
        """Columns less what they were a horizon ago, through a lag; shape as values."""
        return values - self.lagged(values, self.horizon_s)


def rows_of(
    recording: Recording, names: tuple[str, ...], group: str | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Readings, sessions, times and groups of the rows in which every sensor has a reading."""
    x = np.column_stack([recording.array(n) for n in names]) if names else np.zeros((len(recording), 0))
    whole = np.isfinite(x).all(axis=1)
    labels = recording.run_codes() if group is None else np.unique(recording.frame[group], return_inverse=True)[1]
    return x[whole], sessions(recording)[whole], recording.time()[whole], labels[whole]


def rises(x: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Readings less the first of their run, shape as x."""
    first = np.r_[True, run[1:] != run[:-1]]
    start = np.maximum.accumulate(np.where(first, np.arange(run.size), 0))
    return x - x[start]


def lagged(values: np.ndarray, run: np.ndarray, t: np.ndarray, tau: float) -> np.ndarray:
    """Columns through a first-order lag that starts anew with each run, tau in s; shape (rows, columns)."""
    from errpipe.kernels import responses

    return np.column_stack([responses.lag(run, t, np.ascontiguousarray(v), tau, tau, True) for v in values.T])


def centred(values: np.ndarray, run: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Values less their mean over every shift of a run."""
    out = values.copy()
    for rows in _spans(run, t, SHIFT):
        out[rows] -= values[rows].mean(axis=0)
    return out


def _spans(run: np.ndarray, t: np.ndarray, length: float) -> list[np.ndarray]:
    """Rows of each stretch of time within each run."""
    first = np.r_[True, run[1:] != run[:-1]]
    since = t - t[np.maximum.accumulate(np.where(first, np.arange(run.size), 0))]
    key = run * 100_000 + (since // length).astype(int)
    order = np.argsort(key, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(key[order])) + 1)


def ridge_weights(values: np.ndarray, ridge: float) -> np.ndarray:
    """Ridge regression of each sensor on all others and their lags; 0 on itself.

    values: shape (rows, 1 + lags, sensors), the readings themselves first. Result (sensors, 1 + lags, sensors).
    """
    rows, kinds, count = values.shape
    flat = values.reshape(rows, kinds * count)
    square = flat.T @ flat / rows
    square[np.diag_indices_from(square)] += ridge * np.mean(np.diag(square)[:count])
    out = np.zeros((count, kinds, count))
    for i in range(count):
        free = np.flatnonzero(np.arange(kinds * count) % count != i)
        out[i].reshape(-1)[free] = np.linalg.solve(square[np.ix_(free, free)], square[free, i])
    return out


def left_out(values: np.ndarray, learnt_from: np.ndarray, group: np.ndarray, ridge: float) -> np.ndarray:
    """Departure of every row from its estimate, weights learnt without its group; shape (rows, sensors)."""
    out = values[:, 0].copy()
    for label in np.unique(group):
        inside = group == label
        weights = ridge_weights(learnt_from[~inside], ridge)
        out[inside] -= np.einsum("rkj,ikj->ri", values[inside], weights)
    return out


def seldom(values: np.ndarray, run: np.ndarray, t: np.ndarray, per_hour: float, lightest: float = LIGHTEST) -> float:
    """The level that values exceed `per_hour` times an hour; no less than the largest value seen.

    Generalised extreme-value law with a tail between Gumbel's and one that ends (shape 0 to `lightest`).
    """
    largest = np.sort(_blocks(values, run, t))
    rank = np.arange(largest.size)
    l1 = largest.mean()
    b1 = np.mean(largest * rank) / (largest.size - 1)
    b2 = np.mean(largest * rank * (rank - 1)) / ((largest.size - 1) * (largest.size - 2))
    l2, l3 = 2 * b1 - l1, 6 * b2 - 6 * b1 + l1
    if l2 <= 0:
        return float(largest[-1])
    c = 2 / (3 + l3 / l2) - np.log(2) / np.log(3)
    k = float(np.clip(7.8590 * c + 2.9554 * c**2, 1e-6, lightest))
    scale = l2 * k / ((1 - 2**-k) * math.gamma(1 + k))
    place = l1 - scale * (1 - math.gamma(1 + k)) / k
    level = place + scale * (1 - (-math.log1p(-per_hour * BLOCK / 3600)) ** k) / k
    return float(max(level, largest[-1]))


def _blocks(values: np.ndarray, run: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Largest value of each block of time."""
    first = np.r_[True, run[1:] != run[:-1]]
    since = t - t[np.maximum.accumulate(np.where(first, np.arange(run.size), 0))]
    key = run * 100_000 + (since // BLOCK).astype(int)
    return np.array([values[key == k].max() for k in np.unique(key)])
