"""A folder with a recording manifest, `recording.yaml`, and its tables (CSV with a header row, or Parquet).

The manifest defines every column; nothing is guessed from a name, and no file is opened that the
manifest does not list. Units are checked and converted here, once. Refused, each with file and line:
a column the manifest lacks or the table lacks, a cell that is not a number, a ragged row, time that
decreases in a run, a direction that is not +1 or -1, a path outside the folder.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from errpipe import files, jsonfile, yamlfile
from errpipe.domain import units
from errpipe.domain.batch import Batch
from errpipe.domain.manifest_text import manifest_text
from errpipe.domain.recording import CarriedState, Manifest, Recording
from errpipe.domain.written_manifest import WrittenManifest
from errpipe.errors import ConfigError, DataError
from errpipe.formats import _derived, _tables
from errpipe.formats._magnitude import refuse_impossible, refuse_reverse_flow
from errpipe.formats._runs import Runs, known_runs, runs_stated

name = "manifest"
MANIFEST = "recording.yaml"
TABLE = "recording.parquet"
LABELS = ("run", "group")
ALLOWED = {"direction": (-1.0, 1.0), "coolant": (0.0, 1.0)}  # range of the values of a role
CHUNK_ROWS = 131_072  # also the row group of what is written, so chunked and whole writing give equal bytes

BYTES_PER_CELL = 100  # at the most that cleaning takes: 5.1 GB for 50 million cells
MIN_MAX_CELLS = 10_000_000  # lower limit, whatever memory the machine reports
_AXIS_LENGTHS = ("travel", "screw_lead", "encoder_period", "drive_end")


class Options(yamlfile.Options):
    """A folder with a recording manifest needs no options: the manifest is complete."""

    format: Literal["manifest"] = "manifest"


def sniff(path: Path) -> bool:
    """True for a folder that contains `recording.yaml`, and for that file."""
    path = Path(path)
    return (path / MANIFEST).is_file() or (path.name == MANIFEST and path.is_file())


def load_manifest(path: Path) -> Manifest:
    """The manifest of a folder (or the file itself), units as written. Raises ConfigError with every problem."""
    file = Path(path) / MANIFEST if Path(path).is_dir() else Path(path)
    if file.is_file() and file.suffix.lower() not in (".yaml", ".yml"):
        raise DataError(f"{file}: no recording, which is a folder (errpipe import {file} --out FOLDER makes one)")
    text = yamlfile.text_of(file)
    try:
        written = _written_manifest(text)
    except ConfigError:  # once more, for messages with the file's name
        written = yamlfile.parse(text, str(file)).validate(WrittenManifest)
    return Manifest.model_validate(written.model_dump())


@lru_cache(maxsize=16)
def _written_manifest(text: str) -> WrittenManifest:
    """A manifest's text, validated: stages request the same one ten times in a run, and a fleet's machines share it."""
    return yamlfile.parse(text).validate(WrittenManifest)


def read(path: Path, options: Any = None) -> Recording:
    """A recording folder, whole, in canonical units. Raises ConfigError (manifest) or DataError (tables)."""
    manifest = load_manifest(path)
    parts, left = [], max_cells()
    for part in _blocks(_folder(path), manifest):
        left -= len(part) * _length(part)
        if left < 0:
            raise DataError(
                f"{path}: more than {max_cells()} cells do not fit into this machine's memory (give columns that are"
                " not needed `role: ignore`, or record fewer rows)"
            )
        parts.append(part)
    names = [n for n, c in manifest.columns.items() if c.role != "ignore"]
    frame = pd.DataFrame({n: _join([p.pop(n) for p in parts], manifest.columns[n].role) for n in names}, copy=False)
    return Recording(canonical(manifest), frame)


def max_cells() -> int:
    """Cells (rows times columns) of a recording that may be in memory at once: half of the machine's."""
    try:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return MIN_MAX_CELLS
    return max(MIN_MAX_CELLS, memory // 2 // BYTES_PER_CELL)


def iter_chunks(path: Path, rows: int = CHUNK_ROWS) -> Iterator[Batch]:
    """The same rows in order, `rows` at a time (the last chunk may be shorter): memory does not grow with the file.

    Raises what `read` raises, when it comes to it.
    """
    manifest = load_manifest(path)
    names = [n for n, c in manifest.columns.items() if c.role != "ignore"]
    settled = canonical(manifest)
    held: dict[str, Any] = {}
    for part in _blocks(_folder(path), manifest):
        held = {n: _appended(held[n], part[n]) if held else part[n] for n in names}
        count = _length(held)
        whole = count - count % rows
        for start in range(0, whole, rows):
            yield Batch(settled, {n: v[start : start + rows] for n, v in held.items()}, rows)
        held = {n: v[whole:] for n, v in held.items()} if count > whole else {}
    if held:
        yield Batch(settled, held, _length(held))


def rows_written(folder: Path) -> int:
    """Rows of a folder that `write` or `to_parquet` made; 0 for any other folder."""
    path = Path(folder) / TABLE
    if not path.is_file() or load_manifest(folder).tables != (TABLE,):
        return 0
    return int(pq.read_metadata(path).num_rows)


def iter_batches(
    folder: Path, names: Sequence[str] | None = None, rows: int = CHUNK_ROWS, runs: Mapping[str, int] | None = None
) -> Iterator[Recording]:
    """Columns of a folder that `write` or `to_parquet` made, `rows` at a time; all columns without names.

    Each batch says what the rows before it leave behind, so that states continue; a buffer of the file's would keep all
    that was read. runs: rows of each run in their order, where they are known: they are then not read again.
    Raises DataError for a damaged file.
    """
    manifest = canonical(load_manifest(folder))
    kept = [n for n, c in manifest.columns.items() if c.role != "ignore" and (names is None or n in names)]
    read = [n for n in kept if not (runs and manifest.columns[n].role == "run")]
    labels = [n for n in read if manifest.columns[n].role in LABELS]
    timed = any(manifest.columns[n].role == "time" for n in kept)
    past, at, ends = CarriedState(), 0, np.cumsum(list((runs or {}).values()))
    try:
        table = pq.ParquetFile(Path(folder) / TABLE, read_dictionary=labels, pre_buffer=False)
        for part in table.iter_batches(batch_size=rows, columns=read, use_threads=False):
            there = {n: part[n] if n in labels else part[n].to_numpy(zero_copy_only=False) for n in read}
            columns = {
                n: there[n] if n in there else known_runs(list(runs or {}), ends, at, part.num_rows) for n in kept
            }
            batch = Batch(manifest, columns, part.num_rows, past)
            yield batch
            last = batch.run_stretches[0][-1]
            time = float(batch.time()[-1]) if timed else -1.0  # without a time, rows are counted from 0 in every batch
            past, at = CarriedState(last, time, past.later), at + part.num_rows
    except (pa.ArrowException, OSError):
        raise DataError(f"{Path(folder) / TABLE}: not a Parquet file, or a damaged one") from None


def summary_rows(folder: Path) -> tuple[Recording, frozenset[str], dict[str, int] | None]:
    """Of such a folder, from the file's statistics: two rows, the smallest and the largest value of every column; the
    columns in which no value is missing; and the rows of each run, in order (None if they have to be read).
    """
    manifest = canonical(load_manifest(folder))
    facts = pq.read_metadata(Path(folder) / TABLE)
    ends: dict[str, list[Any]] = {}
    incomplete = set()
    for group in map(facts.row_group, range(facts.num_row_groups)):
        for column in map(group.column, range(facts.num_columns)):
            name, statistics = column.path_in_schema, column.statistics
            if statistics is None or statistics.null_count:
                incomplete.add(name)
            if statistics is not None and statistics.has_min_max:
                least, most = statistics.min, statistics.max
                known = ends.setdefault(name, [least, most])
                known[:] = min(known[0], least), max(known[1], most)
    kept = [n for n, c in manifest.columns.items() if c.role != "ignore"]
    frame = pd.DataFrame({n: ends.get(n, [np.nan, np.nan]) for n in kept})
    runs = runs_stated(facts) if manifest.names("run") else {"1": int(facts.num_rows)}
    return Recording(manifest, frame), frozenset(kept) - incomplete, runs


def canonical(manifest: Manifest) -> Manifest:
    """The manifest as it reads once it is converted: canonical units, constants too.

    Raises ValueError for a unit that is not one of its role's.
    """
    columns = {}
    for column_name, column in manifest.columns.items():
        convert = units.conversion(column.role, column.unit)
        columns[column_name] = column if convert is None else column.model_copy(update={"unit": convert.unit or None})
    constants = {constant_name: _constant(c) for constant_name, c in manifest.constants.items()}
    return _derived.stated(manifest.model_copy(update={"columns": columns, "constants": constants}))


def _constant(c: Any) -> Any:
    convert = units.constant(c.unit) if c.unit is not None else None
    if convert is None:
        return c
    update: dict[str, Any] = {"unit": convert.unit}
    if not convert.identity:
        for key in (*_AXIS_LENGTHS, "value"):
            stated = getattr(c, key)
            if isinstance(stated, tuple):
                update[key] = tuple(convert(float(v)) for v in stated)
            elif isinstance(stated, float):
                update[key] = convert(stated)
    return c.model_copy(update=update)


def _folder(path: Path) -> Path:
    return Path(path) if Path(path).is_dir() else Path(path).parent


# ---------------------------------------------------------------- writing


def write(recording: Recording, folder: Path) -> int:
    """Write a recording folder: `recording.yaml` and `recording.parquet`, in canonical units. Returns the rows."""
    starts = range(0, len(recording), CHUNK_ROWS)
    chunks = (Recording(recording.manifest, recording.frame.iloc[s : s + CHUNK_ROWS]) for s in starts)
    return _write(recording.manifest, chunks, Path(folder))


def write_pieces(pieces: Iterator[Recording], written: Manifest, settled: Callable[[], Manifest], folder: Path) -> int:
    """Write a recording folder piece by piece. Returns the rows.

    written: the manifest of every piece; settled: gives that of the folder when all pieces are written, a column in
    the role `ignore` where it turned out not to be needed.
    """
    chunks = (
        Recording(p.manifest, p.frame.iloc[s : s + CHUNK_ROWS]) for p in pieces for s in range(0, len(p), CHUNK_ROWS)
    )
    rows = _write(written, chunks, folder)
    kept = settled().model_copy(update={"tables": (TABLE,)})
    jsonfile.write_text(folder / MANIFEST, manifest_text(kept))
    return rows


def to_parquet(path: Path, out: Path) -> int:
    """Read a recording folder in chunks and write it to the folder `out` as Parquet in canonical units.

    Memory does not grow with the tables. Returns the rows. Raises what `read` raises; nothing is then written.
    """
    return _write(canonical(load_manifest(path)), iter_chunks(path, CHUNK_ROWS), Path(out))


def _write(manifest: Manifest, chunks: Iterator[Recording], folder: Path) -> int:
    columns = {n: c for n, c in manifest.columns.items() if c.role != "ignore"}
    schema = _tables.parquet_schema({n: c.model_dump(exclude_none=True) for n, c in columns.items()})
    runs, kinds = Runs(), {n: schema.field(n).type for n in columns}
    parts = (pa.table([_cells(c, *kind) for kind in kinds.items()], schema=schema) for c in map(runs.add, chunks))
    rows = _tables.write_parquet(folder / TABLE, schema, parts, runs.facts)
    kept = manifest.model_copy(update={"tables": (TABLE,), "columns": columns})
    jsonfile.write_text(folder / MANIFEST, manifest_text(kept))
    return rows


def _cells(rows: Recording, name: str, kind: pa.DataType) -> pa.Array:
    """A column as written to a file."""
    values = rows.columns[name] if isinstance(rows, Batch) else rows.frame[name]
    return values.cast(kind) if hasattr(values, "dictionary") else pa.array(values, type=kind, from_pandas=True)


# ---------------------------------------------------------------- rows


def _blocks(folder: Path, manifest: Manifest) -> Iterator[dict[str, Any]]:
    """Rows of all tables, converted and checked, a few MB at a time."""
    kinds = _derived.kinds(manifest, {n: _kind(c.role) for n, c in manifest.columns.items()})
    converts = {n: units.conversion(c.role, c.unit) for n, c in manifest.columns.items()}
    order = _Order(manifest)
    empty = True
    for table in manifest.tables:
        path = folder / table
        label = str(path)
        if not files.is_below(folder, path):
            raise DataError(f"{label}: leads outside the folder through a link (allowed: a file of the folder)")
        rows = 0
        for block in _tables.blocks(path, kinds, label):
            yield _values(block, manifest, converts, order)
            rows += block.table.num_rows
        if not rows:
            raise DataError(f"{label}: the table has a header but no rows (allowed: at least one row)")
        empty = False
    if empty:
        raise DataError(f"{folder}: no rows")


def _kind(role: str) -> str:
    return "ignore" if role == "ignore" else "label" if role in LABELS else "number"


def _values(block: _tables.Block, manifest: Manifest, converts: dict[str, Any], order: _Order) -> dict[str, Any]:
    out: dict[str, Any] = {}
    raw: dict[str, Any] = {}
    for column_name in block.table.column_names:
        role = manifest.columns[column_name].role
        cells = block.table[column_name]
        if role in LABELS:
            out[column_name] = cells.dictionary_encode().combine_chunks()
            continue
        raw[column_name] = values = cells.to_numpy()  # a missing cell becomes NaN
        convert = converts[column_name]
        if convert is not None and convert.threshold is not None:
            refuse_reverse_flow(values, convert.threshold, column_name, block.place)
        elif role in ALLOWED:
            _check_codes(values, ALLOWED[role], role, column_name, block)
        values = values if convert is None or convert.identity else convert(values)
        refuse_impossible(values, role, None if convert is None else convert.unit, column_name, block.place)
        out[column_name] = values
    order.check(out, block)
    if any(c.derived is not None for c in manifest.columns.values()):
        out = _derived.derive(out, raw, block.table.num_rows, manifest)
        for column_name in (n for n in out if n not in raw and manifest.columns[n].role not in LABELS):
            c = manifest.columns[column_name]
            convert = converts[column_name]
            refuse_impossible(out[column_name], c.role, convert.unit if convert else None, column_name, block.place)
    return out


def _check_codes(
    values: np.ndarray, allowed: tuple[float, ...], role: str, column_name: str, block: _tables.Block
) -> None:
    wrong = ~np.isnan(values) & ~np.isin(values, allowed)
    if wrong.any():
        row = int(np.argmax(wrong))
        words = " or ".join(f"{a:+g}" if role == "direction" else f"{a:g}" for a in allowed)
        what = f"{column_name}: {values[row]:g} is not a {role} (allowed: {words}, or empty)"
        raise DataError(f"{block.place(row)}  {what}")


@dataclass
class _Order:
    """Time may repeat in a run, but never decrease; every row needs a run."""

    manifest: Manifest
    last: dict[str, float] = field(default_factory=dict)

    def check(self, columns: dict[str, Any], block: _tables.Block) -> None:
        """Raises DataError at the first row that is out of order. Rows without a time are passed over."""
        run = next(iter(self.manifest.names("run")), None)
        labels, codes = self._runs(columns, run, block)
        time = next(iter(self.manifest.names("time")), None)
        if time is None:
            return
        t, only = columns[time], labels[codes[0]] if codes.size and (codes == codes[0]).all() else ""
        if only and (np.diff(t, prepend=self.last.get(only, -np.inf)) >= 0.0).all():
            self.last[only] = float(t[-1])
            return
        rows = np.flatnonzero(~np.isnan(t))
        if np.any(np.diff(codes) < 0):
            rows = rows[np.argsort(codes[rows], kind="stable")]
        if not rows.size:
            return
        values, run_of = t[rows], codes[rows]
        same = np.r_[False, run_of[1:] == run_of[:-1]]
        before = np.r_[-np.inf, values[:-1]]
        for i in np.flatnonzero(~same):
            before[i] = self.last.get(labels[run_of[i]], -np.inf)
        back = np.flatnonzero(values < before)
        if back.size:
            i = back[np.argmin(rows[back])]
            of = f" of run {labels[run_of[i]]!r}" if run is not None else ""
            raise DataError(
                f"{block.place(int(rows[i]))}  {time}: {values[i]:.12g} s comes after {before[i]:.12g} s{of}"
                " (allowed: time that increases or repeats in a run)"
            )
        ends = np.flatnonzero(np.r_[run_of[1:] != run_of[:-1], True])
        self.last.update({labels[run_of[i]]: float(values[i]) for i in ends})

    @staticmethod
    def _runs(columns: dict[str, Any], run: str | None, block: _tables.Block) -> tuple[list[str], np.ndarray]:
        if run is None:
            return ["1"], np.zeros(block.table.num_rows, dtype=np.int64)
        labels, codes = columns[run].dictionary.to_pylist(), columns[run].indices.to_numpy()
        if "" in labels and (codes == labels.index("")).any():
            row = int(np.argmax(codes == labels.index("")))
            raise DataError(f"{block.place(row)}  {run}: is empty (allowed: the label of the row's run)")
        return labels, codes


def _length(part: dict[str, Any]) -> int:
    return len(next(iter(part.values())))


def _join(parts: list[Any], role: str) -> Any:
    if role not in LABELS:
        return np.concatenate(parts)
    return pd.Series(pa.chunked_array([p.cast(pa.string()) for p in parts]).to_pandas())


def _appended(before: Any, values: Any) -> Any:
    return np.concatenate([before, values]) if isinstance(values, np.ndarray) else pa.concat_arrays([before, values])
