"""Which sensor drifts, and since when: leave-one-sensor-out residuals per run in a two-sided CUSUM.

Each temperature is predicted from the others by least squares on the reference runs (those that fitted the champion).
Its residual, averaged per run and divided by the scatter between reference runs left out in turn, goes into a
cumulative sum (Page 1954). One sensor that drifts also moves the predictions of the others, so each suspect is taken
out in turn: it is blamed where the others are then quiet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.domain.recording import Recording

REFERENCE = 1.0  # of a standard error: half of the shift that is to be found quickest (Page 1954)
THRESHOLD = 8.0  # on white residuals a false alarm in 10^7 runs (Siegmund 1985); scatters of ten runs are uncertain
LEAST_SD = 0.05  # K; sensors that agree better than their display resolution are not judged finer than it
QUIETER = 0.2  # what is left without the blamed sensor: chosen on simulated sensors, seeds 1 to 3 of the unit test
FEWEST_RUNS = 4  # reference runs below which no scatter between runs is known


@dataclass(frozen=True)
class Drift:
    """A column that left the reference. since: label of the run where its excursion began; size: K, mean since then."""

    column: str
    since: str
    size: float
    statistic: float
    blamed: bool


def sensor_drift(recording: Recording, reference: np.ndarray) -> list[Drift]:
    """Temperatures whose residual against the others left the reference runs; the blamed one first.

    reference: rows that fitted the champion, (rows,). Empty where there are fewer than two sensors, fewer than four
    reference runs, or no run after them.
    """
    names = recording.names("temperature")
    run = recording.run_codes()
    old = list(dict.fromkeys(run[reference].tolist()))
    new = [c for c in dict.fromkeys(run.tolist()) if c not in set(old)]
    if len(names) < 2 or len(old) < FEWEST_RUNS or not new:
        return []
    readings = np.column_stack([recording.array(n) for n in names])
    z, sd = _standardised(readings, run, old, new)
    found = {}
    for k, name in enumerate(names):
        alarm, begin = cusum(z[:, k])
        if alarm >= THRESHOLD:
            found[k] = Drift(
                name, recording.run_labels()[new[begin]], float(np.mean(z[begin:, k]) * sd[k]), alarm, False
            )
    if not found:
        return []
    blamed = _blamed(readings, run, old, new, {k: d.statistic for k, d in found.items()})
    drifts = [Drift(d.column, d.since, d.size, d.statistic, k == blamed) for k, d in found.items()]
    return sorted(drifts, key=lambda d: (not d.blamed, -d.statistic))


def _blamed(readings, run, old, new, suspects: Mapping[int, float]) -> int | None:
    """The sensor without which the others are quietest, where that quietens them enough. suspects: statistics."""
    if readings.shape[1] < 3:
        return None  # two sensors that disagree do not say which of them is wrong
    loudest = {}
    for k in suspects:
        z, _ = _standardised(np.delete(readings, k, axis=1), run, old, new)
        loudest[k] = max(cusum(z[:, j])[0] for j in range(z.shape[1]))
    best = min(loudest, key=lambda k: loudest[k])
    return best if loudest[best] < max(THRESHOLD, QUIETER * max(suspects.values())) else None


def _standardised(readings, run, old: Sequence[int], new: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Mean residual of each new run over its standard error of prediction, (new, sensors), and the scatter, K.

    The scatter comes from reference runs left out in turn; a run in weather that the reference runs never saw has a
    larger standard error (its leverage on the run means).
    """
    count = readings.shape[1]
    z, sd = np.zeros((len(new), count)), np.zeros(count)
    means = np.array([np.nanmean(readings[run == c], axis=0) for c in (*old, *new)])
    for k in range(count):
        others = np.delete(readings, k, axis=1)
        fit = _fitted(others, readings[:, k], np.isin(run, old))
        left = []
        for code in old:  # each reference run judged by the others, or its scatter would be too small
            own = _fitted(others, readings[:, k], np.isin(run, [c for c in old if c != code]))
            left.append(_mean_residual(others, readings[:, k], run == code, own))
        sd[k] = max(float(np.sqrt(np.nanmean(np.square(left)))), LEAST_SD)
        leverage = _leverage(np.delete(means, k, axis=1), len(old))
        residual = np.array([_mean_residual(others, readings[:, k], run == code, fit) for code in new])
        z[:, k] = residual / (sd[k] * np.sqrt(1.0 + leverage))
    return np.nan_to_num(z), sd


def _leverage(means: np.ndarray, references: int) -> np.ndarray:
    """Leverage of each new run on a regression over the reference runs' means, (new,)."""
    design = np.column_stack([np.ones(len(means)), means])
    design[:, 1:] -= design[:references, 1:].mean(axis=0)
    inverse = np.linalg.pinv(design[:references].T @ design[:references], rcond=1e-10, hermitian=True)
    return np.einsum("ij,jk,ik->i", design[references:], inverse, design[references:])


def _fitted(others: np.ndarray, target: np.ndarray, rows: np.ndarray) -> np.ndarray:
    good = rows & np.isfinite(target) & np.isfinite(others).all(axis=1)
    design = np.column_stack([np.ones(good.sum()), others[good]])
    return np.linalg.lstsq(design, target[good], rcond=1e-8)[0]


def _mean_residual(others: np.ndarray, target: np.ndarray, rows: np.ndarray, gains: np.ndarray) -> float:
    good = rows & np.isfinite(target) & np.isfinite(others).all(axis=1)
    if not good.any():
        return float("nan")
    return float(np.mean(target[good] - np.column_stack([np.ones(good.sum()), others[good]]) @ gains))


def cusum(z: np.ndarray) -> tuple[float, int]:
    """Largest two-sided cumulative sum of standardised values, and where the excursion that reached it began."""
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


def residual_drift(residual_by_run: Sequence[float], scale: float) -> tuple[float, int]:
    """CUSUM of the champion's mean residual per new run, um, over the scatter that its held-out figures promise."""
    return cusum(np.asarray(residual_by_run) / max(scale, 1e-9))
