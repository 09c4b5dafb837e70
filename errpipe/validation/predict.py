"""Prediction of a controller, row by row, with an interval and whether the row is within the validity range.

Causal: row k uses rows up to k of its own run only, so every run is evaluated separately. A failed sensor
keeps its last value, as on a controller; before its first value nothing is predicted (deviation 0, without an
interval).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from pydantic import TypeAdapter

from errpipe.domain.driver import Driver, has_memory
from errpipe.domain.error_model import ErrorModel, Validity
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.errors import DataError
from errpipe.fitting.validity import LONGEST_HELD, distance

_DRIVER: TypeAdapter[Driver] = TypeAdapter(Driver)
INPUTS = (
    *("position", "command", "velocity", "acceleration", "feed", "spindle_speed", "temperature", "pressure"),
    *("humidity", "force", "load", "depth_of_cut", "overhang", "cut_length", "coolant", "direction"),
    *("current", "torque"),
)


@dataclass(frozen=True)
class Evaluated:
    """Component -> deviation, (rows,). outside: True where a table says that it fades, lacks an input or is beyond a
    profile, (rows,); None if no table was evaluated: then rows outside the validity range are.
    """

    values: Mapping[str, np.ndarray]
    outside: np.ndarray | None = None


Evaluate = Callable[[Recording], Evaluated]
Begin = Callable[[int], Evaluate]


@dataclass(frozen=True)
class Predictor:
    """A source of deviations for the rows of one run: a fitted model, a compiled table.

    evaluate: recording of one run -> deviations of its rows. half_width90: component -> half width of the
    90 % interval inside the validity range; widening90: added per range width outside; growth90: relative increase
    per unit predicted; factor90: its factor from the inputs. begin: from the number of available rows, the evaluator of
    a run that arrives in parts, in order; None if only whole runs can be evaluated.
    """

    evaluate: Evaluate
    components: tuple[str, ...]
    validity: Validity = field(default_factory=Validity)
    half_width90: Mapping[str, float] = field(default_factory=dict)
    widening90: Mapping[str, float] = field(default_factory=dict)
    growth90: Mapping[str, float] = field(default_factory=dict)
    factor90: Mapping[str, Driver] = field(default_factory=dict)
    begin: Begin | None = None

    @property
    def in_parts(self) -> bool:
        """Whether runs may arrive in parts."""
        return self.begin is not None and not any(map(has_memory, self.factor90.values()))

    def half_width(self, component: str, alone: Recording, value: np.ndarray, far: np.ndarray) -> np.ndarray:
        """Half width of the 90 % interval per row of one run, for a component that has one."""
        half = self.half_width90[component] * (1.0 + self.growth90.get(component, 0.0) * np.abs(value))
        if component in self.factor90:
            factor = drive(self.factor90[component], alone)
            half = half * np.where(np.isfinite(factor), factor, 1.0)
        return half + self.widening90.get(component, 0.0) * far


def of_model(model: ErrorModel) -> Predictor:
    from errpipe.fitting.components import evaluate  # a table needs no solver

    return of_evaluator(lambda recording: Evaluated(evaluate(model, recording)), model)


def of_evaluator(evaluator: Evaluate, model: ErrorModel, begin: Begin | None = None) -> Predictor:
    """Another evaluator (of the compiled table) with the intervals and the validity box of its model."""
    return Predictor(
        evaluator,
        tuple(c.component for c in model.components),
        model.validity,
        {c.component: c.half_width90 for c in model.components if c.half_width90 is not None},
        {c.component: c.widening90 for c in model.components},
        {c.component: c.growth90 for c in model.components},
        {c.component: _DRIVER.validate_python(c.factor90) for c in model.components if c.factor90 is not None},
        begin,
    )


def predict(
    model: ErrorModel | Predictor, recording: Recording, silent: MutableMapping[str, int] | None = None
) -> pd.DataFrame:
    """One row per row of the recording, in order: run, time, and four columns per response.

    NAME_predicted, NAME_lower, NAME_upper (90 %, empty where nothing is predicted, and where an input of a model that
    does not widen it outside the range is missing), in the response's unit, and NAME_outside (1 where the table fades,
    lacks an input or is beyond a profile, or an input has had no reading for too long; of a model without a table, 1
    outside the validity range). NAME is the response's column, or the component if the recording has no such response.
    silent: takes the number of rows without a reading, or with a stale one, of each affected input of the range.
    Raises DataError if the recording lacks a column that the model needs.
    """
    source = of_model(model) if isinstance(model, ErrorModel) else model
    (frame,) = _frames(source, [recording], lambda _: source.evaluate, silent)
    return frame


def predict_parts(
    source: Predictor, parts: Iterable[Recording], silent: MutableMapping[str, int] | None = None
) -> Iterator[pd.DataFrame]:
    """Likewise for a recording that arrives in parts, part by part: bit-identical for any partition.

    Runs may be cut anywhere and may alternate. Memory: a part, and a few kB per run. Raises ValueError if the
    source takes whole runs only (`in_parts`).
    """
    if source.begin is None or not source.in_parts:
        raise ValueError("the predictor takes whole runs only")
    return _frames(source, parts, source.begin, silent)


class _Run:
    """State of a run between two of its parts: its evaluator, the last value of each input, how many
    rows ago it was read, and the rows between that reading and the one before.
    """

    def __init__(self, evaluator: Evaluate):
        self.evaluate = evaluator
        self.last: dict[str, float] = {}
        self.read: dict[str, tuple[int, int]] = {}


def _frames(
    source: Predictor, parts: Iterable[Recording], begin: Begin, silent: MutableMapping[str, int] | None
) -> Iterator[pd.DataFrame]:
    silent = {} if silent is None else silent
    runs: dict[str, _Run] = {}
    before = 0
    for part in parts:
        _all_there(source, part)
        values = {c: np.zeros(len(part)) for c in source.components}
        half = {c: np.full(len(part), np.nan) for c in source.components}
        far, outside = np.zeros(len(part)), np.zeros(len(part), dtype=bool)
        codes, labels = part.run_codes(), part.run_labels()
        for code, rows in _rows_by_run(codes):
            label = labels[code] if code >= 0 else ""
            run = runs[label] = runs.get(label) or _Run(begin(len(part)))
            alone = part.take(rows)
            kept = held(alone, run.last)
            lately = _without_old(alone, kept, source.validity, run.read)
            far[rows] = distance(source.validity, lately)
            for name in source.validity.ranges:
                if missing := int(np.count_nonzero(np.isnan(lately.array(name)))):
                    silent[name] = silent.get(name, 0) + missing
            ever, now = _inputs_known(source, kept), _inputs_known(source, lately)
            evaluated = run.evaluate(kept)
            outside[rows] = far[rows] > 0 if evaluated.outside is None else evaluated.outside | ~_read(source, lately)
            for component, match in evaluated.values.items():
                values[component][rows] = match
                if component in source.half_width90:
                    predicted = np.where(np.isfinite(match), match, 0.0)
                    width = source.half_width(component, kept, predicted, far[rows])
                    known = ever if source.widening90.get(component) else now
                    # a table returns 0 if an input never had a value, which is no prediction
                    half[component][rows] = np.where(known & np.isfinite(match), width, np.nan)
        frame = _frame(source, part, values, half, outside)
        yield frame if part.name("time") is not None else frame.assign(time=frame["time"] + before)
        before += len(part)


def _inputs_known(source: Predictor, kept: Recording) -> np.ndarray | bool:
    """As `_read`; needed for an interval only."""
    return _read(source, kept) if source.half_width90 else True


def _read(source: Predictor, kept: Recording) -> np.ndarray:
    """Rows on which every input of the validity range has a value, (rows,)."""
    return np.isfinite(sum((kept.array(n) for n in source.validity.ranges), np.zeros(len(kept))))


def _rows_by_run(codes: np.ndarray) -> Iterator[tuple[int, Any]]:
    """Each run's number with its rows: a slice, which copies nothing, if they are consecutive."""
    if codes.size and (codes == codes[0]).all():
        yield int(codes[0]), slice(0, codes.size)
        return
    for code in np.flatnonzero(np.bincount(codes + 1)) - 1:
        rows = np.flatnonzero(codes == code)
        together = rows[-1] - rows[0] == rows.size - 1
        yield int(code), slice(int(rows[0]), int(rows[-1]) + 1) if together else rows


