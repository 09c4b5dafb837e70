"""Watching a recording with a sensor guard: faults and guarded readings, as a compiled table makes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.sessions import sessions
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
    values = evaluate([*detect.faults(guard), *replace.readings(guard)], conditioned)
    return Watch(guard.names(), (values[:, :count] > 0.5) | impossible, values[:, count:])


def faults(guard: g.SensorGuard, recording: Recording) -> np.ndarray:
    """Which readings are not believed, shape (rows, sensors): `watch` without the readings that stand in."""
    conditioned, impossible = _conditioned(guard, recording)
    return (evaluate(detect.faults(guard), conditioned) > 0.5) | impossible


def evaluate(drivers: Sequence[d.Driver], recording: Recording) -> np.ndarray:
    """`drive` of several drivers with much in common, each part once; shape (rows, drivers)."""
    values = _Values(recording)
    walked: dict[int, str] = {}  # by identity: the drivers are alive as long as this function runs
    known: dict[d.Driver, str] = {}

    def name(driver: d.Driver) -> str:
        if id(driver) not in walked:
            walked[id(driver)] = driver.name if isinstance(driver, d.Input) else flat(driver)
        return walked[id(driver)]

    def flat(driver: d.Driver) -> str:
        of = getattr(driver, "of", None)
        if isinstance(of, tuple):
            driver = driver.model_copy(update={"of": tuple(d.Input(name=name(child)) for child in of)})
        elif of is not None:
            driver = driver.model_copy(update={"of": d.Input(name=name(of))})
        if driver not in known:
            known[driver] = f"#{len(known)}"
            values[known[driver]] = drive(driver, values)  # type: ignore[arg-type]
        return known[driver]

    return np.column_stack([values.array(name(driver)) for driver in drivers])


class _Values(dict[str, np.ndarray]):
    """Columns by name, beside the runs and times of a recording: as much of one as `drive` looks at."""

    between = "held"  # a control knows no more than its last reading

    def __init__(self, recording: Recording):
        super().__init__()
        self.recording = recording

    def __len__(self) -> int:
        return len(self.recording)

    def array(self, name: str) -> np.ndarray:
        return self[name] if name in self else self.recording.array(name)

    def name(self, role: str) -> str | None:
        return self.recording.name(role)

    def run_codes(self) -> np.ndarray:
        return self.recording.run_codes()

    def time(self) -> np.ndarray:
        return self.recording.time()


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
