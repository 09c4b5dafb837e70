"""Learning a sensor guard from healthy readings: covariances, leave-one-out estimates, thresholds.

The threshold has a stated false-alarm rate: the largest residuals of every two hours, on groups not used for
the covariance, are extrapolated to that rate by the extreme-value distribution. With few hours of learning this
extrapolates far; `hours` states their number. The rate holds for conditions like those of the learning data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.errors import DataError
from errpipe.guard import description as g
from errpipe.guard.rows import HealthyReadings, rows_of
from errpipe.guard.rules import FALSE_ALARMS, RULES, activity_of

# Time constants, chosen on the turning centre with both seasons in view (examples/sensor-failure); largest ratio to
# healthy in 60 failures: horizon 0.75 h 1.4, 1 h 1.38, 1.5 h 1.29, 2 h 2.1; settle 15 min 1.38, 30 min 1.29, 1 h 1.36.
HORIZON_S = 5400.0
SETTLE_S = 1800.0
RIDGES = np.logspace(-5, 1, 13)  # times the mean square of the readings: steps of half a decade
MAX_CORRELATION = 0.8  # largest share of a fault in another sensor's residual; above it, noise selects the wrong sensor
SELECTION_MARGIN = 1.1  # factor: the lowest of many thresholds is biased low
MAX_RATE = 3.0  # times the fastest change of a healthy reading
# Margins beyond the range in the recording, share and K at least: readings outside are impossible. A shop spans 5 to
# 35 degC over a year, and learning in winter must not make summer readings impossible: with 10 K a healthy machine
# lost 65 % (`trials.thermal`, seed 102, machine 2).
RANGE_SHARE, RANGE_K = 0.5, 25.0
REACH = 2.0  # times the largest residual of healthy readings
ACTIVE = 0.2  # quantile: share of the time in which a healthy reading is less active
LATEST_S = 1200.0  # s after the start in which a late sensor usually has its first reading (by judgement)
FEWEST_STARTS = 3  # for leave-one-run-out
# K2, of differences between readings at the start; and the largest error, as share of the rise in LATEST_S. Chosen on
# four machines of an own generator (seed 1): sensors with 0.21, 0.33 and 0.39 leave more with it, lower ones less.
START_RIDGE, START_SHARE = 0.1, 0.2
MIN_HOURS = 10.0  # h of recording to learn from


def learn(recording: Recording, sensors: Sequence[str] | None = None, others: Sequence[str] = ()) -> g.SensorGuard:
    """Learn from a recording whose sensors were healthy (clean it first).

    sensors: default all temperatures; others: those to be kept consistent with them. Leave-one-run-out. Raises
    DataError if there are fewer than two sensors, two runs, or ten hours.
    """
    names = tuple(sensors) if sensors is not None else recording.names("temperature")
    rows = rows_of(recording, names)
    hours = _hours(rows)
    groups = int(np.unique(rows.group).size)
    if len(names) < 2 or groups < 2 or hours < MIN_HOURS:
        raise DataError(
            f"a sensor guard needs two sensors, two groups and 10 hours of readings"
            f" (found: {len(names)}, {groups}, {hours:.1f})"
        )
    per_hour = FALSE_ALARMS / 1000 / (1 + len(RULES))  # of each kind of alarm: the comparison, and the rules
    test = _test(rows, per_hour)
    weights, largest = _estimate(rows)
    alive, starts = activity_of(rows), _starts(recording, rows, names)
    diagonal = np.sqrt(np.diag(test.precision))
    return g.SensorGuard(
        sensors=tuple(
            g.GuardedSensor(
                name=name,
                **_believable(rows, i),
                precision=tuple(map(float, test.precision[i])),
                smallest=float(test.threshold / diagonal[i]),
                estimate=tuple(map(float, weights[i])),
                reach=float(max(REACH * largest[i], 1e-3)),
                lively=float(np.quantile(alive[:, i], ACTIVE)) or None,
                start=starts[i],
                rules=tuple(filter(None, (rule.learn(rows, i, per_hour / len(names)) for rule in RULES))),
            )
            for i, name in enumerate(names)
        ),
        kept=_kept(rows_of(recording, (*names, *others)), others),
        threshold=test.threshold,
        horizon_s=HORIZON_S,
        settle_s=SETTLE_S,
        most_failed=min(2, len(names) - 1),
        false_alarms=FALSE_ALARMS,
        hours=hours,
        correlation=test.correlation(),
    )


@dataclass(frozen=True)
class _Test:
    """Precision P (sensors, sensors) of recent changes, 1/K2, and the threshold of standardised residuals."""

    precision: np.ndarray
    threshold: float

    def correlation(self) -> float:
        """The largest share of a fault that appears in another sensor's residual."""
        size = np.sqrt(np.diag(self.precision))
        shown = np.abs(self.precision) / np.outer(size, size)
        return float(np.max(shown - np.eye(size.size)))

    def smallest(self) -> float:
        """Sum of squares of the smallest faults that reach the threshold, K2."""
        return float(np.sum(self.threshold**2 / np.diag(self.precision)))


