"""Learning a sensor guard from healthy readings, and watching a recording with it.

Thresholds keep a stated false-alarm rate: the largest departures of every two hours, on readings that had no part in
the weights, are extrapolated to the stated rate by the law of largest values (generalised, by L-moments:
Hosking 1990). With few hours of learning that extrapolates far; `hours` says how many there were.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.domain import sensor_guard as g
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.terms._base import drive

FILTER = 300.0  # s: machines warm up over minutes and more, noise and switching heaters are quicker
FREEZE = 300.0  # s
HORIZON = 3600.0  # s
RIDGES = np.logspace(-5, 1, 25)  # times the readings' mean square; the smallest is taken that keeps faults apart
APART = 0.8  # of a fault at most shows in another sensor's statistic, or the wrong sensor is blamed
KINDS = 3  # of alarms: quick, slow, frozen
BLOCK = 7200.0  # s: largest values are taken per two hours, beyond which residuals know little of each other
LIGHTEST = 0.25  # shape of the law of largest values: lighter is not believed of few hours
FAINTEST = 1e-8  # of the usual liveliness: below, a sensor that is frozen would be told after days
LEAST_NOISE = 3.0  # times the readings' own noise: no threshold lies below
RATE = 3.0  # times the fastest change seen: no healthy reading is faster
BEYOND = 0.5  # of the range seen, on either side, and RANGE_MARGIN: readings outside are impossible
RANGE_MARGIN = 10.0  # K


@dataclass(frozen=True)
class Watch:
    """What a guard made of a recording. Arrays have shape (rows, sensors), sensors in the guard's order."""

    names: tuple[str, ...]
    fault: np.ndarray
    reading: np.ndarray


def watch(guard: g.SensorGuard, recording: Recording) -> Watch:
    """Faults (bool) and guarded readings, row by row and causal: as the compiled drivers do it."""
    names = guard.names()
    recording, impossible = _conditioned(guard, recording)
    fault = np.column_stack([drive(g.fault(guard, n), recording) for n in names]) > 0.5
    reading = np.column_stack([drive(g.reading(guard, n), recording) for n in names])
    return Watch(names, fault | impossible, reading)


def _conditioned(guard: g.SensorGuard, recording: Recording) -> tuple[Recording, np.ndarray]:
    """Readings as a table's inputs give them on: what is empty, impossible or racing holds the one before."""
    columns, doubted = {}, []
    run, t = recording.run_codes(), recording.time()
    for s in guard.sensors:
        values, doubt = _believed(recording.array(s.name), run, t, s)
        columns[s.name] = values
        doubted.append(doubt)
    return Recording(recording.manifest, recording.frame.assign(**columns)), np.column_stack(doubted)


def _believed(x: np.ndarray, run: np.ndarray, t: np.ndarray, s: g.GuardedSensor) -> tuple[np.ndarray, np.ndarray]:
    out, doubt = x.copy(), np.zeros(x.size, dtype=bool)
    good, when = np.nan, 0.0
    for i in range(x.size):
        if i == 0 or run[i] != run[i - 1]:
            good = np.nan
        possible = s.low <= x[i] <= s.high
        if possible and not np.isnan(good):
            possible = abs(x[i] - good) <= s.max_rate * max(t[i] - when, 1e-9)
        if possible:
            good, when = x[i], t[i]
        else:
            out[i], doubt[i] = good, True
    return out, doubt


