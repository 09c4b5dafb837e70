"""What a failing sensor does to a compensation, with and without a guard: Fig. 10 of Ni (1997), in five ways.

Every sensor fails in turn, in every run, part way through it. Three cases, as in the figure: no failure;
failure with the reading recovered from the other sensors; failure without.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np
from sensor_watch import watch as watched

from errpipe.domain.recording import FrozenModel, Recording
from errpipe.guard.description import SensorGuard

Way = Literal["dead", "stuck", "drift", "step", "swap"]
WAYS: tuple[Way, ...] = ("dead", "stuck", "drift", "step", "swap")
START = 0.4  # of a run: it has warmed up, and long hours are left
DRIFT = 2.0  # K/h
STEP = 5.0  # K


class Trial(FrozenModel):
    """One sensor failing in one way. Rows are the recording's own cycles; rms over the rows after the failure."""

    sensor: str
    way: Way
    beside: str = ""
    runs: int
    detected: int
    rows_to_detect: float | None
    wrongly_blamed: int
    reading_off: float
    healthy: float
    recovered: float
    unguarded: float

    @property
    def ratio(self) -> float:
        """Residual with the guard over the residual without a failure."""
        return self.recovered / self.healthy


def trials(
    recording: Recording,
    guard: SensorGuard,
    predict: Callable[[Recording], np.ndarray],
    measured: np.ndarray,
    ways: Sequence[Way] = WAYS,
    drift: float = DRIFT,
    step: float = STEP,
    start: float = START,
) -> Iterator[Trial]:
    """Fail each guarded sensor in each way.

    predict: the compensation's deviation for a recording, shape (rows,); measured: the deviation it is held
    against. drift: K/h; step: K; start: of a run. `wrongly_blamed` counts runs in which a healthy sensor was blamed
    too, or instead.
    """
    late = rows_after(recording, start)
    healthy = _rms(measured - predict(recording), late)
    names = guard.names()
    for way in ways:
        for i, name in enumerate(names):
            beside = names[(i + 1) % len(names)] if way == "swap" else ""
            failed = fail(recording, name, way, beside=beside, drift=drift, step=step, start=start)
            seen = watched(guard, failed)
            restored = Recording(
                failed.manifest, failed.frame.assign(**{n: seen.reading[:, k] for k, n in enumerate(names)})
            )
            guilty = [k for k, n in enumerate(names) if n in (name, beside)]
            figures_of_case = _found(recording, seen.fault, late, guilty)
            off = failed.array(name) - recording.array(name)
            yield Trial(
                sensor=name,
                way=way,
                beside=beside,
                **figures_of_case,
                reading_off=_rms(off, late),
                healthy=healthy,
                recovered=_rms(measured - predict(restored), late),
                unguarded=_rms(measured - predict(failed), late),
            )


def fail(
    recording: Recording,
    name: str,
    way: Way,
    *,
    beside: str = "",
    drift: float = DRIFT,
    step: float = STEP,
    start: float = START,
) -> Recording:
    """The recording with one sensor failing in every run from the share `start` of it on.

    dead: reads 0. stuck: holds its last reading. drift: K/h. step: K. swap: reads what `beside` should, and
    the other way round.
    """
    x = recording.array(name).copy()
    columns = {name: x}
    t, run = recording.time(), recording.run_codes()
    late = rows_after(recording, start)
    for code in np.unique(run):
        rows = np.flatnonzero(late & (run == code))
        if not rows.size:
            continue
        if way == "dead":
            x[rows] = 0.0
        elif way == "stuck":
            x[rows] = x[rows[0]]
        elif way == "drift":
            x[rows] += drift * (t[rows] - t[rows[0]]) / 3600
        elif way == "step":
            x[rows] += step
    if way == "swap":
        y = recording.array(beside).copy()
        columns = {name: np.where(late, y, x), beside: np.where(late, x, y)}
    return Recording(recording.manifest, recording.frame.assign(**columns))


def rows_after(recording: Recording, start: float = START) -> np.ndarray:
    """Mask (rows,) of the rows after the failure."""
    run = recording.run_codes()
    late = np.zeros(run.size, dtype=bool)
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        late[rows[int(start * rows.size) :]] = True
    return late


def _found(recording: Recording, fault: np.ndarray, late: np.ndarray, guilty: list[int]) -> dict[str, float | None]:
    run = recording.run_codes()
    after, wrong = [], 0
    for code in np.unique(run):
        seen = fault[late & (run == code)]
        told = np.flatnonzero(seen[:, guilty].any(axis=1))
        after += [int(told[0])] if told.size else []
        wrong += bool(np.delete(seen, guilty, axis=1).any())
    first = float(np.median(after)) if after else None
    runs = int(np.unique(run).size)
    return {"runs": runs, "detected": len(after), "rows_to_detect": first, "wrongly_blamed": wrong}


def _rms(values: np.ndarray, rows: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values[rows] ** 2)))
