"""Sensor drift and its start: leave-one-sensor-out residuals per run in a two-sided CUSUM.

Each temperature is predicted from the others by least squares on the runs before (recursive residuals: Brown, Durbin
and Evans 1975; self-starting as in Hawkins 1987), so a season missing in the reference runs enters the regression as
it appears. A drifting sensor does not: the regression is not updated after an alarm. The residual, averaged per run
and divided by the scatter between reference runs (leave-one-out), enters a cumulative sum (Page 1954), whose
threshold allows for a scatter estimated from few runs. One drifting sensor also moves the predictions of the others, so
each suspect is excluded in turn: it is the drifting one if the others then show no drift, but do without any other
suspect. If the others show none without either of two, one of these drifts, and the data do not show which.

Temperatures alone need many nights: even with onset, size and sign known, the most powerful test at that false-alarm
rate (Neyman and Pearson) sees a drift of 0.25 K a night, in residuals of 0.33 K, in 8 of 100 cases after three nights
and in half of them after four. A second source is faster: the champion's residual of a response that it was fitted
to gives, in kelvin, the error of a sensor that would explain it (`apparent`) if nothing else had changed. Whether the
sensor or the machine changed is then a test of two simple hypotheses. With a the apparent errors of the runs since the
response moved, r the sensor's residuals in them and C their covariance, the regression's own error included:

    log likelihood ratio = a' C^-1 r - a' C^-1 a / 2

For a changed machine the ratio stays below RATIO for ever in all but 1 / RATIO of the cases (Ville 1939).

The same source shows that a sensor is healthy: its temperature left the others, the response followed it, and so its
surroundings changed (coolant, place, load). Two sensors that disagree do not show which of them is wrong, nor
whether one is: a cold hall missing in the reference runs has the same effect. Without a response neither is flagged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.validation.cusum import FALSE_ALARMS, MIN_REFERENCE_RUNS, REFERENCE, cusum, threshold

MIN_SD = 0.05  # K; residuals are not resolved below a sensor's display resolution
QUIETER = 0.2  # largest CUSUM without the faulty sensor over that with it: chosen on simulated sensors, seeds 1 to 3
AMBIGUITY_RATIO = 2.0  # to the smallest of these: within it, a sensor may also be the faulty one (by judgement)
SIGNS = np.array([1.0, -1.0])  # up and down
# Likelihood of a drifting sensor over that of a changed machine: at most one change in 10 is misidentified
RATIO = 10.0
HALF = 0.5  # of a sensor's residual: a response that moved by more does not show that the sensor is right
SCALES: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {  # what reads so -> what it would be as declared
    "degF instead of degC": lambda t: (t - 32.0) / 1.8,
    "K instead of degC": lambda t: t - 273.15,
    "degC instead of degF": lambda t: 1.8 * t + 32.0,
    "degC instead of K": lambda t: t + 273.15,
}
MAX_TEMPERATURE_CHANGE = 25.0  # K; every sensor of a machine, including air, changes by less from one run to another
SEASON = 15.0  # K; between seasons they change by less


@dataclass(frozen=True)
class Drift:
    """A column that drifted from the reference. since: label of the run in which its excursion started; size: K, mean.

    isolated: this sensor is faulty; flagged: this or another flagged one is; healthy: a response shows that it reads
    right.
    """

    column: str
    since: str
    size: float
    statistic: float
    isolated: bool = False
    flagged: bool = False
    healthy: bool = False


class _Readings(NamedTuple):
    """Temperatures, (rows, sensors), the run of each row, (rows,), and codes of the reference runs and of the new."""

    values: np.ndarray
    run: np.ndarray
    old: list[int]
    new: list[int]

    def without(self, k: int) -> _Readings:
        """The same without sensor k."""
        return self._replace(values=np.delete(self.values, k, axis=1))


def sensor_drift(
    recording: Recording, reference: np.ndarray, apparent: Mapping[str, np.ndarray] = MappingProxyType({})
) -> list[Drift]:
    """Temperatures whose leave-one-sensor-out residual drifts from the reference runs; the faulty one first.

    reference: rows fitted by the champion, (rows,). apparent: column -> error of the sensor that would explain the
    champion's residual, K per run in the order of their codes, NaN if unknown. Empty if there are fewer than two
    sensors, fewer than four reference runs, or no run after them.
    """
    names, run = recording.names("temperature"), recording.run_codes()
    old, new = old_and_new(run, reference)
    if len(names) < 2 or len(old) < MIN_REFERENCE_RUNS or not new:
        return []
    labels = recording.run_labels()
    data = _Readings(np.column_stack([recording.array(n) for n in names]), run, old, new)
    z, sd, limit = _standardised_residuals(data)
    alarms = [cusum(column) for column in z.T]
    seen = [
        Drift(name, labels[new[begin]], float(np.mean(z[begin:, k]) * sd[k]), alarm)
        for k, (name, (alarm, begin)) in enumerate(zip(names, alarms, strict=True))
    ]
    drift_of = {k: d for k, d in enumerate(seen) if d.statistic >= limit}
    known = {k: apparent[name] for k, name in enumerate(names) if name in apparent}
    right = [k for k, a in known.items() if drift_of and _reads_right(data, k, sd[k], a, alarms[k][1])]
    tests = {k: _sensor_or_machine(data, k, sd[k], a) for k, a in known.items() if k not in right}
    isolated = max(tests, key=lambda k: tests[k][0], default=None)
    if isolated is not None and tests[isolated][0] >= np.log(RATIO):
        ratio, begin, size = tests[isolated]
        drift_of[isolated] = Drift(names[isolated], labels[new[begin]], size, ratio)
        faulty = [isolated]
    else:
        faulty = _faulty_sensors(data, max(d.statistic for d in seen) / limit)
        drift_of |= {k: seen[k] for k in faulty}
    flagged = [k for k in faulty if k not in right]
    unflagged = sorted((k for k in drift_of if k not in flagged), key=lambda k: -drift_of[k].statistic)
    return [
        replace(drift_of[k], isolated=faulty == [k] == flagged, flagged=k in flagged, healthy=k in right)
        for k in (*flagged, *unflagged)
    ]


def old_and_new(run: np.ndarray, reference: np.ndarray) -> tuple[list[int], list[int]]:
    """Codes of the runs with reference rows and of the others, in order of appearance. run, reference: (rows,)."""
    old = dict.fromkeys(run[reference].tolist())
    return list(old), [c for c in dict.fromkeys(run.tolist()) if c not in old]


def other_unit(recording: Recording, reference: np.ndarray) -> tuple[str, str] | None:
    """The scale on which all temperatures of a new run read, and the first such run; None if it is unchanged.

    Sensors that change their scale together still agree with each other, so no drift shows it. Medians per run.
    """
    run, names = recording.run_codes(), recording.names("temperature")
    columns = [recording.array(n) for n in names]
    if not names or not all(np.isfinite(c[reference]).any() for c in columns):
        return None
    before = np.array([np.nanmedian(c[reference]) for c in columns])
    for code in dict.fromkeys(run[~reference].tolist()):
        rows = run == code
        if not all(np.isfinite(c[rows]).any() for c in columns):
            continue
        now = np.array([np.nanmedian(c[rows]) for c in columns])
        if np.all(np.abs(now - before) > MAX_TEMPERATURE_CHANGE):
            for scale, back in SCALES.items():
                if np.all(np.abs(back(now) - before) < SEASON):
                    return scale, recording.run_labels()[code]
    return None


def drifting_sensors(flagged: Sequence[str]) -> str:
    """The possibly faulty sensors, as text: `T_nut drifts`, `T_nut or T_bed drifts`."""
    *others, last = flagged
    if not others:
        return f"{last} drifts"
    return f"{', '.join(others)} or {last} drifts (the likeliest first; runs of more nights distinguish them)"


def _sensor_or_machine(data: _Readings, k: int, sd: float, apparent: np.ndarray) -> tuple[float, int, float]:
    """Log-likelihood ratio that sensor k has the error shown by a response; first new run with it; mean error, K."""
    off = _beyond_old(data.old, data.new, apparent)
    alarm, begin = cusum(off / max(float(np.nanstd(apparent[data.old])), MIN_SD))
    if alarm < threshold(len(data.old) - 1, FALSE_ALARMS / data.values.shape[1]):
        return 0.0, 0, 0.0
    since, r, covariance = _residuals_since(data, k, sd, begin)
    a = off[np.isin(data.new, since)]
    return float(a @ np.linalg.solve(covariance, r - 0.5 * a)), begin, float(a.mean())


def _reads_right(data: _Readings, k: int, sd: float, apparent: np.ndarray, begin: int) -> bool:
    """Whether a response follows sensor k since new run `begin`, in which the sensor left the others.

    Likelihood of the apparent errors of a correct sensor, zero but for their scatter in the old runs, over
    that of one with errors equal to its residuals; and they are below half of these (the response may drift itself).
    """
    since, r, covariance = _residuals_since(data, k, sd, begin)
    known = np.isfinite(apparent[since])
    a, r, covariance = _beyond_old(data.old, since, apparent)[known], r[known], covariance[np.ix_(known, known)]
    scatter = max(float(np.nanstd(apparent[data.old])), MIN_SD) ** 2 * (np.eye(a.size) + 1.0 / len(data.old))
    ratio = _log_likelihood(a, scatter) - _log_likelihood(a - r, scatter + covariance)
    return ratio >= np.log(RATIO) and bool(a @ a < HALF**2 * (r @ r))


def _log_likelihood(values: np.ndarray, covariance: np.ndarray) -> float:
    return -0.5 * float(values @ np.linalg.solve(covariance, values) + np.linalg.slogdet(covariance)[1])


def _beyond_old(old: Sequence[int], runs: Sequence[int], apparent: np.ndarray) -> np.ndarray:
    """Apparent errors of some runs minus the mean of the old ones, K, (runs,); 0 if unknown."""
    return np.nan_to_num(apparent[runs] - np.nanmean(apparent[old]))


def _residuals_since(data: _Readings, k: int, sd: float, begin: int) -> tuple[list[int], np.ndarray, np.ndarray]:
    """The new runs since `begin`, the residuals of sensor k on the others in them, K, and their covariance, K2."""
    readings, run, new = data.values, data.run, data.new
    good = np.isfinite(readings).all(axis=1)
    before, since = ([c for c in runs if good[run == c].any()] for runs in ([*data.old, *new[:begin]], new[begin:]))
    fitted = np.isin(run, before) & good
    design = np.column_stack([np.ones(run.size), np.delete(readings, k, axis=1) - readings[fitted].mean()])
    residual = readings[:, k] - design @ np.linalg.lstsq(design[fitted], readings[fitted, k])[0]
    r = np.array([residual[good & (run == c)].mean() for c in since])
    means, spans = (np.array([design[good & (run == c)].mean(axis=0) for c in runs]) for runs in (since, before))
    covariance = sd**2 * (np.eye(r.size) + means @ np.linalg.pinv(spans.T @ spans, hermitian=True) @ means.T)
    return since, r, covariance


def _faulty_sensors(data: _Readings, loudest: float) -> list[int]:
    """The sensors without each of which the others show no drift, the likeliest first: one of them is faulty.

    loudest: largest CUSUM of all sensors over the threshold. The faulty one need not be in alarm itself.
    """
    count = data.values.shape[1]
    if loudest < 1.0 or count < 3:
        return []  # with two sensors the wrong one cannot be identified
    left = []
    for k in range(count):
        z, _, limit = _standardised_residuals(data.without(k))
        left.append(max(cusum(column)[0] / limit for column in z.T))
    if min(left) >= max(1.0, QUIETER * loudest):
        return []
    return [int(k) for k in np.argsort(left) if left[k] < max(1.0, AMBIGUITY_RATIO * min(left))]


def _standardised_residuals(data: _Readings) -> tuple[np.ndarray, np.ndarray, float]:
    """Mean residual of each new run over its standard error, (new, sensors), scatter between runs, K, threshold."""
    readings, run, old, new = data
    count = readings.shape[1]
    good = np.isfinite(readings).all(axis=1)
    rows = [np.flatnonzero(good & (run == c)) for c in (*old, *new)]
    centred = readings - readings[good & np.isin(run, old)].mean(axis=0)
    limit = threshold(len(old) - count, FALSE_ALARMS / count)
    z, sd = np.zeros((len(new), count)), np.zeros(count)
    for k in range(count):
        design = np.column_stack([np.ones(len(centred)), np.delete(centred, k, axis=1)])
        z[:, k], sd[k] = _recursive_residuals(design, centred[:, k], rows, len(old), limit)
    return z, sd, limit


def _recursive_residuals(
    design: np.ndarray, target: np.ndarray, rows: Sequence[np.ndarray], references: int, limit: float
) -> tuple[np.ndarray, float]:
    """Standardised recursive residuals of the new runs, (new,), and the scatter of the reference runs, K."""
    blocks, targets = [design[r] for r in rows], [target[r] for r in rows]
    means = np.array([d.mean(axis=0) if len(d) else np.zeros(design.shape[1]) for d in blocks])
    parts = (
        np.array([d.T @ d for d in blocks]),
        np.array([d.T @ t for d, t in zip(blocks, targets, strict=True)]),
        means[:, :, None] * means[:, None, :],
    )
    a, b, _ = sums = [part[:references].sum(axis=0) for part in parts]

    def mean_residual(number: int, coefficients: np.ndarray) -> float:
        left = targets[number] - blocks[number] @ coefficients
        return float(np.mean(left)) if left.size else 0.0

    # leave-one-run-out: each reference run is predicted from the other reference runs
    others = _solve_normal(a - parts[0][:references], b - parts[1][:references])
    sd = max(float(np.sqrt(np.mean(np.square([mean_residual(n, c) for n, c in enumerate(others)])))), MIN_SD)

    # each new run is predicted from all runs before it, up to the alarm, after which the regression is not updated
    a, b, spans = (np.cumsum([s, *part[references:-1]], axis=0) for s, part in zip(sums, parts, strict=True))
    coefficients, means, known = _solve_normal(a, b), means[references:], -1
    z, cusums = np.zeros(len(means)), np.zeros(2)
    pulls = _solve_normal(spans, means)
    for n, mean in enumerate(means):
        k = n if known < 0 else known
        leverage = float(mean @ (pulls[n] if known < 0 else _solve_normal(spans[k], mean)))
        z[n] = mean_residual(references + n, coefficients[k]) / (sd * np.sqrt(1.0 + max(leverage, 0.0)))
        cusums = np.maximum(0.0, cusums + z[n] * SIGNS - REFERENCE)
        if known < 0 and cusums.max() >= limit:
            known = n
    return z, sd


def _solve_normal(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least-norm solutions of normal equations, (..., p, p) and (..., p) -> (..., p), with scaled columns."""
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=-2, axis2=-1), 1e-300))
    scaled = scale[..., :, None] * normal * scale[..., None, :]
    return scale * (np.linalg.pinv(scaled, 1e-10, hermitian=True) @ (scale * right)[..., None])[..., 0]