def learn(
    recording: Recording,
    sensors: Sequence[str] | None = None,
    *,
    group: str | None = None,
    false_alarms: float = 0.5,
    filter_s: float = FILTER,
    horizon_s: float = HORIZON,
    freeze_s: float = FREEZE,
) -> g.SensorGuard:
    """Learn from a recording whose sensors were healthy (clean it first).

    sensors: default all temperatures. group: column whose labels are left out one by one (default: runs).
    false_alarms: expected alarms per 1000 hours, all sensors together. Raises DataError where there are fewer
    than two sensors, two groups, or ten hours.
    """
    names = tuple(sensors) if sensors is not None else recording.names("temperature")
    x, run, t, held_out = _rows(recording, names, group)
    hours = float(sum(np.ptp(t[run == r]) for r in np.unique(run)) / 3600)
    if len(names) < 2 or np.unique(held_out).size < 2 or hours < 10:
        raise DataError(
            f"a sensor guard needs two sensors, two groups and 10 hours of readings"
            f" (found: {len(names)}, {np.unique(held_out).size}, {hours:.1f})"
        )
    rows = _Healthy(x, run, t, held_out, filter_s, horizon_s)
    rate = false_alarms / 1000 / len(names) / KINDS  # per hour, sensor and kind of alarm
    apart, close = _apart(rows, rate), _close(rows, rate)
    alive = _lagged((x - _lagged(x, run, t, freeze_s)) ** 2, run, t, freeze_s)
    sensors_out = []
    for i, name in enumerate(names):
        others = [j for j in range(len(names)) if j != i]
        low, high = np.min(x[:, i]), np.max(x[:, i])
        margin = max(BEYOND * (high - low), RANGE_MARGIN)
        sensors_out.append(
            g.GuardedSensor(
                name=name,
                low=float(low - margin),
                high=float(high + margin),
                max_rate=float(RATE * _fastest(x[:, i], run, t)),
                sources=tuple(names[j] for j in others),
                weights=tuple(float(apart.weights[i, j]) for j in others),
                estimate=tuple(float(close.weights[i, j]) for j in others),
                offset=float(np.median(x[:, i] - x[:, others] @ close.weights[i, others])),
                residual=float(np.sqrt(np.mean(close.residual[:, i] ** 2))),
                quick=float(apart.quick[i]),
                slow=float(apart.slow[i]),
                still=_still(alive[:, i], run, t, rate, freeze_s),
            )
        )
    return g.SensorGuard(
        sensors=tuple(sensors_out), filter_s=filter_s, horizon_s=horizon_s, freeze_s=freeze_s,
        false_alarms=false_alarms, hours=hours, shows_elsewhere=apart.shows,
    )  # fmt: skip


@dataclass(frozen=True)
class _Healthy:
    """Readings of healthy sensors, shape (rows, sensors), and how they are to be looked at."""

    x: np.ndarray
    run: np.ndarray
    t: np.ndarray
    group: np.ndarray
    filter_s: float
    horizon_s: float

    def lagged(self, values: np.ndarray, tau: float) -> np.ndarray:
        return _lagged(values, self.run, self.t, tau)

    def recent(self, values: np.ndarray) -> np.ndarray:
        return values - self.lagged(values, self.horizon_s)


@dataclass(frozen=True)
class _Departures:
    """Weights (sensors, sensors), departures of rows left out (rows, sensors), thresholds (sensors,).

    shows: the largest share of a fault of one sensor that shows in another one's quick departure, by thresholds.
    """

    weights: np.ndarray
    residual: np.ndarray
    quick: np.ndarray
    slow: np.ndarray
    shows: float


def _departures(rows: _Healthy, learnt_from: np.ndarray, ridge: float, rate: float) -> _Departures:
    rise = _rises(rows.x, rows.run)
    residual = _left_out(rise, learnt_from, rows.group, ridge)
    noise = np.std(np.diff(rows.x, axis=0)[np.diff(rows.run) == 0], axis=0) / np.sqrt(2)
    least = np.maximum(LEAST_NOISE * noise, 1e-6)
    quick, slow = (
        np.maximum([_seldom(np.abs(column), rows.run, rows.t, rate) for column in statistic.T], least)
        for statistic in (rows.lagged(rows.recent(residual), rows.filter_s), rows.lagged(residual, rows.filter_s))
    )
    weights = _weights(learnt_from, ridge)
    return _Departures(weights, residual, quick, slow, float(np.max(np.abs(weights) * quick[None, :] / quick[:, None])))


def _close(rows: _Healthy, rate: float) -> _Departures:
    """With the weights that leave the least of groups left out."""
    rise = _rises(rows.x, rows.run)
    left = {r: np.mean(_left_out(rise, rise, rows.group, r) ** 2, axis=0) for r in RIDGES}
    return _departures(rows, rise, min(left, key=lambda r: float(np.sum(np.log(left[r])))), rate)


