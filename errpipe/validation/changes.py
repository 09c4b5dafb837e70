"""Difference between two compensations, evaluated at the same states of a machine over both validity ranges.

Half of the states are uniform (the rms is theirs), half favour the ends of each range. Each is a separate
run: the machine rests in the middle of the range (axes anywhere, so that it is approached from both
sides), steps to the state, and stays there; both are evaluated 1 s, 1 min, 10 min, 1 h, 10 h and 30 years later.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.domain.table import CompensationTable
from errpipe.fitting.components import evaluate
from errpipe.guard.in_table import without_guard
from errpipe.tables import batch

AFTER = np.array([0.0, 1.0, 60.0, 600.0, 3600.0, 36000.0, 1e9])  # s after the jump; the first row is before it
STATES = 4000  # a bump of 1/200 of the travel is missed by all of them in 1 of 10^6 comparisons
ENDS = 0.15  # share of the second half at each end of a range: corners of a box of five inputs are then among them
MOVING = ("position", "command", "actual", "direction")  # roles of the columns of a moving axis
BINS = 10  # parts of an input's range in which differences are averaged

Range = tuple[float, float]
Bins = tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True)
class Compensation:
    """A model or table as a function of readings.

    roles: input -> role (of a recording or of a table's input); ranges: input -> validity; units: response -> unit;
    relative: whether it counts from the start of each run; axes: input -> axis, of positions and directions.
    """

    roles: Mapping[str, str]
    ranges: Mapping[str, Range]
    units: Mapping[str, str]
    values: Callable[[States], Mapping[str, np.ndarray]]
    relative: bool = False
    axes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class States:
    """Runs of a machine: readings by input, (rows,); time in s; run number of each row."""

    readings: Mapping[str, np.ndarray]
    time: np.ndarray
    run: np.ndarray


@dataclass(frozen=True)
class Change:
    """Difference of one response, in its unit. at: readings where it is largest; settled: the largest difference
    in steady state, unlike that of two compensations with different time constants.

    goes_with: the input that explains most of the difference, with its share of the variance; by_bin: the input's
    value, and mean, smallest and largest difference in each part of its range.
    """

    component: str
    unit: str
    largest: float
    rms: float
    at: Mapping[str, float]
    old: float
    new: float
    goes_with: str
    share: float
    by_bin: Bins
    settled: float = 0.0


@dataclass
class Comparison:
    """kind: of what. lines: sentences. parts: plain data. largest, rms: um (urad, N), None without a figure.

    changes, findings: what is drawn; of a finding its name, its size before and after, um rms.
    """

    kind: str
    lines: list[str] = field(default_factory=list)
    parts: dict[str, Any] = field(default_factory=dict)
    largest: float | None = None
    rms: float | None = None
    changes: list[tuple[str, Change]] = field(default_factory=list)
    findings: list[tuple[str, float, float]] = field(default_factory=list)

    def widen(self, largest: float, rms: float) -> None:
        """Widen the figures by those of one part."""
        self.largest, self.rms = max(self.largest or 0.0, largest), max(self.rms or 0.0, rms)


def of_model(model: ErrorModel) -> Compensation:
    """An error model without the fade outside validity."""
    kinds = {name: Column.model_validate(facts) for name, facts in model.columns.items()}

    def values(states: States) -> Mapping[str, np.ndarray]:
        columns = {"run": Column(role="run"), "t": Column(role="time", unit="s"), **kinds}
        readings = {n: states.readings[n] for n in kinds}
        frame = pd.DataFrame({"run": states.run.astype(str), "t": states.time, **readings})
        manifest = Manifest(recording=1, tables=("states.csv",), columns=columns, constants=model.constants)
        return evaluate(model, Recording(manifest, frame))

    ranges = {name: model.validity.ranges.get(name, (0.0, 1.0)) for name in kinds}
    units = {c.component: c.unit for c in model.components}
    axes = {n: k.axis for n, k in kinds.items() if k.axis}
    return Compensation({n: k.role for n, k in kinds.items()}, ranges, units, values, model.datum == "run_start", axes)


def of_table(table: CompensationTable) -> Compensation:
    """A table as a controller runs it with healthy sensors: the deviation of each of its outputs.

    Without the sensor guard, which treats states that jump and settle as faults.
    """
    table = without_guard(table)

    def values(states: States) -> Mapping[str, np.ndarray]:
        columns = {i.name: states.readings[i.name] for i in table.inputs}
        return batch.evaluate(table, columns, states.time, states.run).deviation

    ranges = {i.name: i.valid or _profile_span(table, i.name) or (i.default, i.default) for i in table.inputs}
    units = {o.name: o.unit for o in table.outputs}
    axes = {i.name: i.axis for i in table.inputs if i.axis}
    return Compensation({i.name: i.kind for i in table.inputs}, ranges, units, values, axes=axes)


def _profile_span(table: CompensationTable, name: str) -> Range | None:
    own = [p for p in table.profiles if p.input == name]
    return (min(p.start for p in own), max(p.end for p in own)) if own else None


def one_axis_one_name(old: Compensation, new: Compensation) -> tuple[Compensation, dict[str, str]]:
    """The new one with the old one's names for positions and directions of the same axis; new name -> old name.

    An axis has one position, whatever its column is named: at two positions, two equal compensations would differ.
    """
    names = {}
    for name, place in ((n, _place(new, n)) for n in new.roles if n not in old.roles):
        same = [[n for n in c.roles if _place(c, n) == place] for c in (old, new)]
        if place is not None and [len(s) for s in same] == [1, 1] and same[0][0] not in new.roles:
            names[name] = same[0][0]
    if not names:
        return new, {}

    def values(states: States) -> Mapping[str, np.ndarray]:
        own = {name: states.readings[other] for name, other in names.items()}
        return new.values(replace(states, readings={**states.readings, **own}))

    roles, axes = ({names.get(n, n): v for n, v in d.items()} for d in (new.roles, new.axes))
    ranges = {names.get(n, n): v for n, v in new.ranges.items()}
    return replace(new, roles=roles, ranges=ranges, axes=axes, values=values), names


def _place(of: Compensation, name: str) -> tuple[bool, str] | None:
    """Whether an input is a direction, and its axis; None if it is neither position nor direction."""
    role = of.roles[name]
    return (role == "direction", of.axes[name]) if role in MOVING and name in of.axes else None


def draw(old: Compensation, new: Compensation, seed: int = 1) -> States:
    """States over the union of both validity ranges."""
    rng = np.random.default_rng(seed)
    roles = {**old.roles, **new.roles}
    readings = {}
    for name in sorted(roles):
        spans = [c.ranges[name] for c in (old, new) if name in c.ranges]
        low, high = min(s[0] for s in spans), max(s[1] for s in spans)
        state, before = (_random_values(rng, roles[name], low, high) for _ in range(2))
        first = before if roles[name] in MOVING else np.full(STATES, (low + high) / 2)
        readings[name] = np.column_stack([first, *[state] * (AFTER.size - 1)]).ravel()
    return States(readings, np.tile(AFTER, STATES), np.repeat(np.arange(STATES), AFTER.size))


def _random_values(rng: np.random.Generator, role: str, low: float, high: float) -> np.ndarray:
    if role == "direction":
        return np.where(rng.random(STATES) < 0.5, 1.0, -1.0)
    ends, inside = rng.random(STATES), rng.uniform(low, high, STATES)
    ends[: STATES // 2] = 0.5
    values = np.where(ends < ENDS, low, np.where(ends > 1.0 - ENDS, high, inside))
    return np.round(values) if role == "coolant" else values


def compare(old: Compensation, new: Compensation, seed: int = 1) -> list[Change]:
    """One change per response of either; a response missing in one is zero there."""
    states = draw(old, new, seed)
    before, after = (_values_at(c, states, old.relative or new.relative) for c in (old, new))
    units = {**old.units, **new.units}
    zero = np.zeros(states.run.size)
    return [_change(name, units[name], states, before.get(name, zero), after.get(name, zero)) for name in units]


def _values_at(of: Compensation, states: States, relative: bool) -> Mapping[str, np.ndarray]:
    values = of.values(states)
    if not relative or of.relative:
        return values
    return {name: v - np.repeat(v[:: AFTER.size], AFTER.size) for name, v in values.items()}


def _change(component: str, unit: str, states: States, old: np.ndarray, new: np.ndarray) -> Change:
    judged = np.flatnonzero(np.tile(AFTER > 0, STATES) & np.isfinite(old) & np.isfinite(new))
    difference = (new - old)[judged]
    if difference.size == 0:
        return Change(component, unit, 0.0, 0.0, {}, 0.0, 0.0, "", 0.0, ())
    worst = int(judged[np.argmax(np.abs(difference))])
    name, share, bins = _best_correlated_input({n: v[judged] for n, v in states.readings.items()}, difference)
    at = {n: float(v[worst]) for n, v in states.readings.items()}
    at["seconds after a step"] = float(states.time[worst])
    uniform = difference[judged < STATES // 2 * AFTER.size]
    rms = float(np.sqrt(np.mean(uniform**2))) if uniform.size else 0.0
    last = np.abs(difference[judged % AFTER.size == AFTER.size - 1])
    largest, settled = float(np.abs(difference).max()), float(last.max(initial=0.0))
    values = float(old[worst]), float(new[worst])
    return Change(component, unit, largest, rms, at, *values, name, share, bins, settled)


def _best_correlated_input(readings: Mapping[str, np.ndarray], gap: np.ndarray) -> tuple[str, float, Bins]:
    """The input with the largest correlation ratio (Pearson 1905) to the difference, and the difference over it."""
    best: tuple[str, float, Bins] = ("", -1.0, ())
    total = float(np.var(gap))
    for name, values in readings.items():
        span = float(np.ptp(values))
        if not span > 0.0:  # one value, or empty cells
            continue
        part = np.minimum(((values - values.min()) / span * BINS).astype(int), BINS - 1)
        rows: Sequence[np.ndarray] = [gap[part == k] for k in range(BINS)]
        middle = [float(values[part == k].mean()) if r.size else 0.0 for k, r in enumerate(rows)]
        between = sum(r.size * (float(r.mean()) - float(gap.mean())) ** 2 for r in rows if r.size) / gap.size
        share = between / total if total > 0.0 else 0.0  # of a constant shift: assigned to the first input
        if share > best[1]:
            filled = [(m, r) for m, r in zip(middle, rows, strict=True) if r.size]
            bins = tuple((m, float(r.mean()), float(r.min()), float(r.max())) for m, r in filled)
            best = (name, share, bins)
    return best[0], max(best[1], 0.0), best[2]


def rows_changed(old: Recording, new: Recording) -> dict[str, dict[str, float]]:
    """Numeric column -> number of different rows, largest and rms difference, over the common runs.

    A run is common if its label and its number of rows are equal in both.
    """
    labels = shared_runs(old, new)
    columns = [n for n in old.frame.columns if n in new.frame.columns and pd.api.types.is_numeric_dtype(old.frame[n])]
    before, after = (_rows_of(r, labels) for r in (old, new))
    out = {}
    for name in columns:
        a, b = (part[name].to_numpy(dtype=float) for part in (before, after))
        differ = ~((a == b) | (np.isnan(a) & np.isnan(b)))
        difference = np.abs(b - a)[differ]
        difference = difference[np.isfinite(difference)]
        if differ.any():
            largest = float(difference.max()) if difference.size else 0.0
            rms = float(np.sqrt(np.sum(difference**2) / a.size))
            out[name] = {"rows": int(differ.sum()), "largest": largest, "rms": rms}
    return out


def of_rows(old: Recording, new: Recording, name: str) -> Change:
    """Difference of a column of deviations over the rows of the common runs, in its unit.

    It may correlate with a numeric column of the old recording, or with the run number there, from 1.
    """
    labels = shared_runs(old, new)
    before, after = (_rows_of(r, labels) for r in (old, new))
    unit = old.manifest.columns[name].unit or ""
    a, b = (part[name].to_numpy(dtype=float) for part in (before, after))
    judged = np.flatnonzero(np.isfinite(b - a))
    if judged.size == 0:
        return Change(name, unit, 0.0, 0.0, {}, 0.0, 0.0, "", 0.0, ())
    readings = _readings_of(old, before, labels)
    gap = (b - a)[judged]
    worst, largest = int(judged[np.argmax(np.abs(gap))]), float(np.abs(gap).max())
    goes_with = _best_correlated_input({n: v[judged] for n, v in readings.items()}, gap)
    at = {n: float(v[worst]) for n, v in readings.items()}
    rms = float(np.sqrt(np.mean(gap**2)))
    return Change(name, unit, largest, rms, at, float(a[worst]), float(b[worst]), *goes_with, settled=largest)


def _readings_of(recording: Recording, rows: pd.DataFrame, labels: Sequence[str]) -> dict[str, np.ndarray]:
    """Candidate inputs for a difference, in the rows of runs: the run number, and every numeric column, (rows,)."""
    numbers = {label: float(k) for k, label in enumerate(recording.run_labels(), 1)}
    of_run = np.sort(_labels(recording)[np.isin(_labels(recording), labels)], kind="stable")
    readings = {"run number": np.array([numbers[label] for label in of_run])}
    for name, column in recording.manifest.columns.items():
        no_cause = column.role in ("run", "group", "error", "simulated", "ignore")
        if name in rows and not no_cause and pd.api.types.is_numeric_dtype(rows[name]):
            readings[name] = rows[name].to_numpy(dtype=float)
    return readings


def shared_runs(old: Recording, new: Recording) -> list[str]:
    """Labels of the runs that have equally many rows in both."""
    counts = [dict(zip(*np.unique(_labels(r), return_counts=True), strict=True)) for r in (old, new)]
    return [label for label in dict.fromkeys(_labels(old)) if counts[0][label] == counts[1].get(label)]


def _labels(recording: Recording) -> np.ndarray:
    return np.asarray(recording.run_labels(), dtype=str)[recording.run_codes()]


def _rows_of(recording: Recording, labels: Sequence[str]) -> pd.DataFrame:
    run_labels = _labels(recording)
    chosen = np.flatnonzero(np.isin(run_labels, labels))
    return recording.frame.iloc[chosen[np.argsort(run_labels[chosen], kind="stable")]]
