"""Multirate recordings read batch by batch: temperatures sampled less often than the rows, held between readings.

One pass determines the usual interval of the readings of each such sensor, and the first reading of every run, which
is used for the rows before it. Every later pass holds the last reading of a run across batches.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from errpipe.domain.batch import Batch
from errpipe.domain.recording import Recording
from errpipe.fitting.source import Source, stretches
from errpipe.fitting.validity import LONGEST_HELD


@dataclass
class _Sensor:
    """steps: rows from one reading to the next -> how often; last: row of the latest reading, -1 before any.

    first: run -> (row within the run, value) of its first reading, degC.
    """

    steps: Counter[int] = field(default_factory=Counter)
    first: dict[str, tuple[int, float]] = field(default_factory=dict)
    last: int = -1

    def rows_between(self) -> int:
        """Usual number of rows from one reading to the next: their median, rounded down; at least 1."""
        steps, counts = np.array(sorted(self.steps.items()), dtype=np.int64).reshape(-1, 2).T
        if not steps.size:
            return 1
        middle = np.array([(counts.sum() - 1) // 2, counts.sum() // 2])
        return max(int(steps[np.searchsorted(np.cumsum(counts), middle, side="right")].mean()), 1)


def held(source: Source) -> Source:
    """The source with multirate temperatures held as `thermal.arithmetic.short_gaps_held` holds them in memory."""
    sensors = _joined(source, [n for n in source.ends.names("temperature") if n not in source.complete])
    limits = {n: LONGEST_HELD * s.rows_between() for n, s in sensors.items() if s.rows_between() > 1}
    if not limits:
        return source
    return source.mapped(partial(_holding, {n: sensors[n] for n in limits}, limits))


def _joined(source: Source, names: Sequence[str]) -> dict[str, _Sensor]:
    """Result of one pass for each sensor: of all parts."""
    sensors = {n: _Sensor() for n in names}
    for part in source.over(_survey, names) if names else ():
        for name, sensor in part.items():
            sensors[name].steps.update(sensor.steps)
            sensors[name].first.update(sensor.first)
    return sensors


def _holding(sensors: dict[str, _Sensor], limits: dict[str, int], source: Source) -> Source:
    """A part with the readings of some sensors held for at most a given number of rows."""

    def batches(names: Sequence[str] | None = None, **options: Any) -> Iterator[Recording]:
        kept = [n for n in limits if names is None or n in names]
        read = source.batches(names, **options)
        return _held(read, {n: (sensors[n], limits[n]) for n in kept}) if kept else read

    return replace(source, batches=batches)


def _survey(source: Source, names: Sequence[str]) -> dict[str, _Sensor]:
    """Result of one pass for each sensor."""
    sensors = {n: _Sensor() for n in names}
    at, begin, current = 0, 0, None
    for batch in source.batches([*source.manifest.names("run"), *names]):
        known = {n: np.flatnonzero(~np.isnan(batch.array(n))) for n in names}
        for run, first, end in stretches(batch):
            if run != current:
                begin, current = at + first, run
            for name, sensor in sensors.items():
                row = int(np.searchsorted(known[name], first))
                if run not in sensor.first and row < known[name].size and known[name][row] < end:
                    row = int(known[name][row])
                    sensor.first[run] = (at + row - begin, float(batch.array(name)[row]))
        for name, sensor in sensors.items():
            rows = known[name] + at
            if rows.size:
                before = rows[:1] if sensor.last < 0 else np.array([sensor.last])
                steps, counts = np.unique(np.diff(rows, prepend=before), return_counts=True)
                sensor.steps.update({s: c for s, c in zip(steps.tolist(), counts.tolist(), strict=True) if s})
                sensor.last = int(rows[-1])
        at += len(batch)
    return sensors


def _held(batches: Iterator[Recording], sensors: dict[str, tuple[_Sensor, int]]) -> Iterator[Recording]:
    """The batches with the readings of some sensors held for at most a given number of rows."""
    in_run, current = 0, None
    latest: dict[str, tuple[int, float]] = {}  # row within the run, and value, of the last reading before a stretch
    for batch in batches:
        columns = {n: batch.array(n).copy() for n in sensors}
        for run, first, end in stretches(batch):
            if run != current:
                in_run, current, latest = 0, run, {}
            row = in_run + np.arange(end - first)
            for name, (sensor, limit) in sensors.items():
                before, first_reading = latest.get(name, (-1, np.nan)), sensor.first.get(run, (0, np.nan))
                filled, latest[name] = _held_values(columns[name][first:end], row, before, first_reading, limit)
                columns[name][first:end] = filled
            in_run += end - first
        yield _with(batch, columns)


def _held_values(
    values: np.ndarray, row: np.ndarray, before: tuple[int, float], first: tuple[int, float], limit: int
) -> tuple[np.ndarray, tuple[int, float]]:
    """A stretch of a run with each reading held for at most `limit` rows, (rows,), and the last reading in it.

    row: within the run, (rows,). before, first: row and value of the reading before the stretch and of the run's first
    one, which is used for the rows before it.
    """
    known = np.flatnonzero(~np.isnan(values))
    rows, readings = np.r_[before[0], row[known]], np.r_[before[1], values[known]]
    latest = np.searchsorted(rows, row, side="right") - 1
    filled = np.where(row - rows[latest] <= limit, readings[latest], np.nan)
    filled[(row < first[0]) & (first[0] - row <= limit)] = first[1]
    return filled, (int(rows[-1]), float(readings[-1]))


def _with(batch: Recording, columns: dict[str, np.ndarray]) -> Recording:
    """The batch with other values, and with the state after the rows before it."""
    if isinstance(batch, Batch):
        return Batch(batch.manifest, batch.columns | columns, len(batch), batch.past)
    return batch.with_columns(columns, {})