def _apart(rows: _Healthy, rate: float) -> _Departures:
    """With the least ridge that keeps faults apart; learnt from what is recent, as quick faults are."""
    recent = rows.recent(_rises(rows.x, rows.run))
    for ridge in RIDGES:
        found = _departures(rows, recent, ridge, rate)
        if found.shows <= APART:
            break
    return found


def _rows(
    recording: Recording, names: tuple[str, ...], group: str | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Readings, runs, times and groups of the rows in which every sensor has a reading."""
    x = np.column_stack([recording.array(n) for n in names]) if names else np.zeros((len(recording), 0))
    whole = np.isfinite(x).all(axis=1)
    labels = recording.run_codes() if group is None else np.unique(recording.frame[group], return_inverse=True)[1]
    return x[whole], recording.run_codes()[whole], recording.time()[whole], labels[whole]


def _rises(x: np.ndarray, run: np.ndarray) -> np.ndarray:
    first = np.r_[True, run[1:] != run[:-1]]
    start = np.maximum.accumulate(np.where(first, np.arange(run.size), 0))
    return x - x[start]


def _weights(values: np.ndarray, ridge: float) -> np.ndarray:
    """w_ij: regression of each sensor on all others from one covariance, shape (sensors, sensors), zero diagonal."""
    square = values.T @ values / len(values)
    precision = np.linalg.inv(square + ridge * np.mean(np.diag(square)) * np.eye(len(square)))
    return np.eye(len(square)) - precision / np.diag(precision)[:, None]


def _left_out(rise: np.ndarray, learnt_from: np.ndarray, group: np.ndarray, ridge: float) -> np.ndarray:
    """r of every row, weights learnt without its group; same shape as rise."""
    out = np.empty_like(rise)
    for label in np.unique(group):
        inside = group == label
        out[inside] = rise[inside] - rise[inside] @ _weights(learnt_from[~inside], ridge).T
    return out


def _lagged(values: np.ndarray, run: np.ndarray, t: np.ndarray, tau: float) -> np.ndarray:
    from errpipe.kernels import responses

    return np.column_stack([responses.lag(run, t, np.ascontiguousarray(v), tau, tau, True) for v in values.T])


def _blocks(values: np.ndarray, run: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Largest value of each block of time."""
    first = np.r_[True, run[1:] != run[:-1]]
    since = t - t[np.maximum.accumulate(np.where(first, np.arange(run.size), 0))]
    key = run * 100_000 + (since // BLOCK).astype(int)
    return np.array([values[key == k].max() for k in np.unique(key)])


def _seldom(values: np.ndarray, run: np.ndarray, t: np.ndarray, per_hour: float) -> float:
    """The level that values exceed `per_hour` times an hour; no less than the largest value seen.

    Generalised extreme-value law with a tail between Gumbel's and one that ends (shape 0 to LIGHTEST).
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
    k = float(np.clip(7.8590 * c + 2.9554 * c**2, 1e-6, LIGHTEST))
    scale = l2 * k / ((1 - 2**-k) * math.gamma(1 + k))
    place = l1 - scale * (1 - math.gamma(1 + k)) / k
    level = place + scale * (1 - (-math.log1p(-per_hour * BLOCK / 3600)) ** k) / k
    return float(max(level, largest[-1]))


def _still(alive: np.ndarray, run: np.ndarray, t: np.ndarray, per_hour: float, tau: float) -> float | None:
    """The stillness that a healthy sensor hardly ever reaches; None where it stands still when healthy."""
    first = np.r_[True, run[1:] != run[:-1]]
    since = t - t[np.maximum.accumulate(np.where(first, np.arange(run.size), 0))]
    told = since > g.WARM_UP * tau
    if not told.any() or alive[told].min() <= 0:
        return None
    level = np.exp(-_seldom(-np.log(alive[told]), run[told], t[told], per_hour))
    return float(level) if level > FAINTEST * np.median(alive[told]) else None


def _fastest(x: np.ndarray, run: np.ndarray, t: np.ndarray) -> float:
    same = (np.diff(run) == 0) & (np.diff(t) > 0)
    return float(np.max(np.abs(np.diff(x)[same]) / np.diff(t)[same], initial=1e-6))