def held(recording: Recording, last: dict[str, float] | None = None) -> Recording:
    """Rows of one run with every input's last value held over gaps, and time that never decreases.

    last: the last values of the run's previous rows, by column; updated.
    """
    last = {} if last is None else last
    changes: dict[str, np.ndarray] = {}
    for role in INPUTS:
        for name in recording.names(role):
            values = recording.array(name)
            if np.isnan(values).any():
                values = changes[name] = _filled(values, last.get(name, np.nan))
            if not np.isnan(values[-1]):
                last[name] = float(values[-1])
    time = recording.name("time")
    if time is not None:
        t = recording.array(time)
        if not (t[0] >= last.get(time, -np.inf) and (t[1:] >= t[:-1]).all()):
            t = pd.Series(_filled(t, last.get(time, np.nan))).bfill().to_numpy()
            t = changes[time] = np.maximum(np.maximum.accumulate(t), last.get(time, -np.inf))
        if not np.isnan(t[-1]):
            last[time] = float(t[-1])
    return recording.with_values(changes)


def _without_old(alone: Recording, kept: Recording, validity: Validity, read: dict[str, tuple[int, int]]) -> Recording:
    """The held rows, without values of the validity range that are held for longer than the sensor's sampling interval.

    A temperature logged every tenth row is valid in between; one of a failed sensor is not. read: see `_Run`; updated.
    """
    old: dict[str, np.ndarray] = {}
    for name in validity.ranges:
        known = np.isfinite(alone.array(name))
        if known.size > 1 and known.all():
            read[name] = (0, 1)
            continue
        at = np.flatnonzero(known)
        steps = np.ones(at.size, dtype=np.int64)
        if name in read:
            at, steps = np.r_[-1 - read[name][0], at], np.r_[read[name][1], steps]
        steps[1:] = np.diff(at)
        if at.size:
            read[name] = (known.size - 1 - int(at[-1]), int(steps[-1]))
        if not known.all():
            row = np.arange(known.size)
            latest = np.searchsorted(at, row, side="right") - 1
            rows_ago, step = row - np.r_[at, 0][latest], np.r_[steps, 0][latest]
            old[name] = np.where((latest >= 0) & (rows_ago <= LONGEST_HELD * step), kept.array(name), np.nan)
    return kept.with_values(old) if old else kept


