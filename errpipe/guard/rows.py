"""Readings of healthy sensors and quantities derived from them: rises, lags, changes within a shift, rare extremes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions

SHIFT_S = 36000.0  # estimates are learnt from changes within one shift of ten hours
BLOCK_S = 7200.0  # block length for largest values, beyond which residuals hardly correlate (turning centre)
MAX_SHAPE = 0.25  # of the extreme-value law: a shorter tail is not used if hours are few


@dataclass(frozen=True)
class HealthyReadings:
    """Readings x, shape (rows, sensors), and per row the session, time (s) and hold-out group."""

    x: np.ndarray
    run: np.ndarray
    t: np.ndarray
    group: np.ndarray

    def lagged(self, values: np.ndarray, tau: float) -> np.ndarray:
        """Columns through a first-order lag that restarts with each session, tau in s; shape as values."""
        from errpipe.kernels import responses

        columns = [responses.lag(self.run, self.t, np.ascontiguousarray(v), tau, tau, True) for v in values.T]
        return np.column_stack(columns)

    def since(self) -> np.ndarray:
        """Time since the start of the session, s."""
        return self.t - self.t[self._starts()]

    def rises(self) -> np.ndarray:
        """Readings minus the first of their session."""
        return self.x - self.x[self._starts()]

    def centred(self, values: np.ndarray) -> np.ndarray:
        """Values minus their mean over every shift of a session."""
        return values - self._per_stretch(values, SHIFT_S, np.mean)

    def rare(self, values: np.ndarray, per_hour: float, max_shape: float = MAX_SHAPE) -> float:
        """The level that values (rows,) exceed `per_hour` times an hour; at least the largest value."""
        _, first = np.unique(self._stretches(BLOCK_S), return_index=True)
        return return_level(self._per_stretch(values, BLOCK_S, np.max)[first], per_hour * BLOCK_S / 3600, max_shape)

    def _starts(self) -> np.ndarray:
        first = np.r_[True, self.run[1:] != self.run[:-1]]
        return np.maximum.accumulate(np.where(first, np.arange(self.run.size), 0))

    def _stretches(self, length: float) -> np.ndarray:
        key = np.column_stack([self.run, (self.since() // length).astype(int)])
        return np.unique(key, axis=0, return_inverse=True)[1].reshape(-1)

    def _per_stretch(self, values: np.ndarray, length: float, what) -> np.ndarray:
        """Mean or maximum over each stretch of time of each session, per row."""
        key, out = self._stretches(length), np.empty_like(values)
        order = np.argsort(key, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
            out[rows] = what(values[rows], axis=0)
        return out


def rows_of(recording: Recording, names: tuple[str, ...]) -> HealthyReadings:
    """The rows in which every sensor has a reading, grouped by run."""
    x = np.column_stack([recording.array(n) for n in names]) if names else np.zeros((len(recording), 0))
    whole = np.isfinite(x).all(axis=1)
    return HealthyReadings(x[whole], sessions(recording)[whole], recording.time()[whole], recording.run_codes()[whole])


def return_level(largest: np.ndarray, per_block: float, max_shape: float = MAX_SHAPE) -> float:
    """The level that the largest value of a block exceeds with a frequency `per_block`; at least the largest value.

    Generalised extreme-value law by L-moments (Hosking, Wallis and Wood 1985, Technometrics 27:251, equations 14 and
    15), its shape limited between Gumbel's (0) and `max_shape`.
    """
    values = np.sort(largest)
    n, rank = values.size, np.arange(values.size)
    if n < 3:
        return float(values[-1])
    l1, b1 = values.mean(), np.mean(values * rank) / (n - 1)
    b2 = np.mean(values * rank * (rank - 1)) / ((n - 1) * (n - 2))
    l2, l3 = 2 * b1 - l1, 6 * b2 - 6 * b1 + l1
    if l2 <= 0:
        return float(values[-1])
    c = 2 / (3 + l3 / l2) - math.log(2) / math.log(3)
    k = float(np.clip(7.8590 * c + 2.9554 * c**2, 1e-6, max_shape))
    scale = l2 * k / ((1 - 2**-k) * math.gamma(1 + k))
    place = l1 - scale * (1 - math.gamma(1 + k)) / k
    level = place + scale * (1 - (-math.log1p(-per_block)) ** k) / k
    return float(max(level, values[-1]))
