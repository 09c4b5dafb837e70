"""Watching a recording with a sensor guard: faults and guarded readings, as a compiled table makes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.drivers.shared import drive_all
from errpipe.guard import description as g
from errpipe.guard import detect, replace


@dataclass(frozen=True)
class Watch:
    """What a guard made of a recording. Arrays have shape (rows, sensors), sensors in the guard's order."""

    names: tuple[str, ...]
    fault: np.ndarray
    reading: np.ndarray


def watch(guard: g.SensorGuard, recording: Recording) -> Watch:
    """Faults (bool) and guarded readings, row by row and causal: as the compiled drivers do it."""
    conditioned, impossible = _conditioned(guard, recording)
    count = len(guard.sensors)
    values = drive_all([*detect.faults(guard), *replace.readings(guard)], conditioned)
    return Watch(guard.names(), (values[:, :count] > 0.5) | impossible, values[:, count:])


def faults(guard: g.SensorGuard, recording: Recording) -> np.ndarray:
    """Which readings are rejected, shape (rows, sensors): `watch` without the readings that stand in."""
    conditioned, impossible = _conditioned(guard, recording)
    return (drive_all(detect.faults(guard), conditioned) > 0.5) | impossible


def _conditioned(guard: g.SensorGuard, recording: Recording) -> tuple[Recording, np.ndarray]:
    """Readings as a table's inputs give them on: what is empty, impossible or racing holds the one before."""
    columns, doubted = {}, []
    run, t = sessions(recording), recording.time()
    for s in guard.sensors:
        values, doubt = _believed(recording.array(s.name), run, t, s)
        columns[s.name] = values
        doubted.append(doubt)
    return Recording(recording.manifest, recording.frame.assign(**columns)), np.column_stack(doubted)


def _believed(x: np.ndarray, run: np.ndarray, t: np.ndarray, s: g.GuardedSensor) -> tuple[np.ndarray, np.ndarray]:
    out, doubt = x.copy(), np.zeros(x.size, dtype=bool)
    if _all_possible(x, run, t, s):
        return out, doubt
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


def _all_possible(x: np.ndarray, run: np.ndarray, t: np.ndarray, s: g.GuardedSensor) -> bool:
    slow_enough = np.abs(np.diff(x)) <= s.max_rate * np.maximum(np.diff(t), 1e-9)
    return bool(np.all((x >= s.low) & (x <= s.high)) and np.all(slow_enough | (np.diff(run) != 0)))