def _filled(values: np.ndarray, before: float) -> np.ndarray:
    """Gaps filled with the value before them; at the start with `before`."""
    return pd.Series(values).ffill().fillna(before).to_numpy(dtype=float)


def _all_there(source: Predictor, recording: Recording) -> None:
    missing = sorted(n for n in source.validity.ranges if n not in recording)
    if missing:
        listed = ", ".join(missing)
        raise DataError(f"predict: the recording has no column {listed}, which the model reads")


def _frame(
    source: Predictor,
    recording: Recording,
    values: Mapping[str, np.ndarray],
    half: Mapping[str, np.ndarray],
    outside: np.ndarray,
) -> pd.DataFrame:
    labels = pd.array(list(recording.run_labels()), dtype="str").take(recording.run_codes())
    out: dict[str, Any] = {"run": labels, "time": recording.time()}
    for component in source.components:
        name = recording.name("error", component=component) or component
        silent = ~np.isfinite(values[component])
        predicted = np.where(silent, 0.0, values[component]) if silent.any() else values[component]
        out[f"{name}_predicted"] = predicted
        out[f"{name}_lower"] = predicted - half[component]
        out[f"{name}_upper"] = predicted + half[component]
        out[f"{name}_outside"] = (outside | silent).astype(int)
    return pd.DataFrame(out, copy=False)