def _test(rows: HealthyReadings, per_hour: float) -> _Test:
    """The ridge with the smallest detectable faults, among those that separate the sensors; else the largest ridge."""
    recent = rows.x - rows.lagged(rows.x, HORIZON_S)
    tried = []
    for ridge in RIDGES:
        worst = np.empty(len(recent))
        for label in np.unique(rows.group):
            out = rows.group == label
            precision = _precision(recent[~out], ridge)
            worst[out] = np.max(np.abs(recent[out] @ precision) / np.sqrt(np.diag(precision)), axis=1)
        level = SELECTION_MARGIN * rows.rare(worst, per_hour)
        tried.append(_Test(_precision(recent, ridge), max(level, 1e-9)))
    separable = [one for one in tried if one.correlation() <= MAX_CORRELATION]
    return min(separable, key=_Test.smallest) if separable else tried[-1]


def _precision(values: np.ndarray, ridge: float) -> np.ndarray:
    """Inverse of the covariance of columns, with a ridge in units of their mean square."""
    square = values.T @ values / len(values)
    size = max(float(np.mean(np.diag(square))), 1e-12)
    return np.linalg.inv(square + ridge * size * np.eye(len(square)))


def _estimate(rows: HealthyReadings) -> tuple[np.ndarray, np.ndarray]:
    """Weights (sensors, sensors) of the best estimates, and the largest residual since the start per sensor, K.

    Learnt from changes within a shift, because an estimate only continues a reading from where it was last
    accepted; with the ridge of the smallest leave-one-group-out residual.
    """
    rise = rows.rises()
    shift = rows.centred(rise)

    def left(ridge: float, of: np.ndarray) -> np.ndarray:
        return left_out(rows.group, shift, of, lambda values: _regress(values, ridge))

    ridge = min(RIDGES, key=lambda r: float(np.sum(np.log(np.mean(left(r, shift) ** 2, axis=0) + 1e-18))))
    return _regress(shift, ridge), np.max(np.abs(left(ridge, rise)), axis=0)


def _kept(rows: HealthyReadings, names: Sequence[str]) -> tuple[g.KeptSensor, ...]:
    """The last columns of the readings, each estimated from the rises of those before them."""
    if not names or not len(rows.x):
        return ()
    sensors, rise = rows.x.shape[1] - len(names), rows.rises()
    size = max(float(np.mean(rise[:, :sensors] ** 2)), 1e-12)

    def weights(values: np.ndarray, ridge: float) -> np.ndarray:
        x, out = values[:, :sensors], np.zeros((values.shape[1], values.shape[1]))
        square = x.T @ x / len(x) + ridge * size * np.eye(sensors)
        out[sensors:, :sensors] = np.linalg.solve(square, x.T @ values[:, sensors:] / len(x)).T
        return out

    tried = np.array([left_out(rows.group, rise, rise, partial(weights, ridge=r))[:, sensors:] for r in RIDGES])
    best = np.argmin(np.mean(tried**2, axis=1), axis=0)
    out = []
    for i, name in enumerate(names):
        largest = float(np.max(np.abs(tried[best[i], :, i])))
        ends = _believable(rows, sensors + i)
        estimate = tuple(map(float, weights(rise, RIDGES[best[i]])[sensors + i, :sensors]))
        out.append(
            g.KeptSensor(name=name, low=ends["low"], high=ends["high"], estimate=estimate, within=max(largest, 1e-3))
        )
    return tuple(out)


def _regress(values: np.ndarray, ridge: float) -> np.ndarray:
    """Ridge regression of each column on all others, (columns, columns); 0 on itself. From the precision matrix."""
    precision = _precision(values, ridge)
    return np.eye(len(precision)) - precision / np.diag(precision)[:, None]


