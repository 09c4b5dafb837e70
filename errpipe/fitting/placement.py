"""Sensor placement: the place at which a temperature is most nearly proportional to the error.

For any field (a bar, a column, a finite-element model): readings at candidate places and the error at the same
times. The heat equation is linear in its sources, so "one curve for every heat flux" (Ni 1997, Fig. 8) means that the
error is a constant times the reading: a straight line through the origin. A line fitted to one warm-up is then valid
for any duty cycle; a polynomial fitted anywhere else is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from errpipe.errors import DataError

TINY_RIDGE = 1e-9  # relative: keeps two equal columns from dividing by zero
ENOUGH = 1.05  # the smallest set within 5 % of the best held-out rms is used (by judgement)


def lag_free_place(loss: float) -> float:
    """Place on a bar with an insulated end at which the reading has the lag of the growth, in bar lengths.

    coth(mu) - 1/mu = (1 - x) tanh(mu (1 - x)), mu = sqrt(loss), loss = h P L2 / (k A) >= 0; 1 - 1/sqrt(3) at no loss.
    """
    if loss < 0:
        raise DataError(f"placement: loss {loss:g} (allowed: 0 or more)")
    mu = np.sqrt(loss)
    if mu < 1e-3:
        return float(1.0 - 1.0 / np.sqrt(3.0))
    relative_lag = 1.0 / np.tanh(mu) - 1.0 / mu
    return float(brentq(lambda x: (1.0 - x) * np.tanh(mu * (1.0 - x)) - relative_lag, 0.0, 1.0))


@dataclass(frozen=True)
class SensorPlacement:
    """Places for so many sensors, chosen on all groups; rms on held-out groups, in the error's unit."""

    places: tuple[int, ...]
    rms_left_out: float
    groups: dict[str, float]


def choose(
    readings: np.ndarray, error: np.ndarray, group: np.ndarray, most: int
) -> tuple[float, list[SensorPlacement]]:
    """The uncompensated rms, and the best places for 1 to `most` sensors by forward selection.

    readings: (times, places), rises over the start of each duty cycle; error: (times,); group: (times,), the duty
    cycle, held out one by one. The error is a weighted sum of readings. Places are selected again without each held-out
    group (nested), so that selecting the best of many is not optimistic. Raises DataError below two groups.
    """
    labels = np.unique(group)
    if labels.size < 2:
        raise DataError(f"placement: sensors are validated on held-out duty cycles, at least two (found {labels.size})")
    most = min(most, readings.shape[1])
    whole = _forward(readings, error, group, most)
    squares = [{str(label): 0.0 for label in labels} for _ in range(most)]
    for label in labels:
        out = group == label
        for size, places in enumerate(_forward(readings[~out], error[~out], group[~out], most)):
            residual = error[out] - readings[out][:, places] @ _weights(readings[~out][:, places], error[~out])
            squares[size][str(label)] = float(np.mean(residual**2))
    rows = {str(label): np.count_nonzero(group == label) for label in labels}
    chosen = []
    for places, by in zip(whole, squares, strict=True):
        rms = float(np.sqrt(sum(by[n] * rows[n] for n in by) / error.size))
        chosen.append(SensorPlacement(tuple(places), rms, {n: float(np.sqrt(v)) for n, v in by.items()}))
    return float(np.sqrt(np.mean(error**2))), chosen


def _forward(readings: np.ndarray, error: np.ndarray, group: np.ndarray, most: int) -> list[list[int]]:
    """Places of each size: at every step the one with the smallest held-out error (of all rows for one group)."""
    labels = np.unique(group)
    places: list[int] = []
    out: list[list[int]] = []
    for _ in range(most):
        errors = {}
        for k in range(readings.shape[1]):
            if k not in places:
                errors[k] = _left_out(readings[:, [*places, k]], error, group, labels)
        places.append(min(errors, key=lambda k: errors[k]))
        out.append(list(places))
    return out


def _left_out(columns: np.ndarray, error: np.ndarray, group: np.ndarray, labels: np.ndarray) -> float:
    if labels.size < 2:
        return float(np.mean((error - columns @ _weights(columns, error)) ** 2))
    total = 0.0
    for label in labels:
        out = group == label
        total += float(np.sum((error[out] - columns[out] @ _weights(columns[~out], error[~out])) ** 2))
    return total


def _weights(columns: np.ndarray, error: np.ndarray) -> np.ndarray:
    square = columns.T @ columns
    square = square + TINY_RIDGE * max(float(np.trace(square)), 1e-300) / len(square) * np.eye(len(square))
    return np.linalg.solve(square, columns.T @ error)


def by_degree(readings: np.ndarray, error: np.ndarray, group: np.ndarray) -> np.ndarray:
    """The rms on held-out groups of a line, a parabola and a cubic through the origin, at each place, (places, 3).

    Line and parabola are compared at the same place on the same groups.
    """
    labels = np.unique(group)
    out = np.empty((readings.shape[1], 3))
    for k in range(readings.shape[1]):
        size = float(np.abs(readings[:, k]).max()) or 1.0
        for degree in (1, 2, 3):
            columns = (readings[:, [k]] / size) ** np.arange(1, degree + 1)
            out[k, degree - 1] = np.sqrt(_left_out(columns, error, group, labels) / error.size)
    return out
