"""Weights by which the departures of sensors tell them apart, and the thresholds of what healthy ones do.

The estimate that follows a sensor best says nothing of which of two close ones failed: their departures are one and
the same. Each sensor gives up some closeness (by a ridge of its own), no more than all of them need to be told apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.guard.blame import MARGIN
from errpipe.guard.rows import Healthy, left_out, ridge_weights, seldom

RIDGES = np.logspace(-5, 1, 25)  # times the readings' mean square
APART = 0.8  # of a fault at most shows in another sensor's statistic, or the wrong sensor is blamed
CHOSEN = 1.1  # times: the lowest of many thresholds is lower than it should be
LEAST_NOISE = 3.0  # times the readings' own noise: no threshold lies below
HARDLY = 0.05  # of a fault is left of its own statistic at least, however much others follow it
GAIN = 1e-9


@dataclass(frozen=True)
class Apart:
    """Weights (sensors, sensors) and thresholds (sensors,), K, of the departures that tell sensors apart."""

    weights: np.ndarray
    quick: np.ndarray
    slow: np.ndarray

    def elsewhere(self) -> float:
        """The largest share of a fault of one sensor that shows in another one's departure, by thresholds."""
        shows = np.abs(self.weights)
        return max(float(np.max(shows * t[None, :] / t[:, None])) for t in (self.quick, self.slow))

    def smallest(self) -> np.ndarray:
        """The smallest step that is blamed on the sensor that makes it, (sensors,), K.

        What it makes of others comes back through them: so much of a statistic may be theirs.
        """
        mutual = np.abs(self.weights * self.weights.T)
        return self.quick / np.maximum(1.0 - MARGIN * mutual.max(axis=1), HARDLY)


def apart(rows: Healthy, rate: float) -> Apart:
    """The weights by which the smallest faults are seen, a ridge per sensor; learnt from what is recent.

    rate: false alarms per hour, sensor and statistic. Starts from the least ridge for all that keeps faults apart, and
    changes one at a time as long as the smallest faults, by their root mean square, become smaller.
    """
    tried = _tried(rows, rate)
    chosen = np.full(rows.x.shape[1], len(RIDGES) - 1)
    for k in range(len(RIDGES)):
        chosen[:] = k
        if _pick(tried, chosen).elsewhere() <= APART:
            break
    best = _pick(tried, chosen)
    while True:
        step = _better(tried, chosen, best)
        if step is None:
            return best
        chosen, best = step


def _better(tried: list[Apart], chosen: np.ndarray, best: Apart) -> tuple[np.ndarray, Apart] | None:
    """The one change of one sensor's ridge that gains most; None where none gains."""
    found, least = None, _size(best) * (1.0 - GAIN)
    for i in range(chosen.size):
        for k in range(len(tried)):
            changed = chosen.copy()
            changed[i] = k
            candidate = _pick(tried, changed)
            if _size(candidate) < least and candidate.elsewhere() <= APART:
                found, least = (changed, candidate), _size(candidate)
    return found


def _size(one: Apart) -> float:
    return float(np.sum(one.smallest() ** 2))


def _pick(tried: list[Apart], chosen: np.ndarray) -> Apart:
    """Each sensor with the ridge chosen for it."""
    return Apart(*(np.array([getattr(tried[k], part)[i] for i, k in enumerate(chosen)]) for part in _PARTS))


_PARTS = ("weights", "quick", "slow")


def _tried(rows: Healthy, rate: float) -> list[Apart]:
    """Weights and thresholds of every ridge, for all sensors alike; thresholds on groups left out."""
    rise = rows.stacked[:, :1]
    recent = rows.recent(rise[:, 0])[:, None]
    noise = np.std(np.diff(rows.x, axis=0)[np.diff(rows.run) == 0], axis=0) / np.sqrt(2)
    least = np.maximum(LEAST_NOISE * noise, 1e-6)
    out = []
    for ridge in RIDGES:
        residual = left_out(rise, recent, rows.group, ridge)
        statistics = (rows.lagged(rows.recent(residual), rows.filter_s), rows.lagged(residual, rows.filter_s))
        levels = [[seldom(np.abs(column), rows.run, rows.t, rate) for column in s.T] for s in statistics]
        out.append(Apart(ridge_weights(recent, ridge)[:, 0], *(CHOSEN * np.maximum(levels, least))))
    return out
