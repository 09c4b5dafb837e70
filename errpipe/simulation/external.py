"""What another simulation says of a recording, row by row: the `simulated` twins that a diagnosis compares with.

    recorded      the columns of role simulated that the recording already has
    csv           a file of simulated values over time, interpolated linearly inside a run, never beyond its ends
    error_model   errpipe's own fitted model, evaluated causally on the recording's columns
    fmu           a Functional Mock-up Unit, run over the recorded inputs (see `fmu`)

Simulated values become deviations (actual minus commanded) in the response's own unit. What has no simulated value
(outside the file's time, inside a gap, an input missing) stays empty and is reported; where that is more than
`most_missing` of the recorded rows, the twin is refused.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from errpipe.domain import units
from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Recording
from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.simulation.fmu import FmuOptions
from errpipe.yamlfile import Options

FIRST_READINGS = 3  # whose mean is a run's zero where the datum is its start: one alone would add its noise to all
GAP_STEPS = 10.0  # a step of the file this many times its usual one is a gap, unless it is said otherwise (from taste)
SHOWN = 5  # gaps listed by place; the others are only counted

Progress = Callable[[float, str], None]


class _Twins(Options):
    """What every source of twins can be told."""

    datum: Literal["absolute", "run_start"] | None = Field(
        None,
        description="What zero means: as simulated, or each run's first readings; default: absolute, and for an error "
        "model what the model says.",
    )
    most_missing: float = Field(
        0.1,
        ge=0,
        lt=1,
        description="Refuse a twin that leaves more than this share of the recorded rows empty.",
        json_schema_extra={"unit": "1"},
    )


class FromRecorded(_Twins):
    """The recording holds its simulated columns already."""

    kind: Literal["recorded"]


class CsvColumn(Options):
    """One column of a CSV file of simulated values."""

    column: str = Field(description="Name in the file's header.")
    unit: str = Field(description="Unit of the file's values: um, mm, nm, urad, mrad, arcsec or N.")
    means: Literal["deviation", "correction"] = Field(
        "deviation", description="Actual minus commanded, or its negative."
    )


class FromCsv(_Twins):
    """A CSV file (a header row, then numbers) of simulated values over time."""

    kind: Literal["csv"]
    columns: dict[str, CsvColumn] = Field(min_length=1, description="Response of the recording -> column of the file.")
    time: str = Field("t", description="Column of the file with the time, on the recording's clock.")
    time_unit: Literal["s", "ms", "min", "h", "d"] = Field("s", description="Its unit.")
    run: str | None = Field(
        None, description="Column with the run's label; needed where the recording's runs overlap in time."
    )
    separator: Literal[",", ";", "\t"] = Field(",", description="What stands between two cells.")
    longest_gap: float | None = Field(
        None,
        gt=0,
        description="Nothing is interpolated over a longer step; default: ten usual steps.",
        json_schema_extra={"unit": "s"},
    )


class FromModel(_Twins):
    """errpipe's own error model: the one in `file`, or the one of the fit stage before."""

    kind: Literal["error_model"]


class FromFmu(_Twins, FmuOptions):
    """A Functional Mock-up Unit in `file`, run in a process of its own."""

    kind: Literal["fmu"]


AnySource = Annotated[FromRecorded | FromCsv | FromModel | FromFmu, Field(discriminator="kind")]


