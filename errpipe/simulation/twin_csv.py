"""Simulated values from a CSV file over time, interpolated linearly inside a run, never beyond its ends or a gap."""

from __future__ import annotations

import csv
import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from errpipe import files
from errpipe.domain import units
from errpipe.domain.recording import Recording
from errpipe.errors import DataError, did_you_mean
from errpipe.kernels.events import stretches
from errpipe.simulation.responses import Values, error_column, names_of
from errpipe.simulation.twin_options import CsvColumn, FromCsv

GAP_STEPS = 10.0  # a step this many times the median one is a gap, unless `longest_gap` is given (by judgement)
MAX_HEADER_BYTES = 1 << 20  # a first line beyond 1 MB is not a header
MAX_GAPS_LISTED = 5  # gaps listed in a message; the others are only counted


def csv_by_name(recording: Recording, file: Path) -> FromCsv:
    """Columns of a CSV file named like the recording's responses. Raises DataError if none is."""
    try:
        with files.open_regular(file) as stream:
            line = stream.readline(MAX_HEADER_BYTES).decode("utf-8-sig")
        header = [name.strip() for name in next(csv.reader([line]), [])]
    except OSError as err:
        raise DataError(f"{file.name}: {files.why(err)}") from None
    except (UnicodeDecodeError, csv.Error) as err:
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
        responses = ", ".join(recording.components())
        raise DataError(
            f"{file.name}: no column for any response of the recording ({responses}; found {', '.join(header)})"
        )
    run = recording.name("run")
    return FromCsv(kind="csv", time=clock, run=run if run in header else None, columns=columns)


@dataclass(frozen=True)
class Series:
    """Simulated values of one run over time, s; times increase."""

    t: np.ndarray
    values: np.ndarray

    def at(self, t: np.ndarray, longest_gap: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values at times, and reasons for missing ones: outside the series, inside a gap; each (n,)."""
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


def csv_values(recording: Recording, how: FromCsv, file: Path) -> dict[str, Values]:
    """Simulated values of every response in a CSV file. Raises DataError."""
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
        for a, b in zip(*stretches(gaps[rows]), strict=True):
            first, last = t[rows[a]], t[rows[b - 1]]
            notes.append(f"gap in run {labels[code]}: {b - a} rows from {first:.6g} to {last:.6g} s")
    hidden = len(notes) - MAX_GAPS_LISTED
    notes = notes[:MAX_GAPS_LISTED] + ([f"and {hidden} more gaps"] if hidden > 0 else [])
    why = {"of runs that the file does not have": absent, "outside its time": outside, "inside its gaps": gaps}
    return Values(values, name, why, tuple(notes))


def _series(table, simulated: np.ndarray, how: FromCsv, label: str, name: str) -> Series | None:
    """The file's rows of one run (all rows without a run column), or None if it has none."""
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
    last = np.r_[np.diff(t) > 0, True]  # at an event the file may contain a time twice: the value after it is used
    return Series(t[last], values[last])


def _refuse_overlap(recording: Recording) -> None:
    t, run = recording.time(), recording.run_codes()
    spans = sorted((float(np.nanmin(t[run == c])), float(np.nanmax(t[run == c]))) for c in np.unique(run))
    if any(b[0] < a[1] for a, b in itertools.pairwise(spans)):
        raise DataError("twin: the recording's runs overlap in time: name the file's column of run labels (`run`)")


def _read_csv(file: Path, how: FromCsv):
    """The required columns of the file, numbers as float64, labels as text."""
    try:
        with files.open_regular(file) as stream:
            table = pd.read_csv(stream, sep=how.separator, dtype=str, keep_default_na=False, skipinitialspace=True)
    except FileNotFoundError:
        raise DataError(f"{file.name}: there is no such file") from None
    except OSError as err:
        raise DataError(f"{file.name}: {files.why(err)}") from None
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
