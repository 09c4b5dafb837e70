"""Readings of the deviation now and then, from a file, as the input of a table that corrects by them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from errpipe import files
from errpipe.errors import DataError, did_you_mean

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

MAX_BYTES, MAX_CELLS = 64 << 20, 10_000_000  # of a file of readings: one a second for a year has 32 million bytes


def read(path: Path, recording: Recording, components: Sequence[str]) -> pd.DataFrame:
    """Columns `run` (its code), `time` (s) and one per component (its unit, NaN: not read), ordered by time.

    The file, CSV or Parquet, has a column of time, one per component that was read, and where runs overlap in time a
    column of runs; each named as in the recording, or `time`, `run` and the component. Raises DataError with file and
    line.
    """
    frame = _table(path)
    names = {"time": "time", "run": "run"} | {c: c for c in components}
    for role in ("time", "run"):
        names |= dict.fromkeys(recording.names(role), role)
    names |= {n: c for c in components for n in recording.names("error", component=c)}
    for name in frame.columns:
        if name not in names:
            allowed = ", ".join(dict.fromkeys(names))
            raise DataError(f"{path}:1  column {name!r} (allowed: {allowed}).{did_you_mean(str(name), names)}")
    frame = frame.rename(columns=names)
    read_here = [c for c in components if c in frame.columns]
    if "time" not in frame.columns or not read_here or frame.columns.has_duplicates:
        columns = ", ".join(map(str, frame.columns))
        raise DataError(
            f"{path}:1  found {columns} (needed, once each: time and at least one of {', '.join(components)})"
        )
    numbers = {name: _numbers(path, frame[name], name == "time") for name in ("time", *read_here)}
    out = pd.DataFrame({"run": _runs(path, frame, numbers["time"], recording), **numbers})
    return out.sort_values("time", kind="stable", ignore_index=True)


def _table(path: Path) -> pd.DataFrame:
    path = Path(path)
    if not path.is_file():
        raise DataError(f"{path}: there is no such file (readings, .csv or .parquet, are needed)")
    if path.suffix not in (".csv", ".parquet"):
        raise DataError(f"{path}: found suffix {path.suffix or 'none'} (allowed: .csv, .parquet)")
    data = io.BytesIO(files.read(path, MAX_BYTES, DataError))
    try:
        if path.suffix == ".parquet":
            facts = pq.read_metadata(data)
            if facts.num_rows * facts.num_columns > MAX_CELLS:
                raise DataError(f"{path}: holds {facts.num_rows} rows (at most {MAX_CELLS} cells are read)")
            return pd.read_parquet(data)
        return pd.read_csv(data, dtype=str, keep_default_na=False, skip_blank_lines=False)
    except (ValueError, OSError) as err:  # pandas' and pyarrow's own errors are among them
        raise DataError(f"{path}: cannot be read as a table: {str(err).splitlines()[0]}") from None


def _numbers(path: Path, column: pd.Series, every: bool) -> np.ndarray:
    """Values as float64; an empty cell is NaN unless `every` row needs one."""
    empty = column.isna() | (column.astype(str).str.strip() == "")
    values = pd.to_numeric(column.where(~empty), errors="coerce").to_numpy(dtype=float)
    wrong = ~np.isfinite(values) & (every | ~empty.to_numpy())
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise DataError(f"{path}:{row + 2}  {column.name}: found {str(column.iloc[row])!r} (allowed: a number)")
    return values


def _runs(path: Path, frame: pd.DataFrame, time: np.ndarray, recording: Recording) -> np.ndarray:
    """Code of the run of each reading; -1 between runs."""
    labels, code, t = [str(label) for label in recording.run_labels()], recording.run_codes(), recording.time()
    if "run" in frame.columns:
        named = frame["run"].astype(str).tolist()
        for row, label in enumerate(named):
            if label not in labels:
                raise DataError(f"{path}:{row + 2}  run: found {label!r}.{did_you_mean(label, labels)}")
        return np.array([labels.index(label) for label in named], dtype=int)
    spans = [(np.nanmin(t[code == c]), np.nanmax(t[code == c])) for c in range(len(labels))]
    inside = np.array([(time >= low) & (time <= high) for low, high in spans])
    if (inside.sum(axis=0) > 1).any():
        row = int(np.flatnonzero(inside.sum(axis=0) > 1)[0])
        raise DataError(f"{path}:{row + 2}  time: {time[row]:g} s lies in several runs (add a column run)")
    return np.where(inside.any(axis=0), inside.argmax(axis=0), -1)


def differences(
    recording: Recording, readings: pd.DataFrame, component: str, predicted: np.ndarray, hold_s: float, bound: float
) -> tuple[np.ndarray, int, int]:
    """Last reading minus its prediction, per row; NaN if there is none.

    Also how many readings are used, and how many are not accepted.

    predicted: without readings, shape (rows,), in the component's unit. A row uses readings of its own run taken before
    it, not older than hold_s; one further than `bound` from the prediction is not accepted until the next comes.
    """
    out, used, wild, code = np.full(len(recording), np.nan), 0, 0, recording.run_codes()
    for run in np.unique(code):
        rows = np.flatnonzero(code == run)
        own = readings[(readings["run"] == run) & readings[component].notna()]
        t = np.maximum.accumulate(recording.time()[rows])
        taken = own["time"].to_numpy()
        at = np.searchsorted(t, taken, side="right") - 1
        own, taken, at = own[at >= 0], taken[at >= 0], at[at >= 0]
        if not taken.size:
            continue
        difference = own[component].to_numpy() - predicted[rows[at]]
        difference = np.where(np.abs(difference) <= bound, difference, np.nan)
        last = np.searchsorted(taken, t, side="left") - 1
        fresh = (last >= 0) & (t - taken[np.maximum(last, 0)] <= hold_s)
        out[rows] = np.where(fresh, difference[np.maximum(last, 0)], np.nan)
        used += int(np.count_nonzero(np.isfinite(difference)))
        wild += int(np.count_nonzero(np.isnan(difference)))
    return out, used, wild