@dataclass(frozen=True)
class Twin:
    """How one response got its twin. rows: recorded ones; missing: of these, why they have no simulated value."""

    component: str
    column: str
    unit: str
    source: str
    rows: int
    with_twin: int
    missing: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def plain(self) -> dict[str, Any]:
        """Plain data for `twin.json`."""
        return {
            "component": self.component,
            "column": self.column,
            "unit": self.unit,
            "source": self.source,
            "rows": self.rows,
            "with_twin": self.with_twin,
            "missing": dict(self.missing),
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class Values:
    """Simulated values of one response, (rows,), in the response's unit; why: reason -> rows without a value."""

    values: np.ndarray
    source: str
    why: Mapping[str, np.ndarray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    datum: str = "absolute"


def with_twins(
    recording: Recording,
    how: FromRecorded | FromCsv | FromModel | FromFmu,
    file: Path | None = None,
    model: ErrorModel | None = None,
    progress: Progress = lambda share, text: None,
) -> tuple[Recording, list[Twin], dict[str, Any]]:
    """The recording with a simulated column beside each response, how each came about, and a source's own figures.

    file: the CSV or the FMU; model: the error model. Raises UsageError where the source lacks what it needs,
    DataError where simulated values and recording do not fit together.
    """
    extra: dict[str, Any] = {}
    match how:
        case FromRecorded():
            found = _recorded(recording)
        case FromCsv():
            found = _csv(recording, how, _needed(file, "a CSV file"))
        case FromModel():
            if model is None:
                raise UsageError("twin: no error model: name a file, or let a fit stage stand before it")
            found = _model(recording, model)
        case FromFmu():
            from errpipe.simulation import fmu

            ran = fmu.run(recording, how, _needed(file, "an FMU"), progress)
            found = {
                c: Values(v, ran.source, {"not finite": ~np.isfinite(v)}, ran.notes) for c, v in ran.values.items()
            }
            extra = ran.figures
    twins = []
    for component, simulated in found.items():
        recording, twin = _placed(recording, component, simulated, how)
        twins.append(twin)
    return recording, twins, extra


def by_name(recording: Recording, file: Path) -> FromCsv | FromModel | FromFmu:
    """How to read a simulation's file when only its name is given: what is called alike belongs together.

    .csv: the time column is called as in the recording (or t, time), a response's column EXX, EXX_sim or as its error
    column (with _sim); .json: an error model; .fmu: see `fmu.by_name`. Units are the recording's own where the file
    states none. Raises DataError where nothing is called alike.
    """
    match Path(file).suffix.lower():
        case ".csv":
            return _csv_by_name(recording, Path(file))
        case ".json":
            return FromModel(kind="error_model")
        case ".fmu":
            from errpipe.simulation import fmu

            return FromFmu(kind="fmu", **fmu.by_name(recording, Path(file)))
    raise DataError(f"{Path(file).name}: a simulation is a .csv, an error model (.json) or an .fmu")


def names_of(recording: Recording, component: str) -> tuple[str, ...]:
    """What a response's simulated values may be called elsewhere."""
    error = error_column(recording, component)
    return (f"{error}_sim", f"{component}_sim", component, error)


def _csv_by_name(recording: Recording, file: Path) -> FromCsv:
    import csv

    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            header = [name.strip() for name in next(csv.reader(stream), [])]
    except (OSError, UnicodeDecodeError) as err:
        raise DataError(f"{file.name}: not a CSV table: {type(err).__name__}") from None
    clock = next((n for n in (recording.name("time"), "t", "time") if n in header), None)
    if clock is None:
        raise DataError(f"{file.name}: needs a time column (found {', '.join(header) or 'nothing'})")
    columns = {}
    for component in recording.components():
        name = next((n for n in names_of(recording, component) if n in header), None)
        if name is not None:
            unit = recording.manifest.columns[error_column(recording, component)].unit or "um"
            columns[component] = CsvColumn(column=name, unit=unit)
    if not columns:
        told = ", ".join(recording.components())
        raise DataError(f"{file.name}: no column for any response of the recording ({told}; found {', '.join(header)})")
    run = recording.name("run")
    return FromCsv(kind="csv", time=clock, run=run if run in header else None, columns=columns)


def _needed(file: Path | None, what: str) -> Path:
    if file is None:
        raise UsageError(f"twin: `file` is missing: the path of {what}")
    return Path(file)


def error_column(recording: Recording, component: str) -> str:
    """Name of a response's column. Raises DataError naming those that are there."""
    name = recording.name("error", component=component)
    if name is None:
        known = recording.components()
        hint = did_you_mean(component, known)
        raise DataError(f"twin: the recording has no response {component} (present: {', '.join(known)}).{hint}")
    return name


def _placed(recording: Recording, component: str, found: Values, how: _Twins) -> tuple[Recording, Twin]:
    """The recording with one more (or one replaced) simulated column."""
    error = error_column(recording, component)
    recorded = recording.array(error)
    values, notes = found.values, list(found.notes)
    if (how.datum or found.datum) == "run_start":
        values = from_first_readings(recording, recorded, values)
        notes.append("each run's simulated values start at its first readings")
    known = np.isfinite(recorded)
    have = known & np.isfinite(values)
    missing = {why: int(np.count_nonzero(known & rows)) for why, rows in found.why.items()}
    missing = {why: count for why, count in missing.items() if count}
    unit = recording.manifest.columns[error].unit or "um"
    column = recording.name("simulated", component=component) or _free_name(recording, f"{error}_sim")
    twin = Twin(component, column, unit, found.source, int(known.sum()), int(have.sum()), missing, tuple(notes))
    _refuse_missing(twin, how.most_missing)
    kind = Column(role="simulated", component=component, unit=unit)
    return recording.with_columns({column: values}, {column: kind}), twin


def _free_name(recording: Recording, wanted: str) -> str:
    name = wanted
    while name in recording.manifest.columns:
        name += "_"
    return name


def _refuse_missing(twin: Twin, most: float) -> None:
    lacking = twin.rows - twin.with_twin
    if not twin.with_twin or lacking > most * twin.rows:
        told = "; ".join(f"{count} {why}" for why, count in twin.missing.items())
        raise DataError(
            f"twin: {twin.component}: {lacking} of {twin.rows} recorded rows have no simulated value from "
            f"{twin.source} ({told or 'empty'}; allowed: {100 * most:.0f} %)"
        )


def from_first_readings(recording: Recording, recorded: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values shifted run by run so that they start where the run's first readings are, shape (rows,)."""
    run, out = recording.run_codes(), values.copy()
    both = np.isfinite(recorded) & np.isfinite(values)
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        first = rows[both[rows]][:FIRST_READINGS]
        out[rows] += np.mean(recorded[first] - values[first]) if first.size else np.nan
    return out


# ---------------------------------------------------------------- recorded, error model


def _recorded(recording: Recording) -> dict[str, Values]:
    found = {}
    for component in recording.components():
        twin = recording.name("simulated", component=component)
        if twin is None:
            continue
        error = error_column(recording, component)
        units_of = [recording.manifest.columns[n].unit for n in (error, twin)]
        if units_of[0] != units_of[1]:
            raise DataError(f"twin: {component}: recorded in {units_of[0]}, simulated in {units_of[1]}")
        values = recording.array(twin)
        found[component] = Values(values, "the recording itself", {"empty": ~np.isfinite(values)})
    if not found:
        raise DataError("twin: the recording has no column of role simulated for any of its responses")
    return found


def _model(recording: Recording, model: ErrorModel) -> dict[str, Values]:
    from errpipe.fitting.components import evaluate

    here = set(recording.frame.columns)
    lacking = [name for name in model.columns if name not in here]
    if lacking:
        raise DataError(
            f"twin: the error model reads {lacking[0]}, which the recording lacks.{did_you_mean(lacking[0], here)}"
        )
    for name, facts in model.columns.items():
        here_is = recording.manifest.columns[name]
        if (here_is.role, here_is.unit) != (facts["role"], facts.get("unit", here_is.unit)):
            raise DataError(
                f"twin: {name}: the error model means {facts['role']} in {facts.get('unit')}, the recording holds "
                f"{here_is.role} in {here_is.unit}"
            )
    present = recording.components()
    own = [c for c in model.components if c.component in present]
    if not own:
        wanted = ", ".join(c.component for c in model.components)
        raise DataError(f"twin: the error model speaks of {wanted or 'nothing'}, the recording of {', '.join(present)}")
    values = evaluate(model.model_copy(update={"components": tuple(own)}), recording)
    for c in own:
        unit = recording.manifest.columns[error_column(recording, c.component)].unit or "um"
        if unit != c.unit:
            raise DataError(f"twin: {c.component}: recorded in {unit}, modelled in {c.unit}")
    return {
        name: Values(v, "an error model", {"lack an input of the model": ~np.isfinite(v)}, datum=model.datum)
        for name, v in values.items()
    }


# ---------------------------------------------------------------- CSV


@dataclass(frozen=True)
class Series:
    """Simulated values of one run over time, s; times increase."""

    t: np.ndarray
    values: np.ndarray

    def at(self, t: np.ndarray, longest_gap: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values at times, and where there are none: outside the series, inside a gap; each (n,)."""
        known = np.isfinite(self.values)
        known_t, known_v = self.t[known], self.values[known]
        if not known_t.size:
            return np.full(t.size, np.nan), np.ones(t.size, dtype=bool), np.zeros(t.size, dtype=bool)
        usual = float(np.median(np.diff(self.t))) if self.t.size > 1 else 0.0
        longest = GAP_STEPS * usual if longest_gap is None else longest_gap
        slack = 1e-6 * max(usual, 1e-9)  # a time written with fewer digits is not an extrapolation
        outside = ~((t >= known_t[0] - slack) & (t <= known_t[-1] + slack))
        right = np.clip(np.searchsorted(known_t, t), 1, max(known_t.size - 1, 1))
        left = np.minimum(right - 1, known_t.size - 1)
        right = np.minimum(right, known_t.size - 1)
        near = np.minimum(np.abs(t - known_t[left]), np.abs(t - known_t[right])) <= slack
        gap = ~outside & ~near & (known_t[right] - known_t[left] > longest)
        values = np.interp(t, known_t, known_v)
        values[outside | gap] = np.nan
        return values, outside, gap


def _csv(recording: Recording, how: FromCsv, file: Path) -> dict[str, Values]:
    table = _read_csv(file, how)
    for component in how.columns:
        error_column(recording, component)
    if how.run is None:
        _refuse_overlap(recording)
    out = {}
    for component, wanted in how.columns.items():
        out[component] = _aligned(recording, component, table, wanted, how, file.name)
    return out


def _aligned(recording: Recording, component: str, table, wanted: CsvColumn, how: FromCsv, name: str) -> Values:
    convert = units.conversion("simulated", wanted.unit)
    assert convert is not None
    unit = recording.manifest.columns[error_column(recording, component)].unit or "um"
    if convert.unit != unit:
        raise DataError(f"twin: {component}: recorded in {unit}, simulated in {wanted.unit} ({name}, {wanted.column})")
    sign = -1.0 if wanted.means == "correction" else 1.0
    simulated: np.ndarray = sign * np.asarray(convert(table[wanted.column].to_numpy(dtype=float)))
    t, run, labels = recording.time(), recording.run_codes(), recording.run_labels()
    values = np.full(len(recording), np.nan)
    outside, gaps, absent = (np.zeros(len(recording), dtype=bool) for _ in range(3))
    notes: list[str] = []
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        series = _series(table, simulated, how, labels[code], name)
        if series is None:
            absent[rows] = True
            continue
        values[rows], outside[rows], gaps[rows] = series.at(t[rows], how.longest_gap)
        notes += _places(labels[code], t[rows], gaps[rows])
    hidden = len(notes) - SHOWN
    notes = notes[:SHOWN] + ([f"and {hidden} more gaps"] if hidden > 0 else [])
    why = {"of runs that the file does not have": absent, "outside its time": outside, "inside its gaps": gaps}
    return Values(values, name, why, tuple(notes))


def _places(label: str, t: np.ndarray, gaps: np.ndarray) -> list[str]:
    edges = np.flatnonzero(np.diff(np.r_[0, gaps.astype(int), 0]))
    return [
        f"gap in run {label}: {b - a} rows from {t[a]:.6g} to {t[b - 1]:.6g} s"
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]


def _series(table, simulated: np.ndarray, how: FromCsv, label: str, name: str) -> Series | None:
    """The file's rows of one run (all rows without a run column), or None where it has none."""
    convert = units.conversion("time", how.time_unit)
    assert convert is not None
    rows = np.arange(len(table))
    if how.run is not None:
        rows = np.flatnonzero(table[how.run].to_numpy() == label)
    t, values = np.asarray(convert(table[how.time].to_numpy(dtype=float)[rows])), simulated[rows]
    if not t.size:
        return None
    back = np.flatnonzero(~(np.diff(t) >= 0))
    if back.size or not np.isfinite(t[0]):
        row = int(rows[back[0] + 1]) if back.size else int(rows[0])
        raise DataError(f"{name}:{row + 2}  {how.time}: time must increase (inside a run)")
    last = np.r_[np.diff(t) > 0, True]  # at an event the file may say the time twice: what holds after it counts
    return Series(t[last], values[last])


def _refuse_overlap(recording: Recording) -> None:
    t, run = recording.time(), recording.run_codes()
    spans = sorted((float(np.nanmin(t[run == c])), float(np.nanmax(t[run == c]))) for c in np.unique(run))
    if any(b[0] < a[1] for a, b in itertools.pairwise(spans)):
        raise DataError("twin: the recording's runs overlap in time: name the file's column of run labels (`run`)")


def _read_csv(file: Path, how: FromCsv):
    """The file's columns that are needed, numbers as float64, labels as text."""
    import pandas as pd

    if not file.is_file():
        raise DataError(f"{file.name}: there is no such file")
    try:
        table = pd.read_csv(file, sep=how.separator, dtype=str, keep_default_na=False, skipinitialspace=True)
    except (ValueError, UnicodeDecodeError) as err:
        raise DataError(f"{file.name}: not a CSV table: {str(err).splitlines()[0]}") from None
    names = [how.time, *(c.column for c in how.columns.values())]
    for name in [*names, *([how.run] if how.run else [])]:
        if name not in table.columns:
            near = did_you_mean(name, table.columns)
            raise DataError(f"{file.name}: no column {name!r} (present: {', '.join(table.columns)}).{near}")
    if not len(table):
        raise DataError(f"{file.name}: a header, but no rows")
    for name in dict.fromkeys(names):
        numbers = pd.to_numeric(table[name].str.strip().replace("", "nan"), errors="coerce")
        wrong = np.flatnonzero(numbers.isna() & ~table[name].str.strip().str.lower().isin(["", "nan"]))
        if wrong.size:
            raise DataError(f"{file.name}:{wrong[0] + 2}  {name}: {table[name].iloc[wrong[0]]!r} is not a number")
        table[name] = numbers.astype(float).replace([np.inf, -np.inf], np.nan)
    return table