def left_out(
    group: np.ndarray, learnt_from: np.ndarray, judged: np.ndarray, weights: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Residuals of estimates in every row, with weights learnt without its group; shape as judged."""
    out = judged.copy()
    for label in np.unique(group):
        inside = group == label
        out[inside] -= judged[inside] @ weights(learnt_from[~inside]).T
    return out


def limits(recording: Recording, names: Sequence[str]) -> g.SensorGuard:
    """A guard that tests each sensor alone, without replacement: one that jumps, or loses its own noise, has failed.

    Raises DataError if no row has all sensors, or if no sensor changes within a run: the recording shows no rates then.
    """
    rows = rows_of(recording, tuple(names))
    if not np.any(rows.rises()):
        raise DataError("the recording shows no temperature that changes within a run")
    starts = _starts(recording, rows, tuple(names))
    return g.SensorGuard(
        sensors=tuple(
            g.GuardedSensor(
                name=name,
                **_believable(rows, i),
                start=starts[i],
                estimate=(0.0,) * len(names),
                stands_in=False,
                reach=float(max(REACH * np.abs(rows.rises()[:, i]).max(), 1e-3)),
                rules=tuple(filter(None, (rule.alone(rows, i) for rule in RULES))),
            )
            for i, name in enumerate(names)
        ),
        horizon_s=HORIZON_S,
        settle_s=SETTLE_S,
        most_failed=0,
        false_alarms=FALSE_ALARMS,
        hours=_hours(rows),
    )


def _starts(recording: Recording, rows: HealthyReadings, names: tuple[str, ...]) -> list[g.Start | None]:
    """Per sensor its usual reading at the start by those of the others, and the range of its rise soon after.

    None where that reading is not known much better (leave-one-run-out) than the rise, which a late sensor lacks.
    """
    x, session = np.column_stack([recording.array(n) for n in names]), sessions(recording)
    start = x[np.flatnonzero(np.diff(session, prepend=-1))]
    start = start[np.isfinite(start).all(axis=1)]
    soon = rows.rises()[(rows.since() > 0.0) & (rows.since() <= LATEST_S)]
    if len(names) < 2 or len(start) < FEWEST_STARTS or not soon.size:
        return [None] * len(names)
    out: list[g.Start | None] = []
    for k, (low, high) in enumerate(zip(soon.min(axis=0), soon.max(axis=0), strict=True)):
        left = []
        for run in range(len(start)):
            weights, usual = _start_of(k, np.delete(start, run, axis=0))
            left.append(start[run, k] - start[run] @ weights - usual)
        known = np.mean(np.square(left)) < (START_SHARE**2) * np.mean(soon[:, k] ** 2)
        weights, usual = _start_of(k, start)
        limits = (min(float(low), 0.0), max(float(high), 0.0))
        out.append(g.Start(weights=tuple(map(float, weights)), usual=usual, limits=limits) if known else None)
    return out


def _start_of(k: int, start: np.ndarray) -> tuple[np.ndarray, float]:
    """Weights of the others (their sum is one) and offset, K, of a reading at the start; ridge towards their mean."""
    count = start.shape[1] - 1
    others = np.delete(start, k, axis=1)
    mean = others.mean(axis=1)
    apart = others - mean[:, None]
    z, y = apart - apart.mean(axis=0), start[:, k] - mean
    own = np.linalg.solve(z.T @ z + START_RIDGE * len(start) * np.eye(count), z.T @ (y - y.mean()))
    weights = np.insert(own - own.mean() + 1.0 / count, k, 0.0)
    return weights, float(y.mean() - apart.mean(axis=0) @ own)


def _hours(rows: HealthyReadings) -> float:
    return float(sum(np.ptp(rows.t[rows.run == r]) for r in np.unique(rows.run)) / 3600)


def _believable(rows: HealthyReadings, i: int) -> dict[str, float]:
    """Range and rate of one healthy reading."""
    x = rows.x[:, i]
    low, high = float(np.min(x)), float(np.max(x))
    margin = max(RANGE_SHARE * (high - low), RANGE_K)
    same = (np.diff(rows.run) == 0) & (np.diff(rows.t) > 0)
    fastest = float(np.max(np.abs(np.diff(x)[same]) / np.diff(rows.t)[same], initial=1e-6))
    return {"low": low - margin, "high": high + margin, "max_rate": MAX_RATE * fastest}
