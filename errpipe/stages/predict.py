"""What a controller would predict for every row of a recording, from an error model or from the table itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from itertools import chain
from pathlib import Path
from typing import IO, Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from errpipe import files, jsonfile
from errpipe.domain.error_model import ErrorModel, Validity
from errpipe.domain.recording import Manifest, Recording
from errpipe.domain.table import CompensationTable
from errpipe.drivers.sessions import sessions
from errpipe.errors import DataError, GateError, UsageError
from errpipe.fitting.components import evaluate, from_run_start
from errpipe.formats import manifest_folder
from errpipe.stages import _artefacts, _readings
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.tables import batch, by_component
from errpipe.validation import predict as rows
from errpipe.validation.predict import Begin, Evaluate, Evaluated, Predictor, of_evaluator

PLACES = {"position": ("position", "command", "actual"), "direction": ("direction",)}  # input of a table -> roles

SILENT = (
    "no reading for too long in {} of {} rows: the last one is held there, without an interval unless the model widens "
    "it, and before a first one nothing is predicted; a table with `guard: true` (export) replaces a temperature "
    "by its estimate from the others"
)
ADDED_TO_PREDICTION = "added to the prediction: the table has no input for readings (readings_per_shift of its export)"


def predict(source: Path, recording: Path, out: Path, readings: Path | None = None) -> dict[str, Any]:
    """Write one row per recording row: run, time, and NAME_predicted, _lower, _upper, _outside per response.

    `out` is Parquet where it ends in `.parquet`, else CSV. Rows are read, predicted and written in parts, so that
    memory does not grow with them, wherever the prediction is a table's, its interval needs no earlier rows, and no
    readings are given.
    readings: a file of the deviation read now and then (`stages/_readings.py`); rows after a reading are corrected by
    it. Raises DataError if it cannot be used, or if a column is not the one that the compensation was made for.
    """
    compensation = _artefacts.model_or_table(source)
    manifest = manifest_folder.load_manifest(Path(recording))
    _refuse_out(Path(out), Path(recording), manifest)
    refuse_others(compensation, manifest_folder.canonical(manifest))
    source_of = (
        _of_model(compensation) if isinstance(compensation, ErrorModel) else _of_table(compensation, Path(source))
    )
    summary: dict[str, Any] = {}
    silent: dict[str, int] = {}
    if readings is not None:
        read = _artefacts.recording_in(Path(recording))
        plain = rows.predict(source_of, read, silent)
        frame, summary = _with_readings(compensation, source_of, read, plain, Path(readings))
        frames = iter([frame])
    elif source_of.in_parts:
        frames = rows.predict_parts(source_of, manifest_folder.iter_chunks(Path(recording)), silent)
    else:
        frames = iter([rows.predict(source_of, _artefacts.recording_in(Path(recording)), silent)])
    answer = {"written": str(out)} | _write_rows(Path(out), frames) | summary
    if silent:
        answer["silent"] = {name: SILENT.format(count, answer["rows"]) for name, count in silent.items()}
    without = [c for c in source_of.components if c not in source_of.half_width90]
    return answer | ({"intervals": _why_empty(compensation, without)} if without else {})


def _refuse_out(out: Path, recording: Path, manifest: Manifest) -> None:
    """Raises UsageError if a prediction would replace what was measured, or is no file of rows."""
    if out.suffix.lower() not in (".csv", ".txt", ".parquet"):
        raise UsageError(f"--out {out}: a file of rows is needed (.csv or .parquet)")
    folder = recording if recording.is_dir() else recording.parent
    if out.resolve() in {(folder / name).resolve() for name in manifest.tables}:
        raise UsageError(f"--out {out}: would replace a file of the recording: name another one")


def _write_rows(path: Path, frames: Iterator[pd.DataFrame]) -> dict[str, Any]:
    """Write parts of equal columns one after the other; the file appears when all are in. Its `rows` and `columns`."""
    first = next(frames)
    put = _parquet if path.suffix == ".parquet" else _csv
    with files.whole(path) as stream:
        rows = put(stream, first, chain([first], frames))
    return {"rows": rows, "columns": list(first.columns)}


def _csv(stream: IO[bytes], first: pd.DataFrame, frames: Iterable[pd.DataFrame]) -> int:
    rows = 0
    for frame in frames:
        stream.write(frame.to_csv(index=False, header=rows == 0, lineterminator="\n").encode())
        rows += len(frame)
    return rows


def _parquet(stream: IO[bytes], first: pd.DataFrame, frames: Iterable[pd.DataFrame]) -> int:
    kinds = {"f": pa.float64(), "i": pa.int64()}
    rows, schema = 0, pa.schema([pa.field(n, kinds.get(first[n].dtype.kind, pa.string())) for n in first.columns])
    with pq.ParquetWriter(stream, schema, version="2.6", compression="snappy", use_dictionary=["run"]) as writer:
        for frame in frames:
            writer.write_table(pa.Table.from_pandas(frame, schema, preserve_index=False))
            rows += len(frame)
    return rows


def _with_readings(
    compensation: ErrorModel | CompensationTable,
    source: Predictor,
    recording: Recording,
    frame: pd.DataFrame,
    path: Path,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """The prediction corrected by readings, and in words what of them was used.

    A table with an input for readings gets them there; otherwise the full difference is added.
    """
    table = _compiled(compensation) if isinstance(compensation, ErrorModel) else compensation
    channels = {i.name: i for i in table.inputs} if table is not None else {}
    read = _readings.read(path, recording, source.components)
    inputs, added, notes = {}, {}, {}
    for component in (c for c in source.components if c in read.columns):
        name = recording.name("error", component=component) or component
        channel = channels.get(f"datum_{component}")
        hold, bound = (channel.stale_after_s or np.inf, channel.high) if channel else (np.inf, np.inf)
        predicted = frame[f"{name}_predicted"].to_numpy()
        difference, used, wild = _readings.differences(recording, read, component, predicted, hold, bound)
        if not used:
            away = f"; {wild} lie further than {bound:.3g} from the prediction" if wild else ""
            raise DataError(
                f"{path}: no reading of {component} is both accepted and within a run of the recording{away}"
            )
        notes[component] = {"used": used, "not_believed": wild, "by": channel.name if channel else ADDED_TO_PREDICTION}
        if channel is not None:
            inputs[channel.name] = difference
        else:
            added[name] = np.nan_to_num(difference)
    if inputs:
        frame = rows.predict(source, recording.with_columns(inputs, {}))
    for name, difference in added.items():
        for ending in ("predicted", "lower", "upper"):
            frame[f"{name}_{ending}"] += difference
    return frame, {"readings": notes}


def _why_empty(source: ErrorModel | CompensationTable, without: list[str]) -> str:
    """Why the columns of the interval are empty, in words."""
    names = ", ".join(without)
    if not hasattr(source, "fingerprint"):
        return f"empty for {names}: the model states no interval"
    return (
        f"empty for {names}: a table contains the deviation only; its interval is in the error model that it was "
        f"compiled from (no `{_artefacts.MODEL}` next to the table has its fingerprint)"
    )


def _of_model(model: ErrorModel):
    """The predictor of the table that a model compiles to, as a controller would run it.

    Outside validity it fades as the table does. A model that no controller can be given predicts by its own terms.
    """
    table = cache(lambda: _compiled(model))

    def values(recording: Recording) -> Evaluated:
        compiled = table()
        if compiled is not None:
            return _evaluated(compiled, model, recording)
        return Evaluated(evaluate(model, recording))

    compiled = table()
    return of_evaluator(values, model, None if compiled is None else _begin(compiled, model))


def _compiled(model: ErrorModel) -> CompensationTable | None:
    """The table of a model; None where a controller can be given none."""
    try:
        return compile_model(model, CompileOptions())
    except GateError:
        return None


def _of_table(table: CompensationTable, path: Path):
    """The predictor of a table, with the intervals of the model next to it if that is the same model."""
    model_file = path.parent / _artefacts.MODEL
    if model_file.is_file():
        model = _artefacts.read_model(model_file)
        if jsonfile.fingerprint(_artefacts.model_json(model)) == table.fingerprint:
            return of_evaluator(lambda recording: _evaluated(table, model, recording), model, _begin(table, model))
    bare = ErrorModel(components=())
    seen = Validity(ranges={i.name: i.valid for i in table.inputs if i.valid is not None})
    names = tuple(o.name for o in by_component(table).outputs)
    return Predictor(lambda recording: _evaluated(table, bare, recording), names, seen, begin=_begin(table, bare))


def _begin(table: CompensationTable, model: ErrorModel) -> Begin:
    """Begins a run that comes in parts; its evaluator gives for them what `_evaluated` gives for the whole."""
    packed = cache(lambda compiled: batch.Rows(by_component(table), compiled))

    def begin(rows: int) -> Evaluate:
        replay, count, first = packed(batch.worth_compiling(rows)).restarted(), 0, dict[str, float]()

        def values(part: Recording) -> Evaluated:
            nonlocal count
            rows, timed = len(part), part.name("time") is not None
            columns = {i.name: part.array(i.name) for i in table.inputs if i.name in part}
            replayed = replay(columns, part.time() if timed else part.time() + count, np.zeros(rows))
            deviations, outside = replayed.deviation, replayed.outside()
            count += rows
            if model.datum != "run_start":
                return Evaluated(deviations, outside)
            for name, deviation in deviations.items():
                known = deviation[np.isfinite(deviation)]
                if known.size:
                    first.setdefault(name, known[0])
            return Evaluated({name: v - first.get(name, np.nan) for name, v in deviations.items()}, outside)

        return values

    return begin


def table_values(table: CompensationTable, model: ErrorModel, recording: Recording) -> Mapping[str, np.ndarray]:
    """Deviations by component from a causal replay of the table, counted from where the model's datum is."""
    return _evaluated(table, model, recording).values


def _evaluated(table: CompensationTable, model: ErrorModel, recording: Recording) -> Evaluated:
    """`table_values`, and where the table says that a row is outside."""
    columns = {i.name: recording.array(i.name) for i in table.inputs if i.name in recording}
    replay = batch.evaluate(by_component(table), columns, recording.time(), sessions(recording))
    if model.datum == "run_start":
        values = {name: from_run_start(recording, values) for name, values in replay.deviation.items()}
        return Evaluated(values, replay.outside())
    return Evaluated(replay.deviation, replay.outside())


def refuse_others(source: ErrorModel | CompensationTable, manifest: Manifest) -> None:
    """Raises DataError if a column has the name of an input, but another axis, role or unit: X in place of Y, say.

    What lacks a column is not looked at, nor what states neither.
    """
    means = dict(_inputs_of_model(source) if isinstance(source, ErrorModel) else _inputs_of_table(source))
    for name, (roles, axis, unit) in means.items():
        column = manifest.columns.get(name)
        if column is None:
            continue
        wrong = [
            f"{found} here, {' or '.join(allowed)} there"
            for found, allowed in ((column.role, roles), (f"axis {column.axis}", axis), (f"in {column.unit}", unit))
            if allowed and found not in allowed
        ]
        if wrong:
            raise DataError(f"column {name} is not what the compensation was made for ({'; '.join(wrong)})")


Means = Iterator[tuple[str, tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]]]


def _inputs_of_model(model: ErrorModel) -> Means:
    for name, facts in model.columns.items():
        axis, unit, role = facts.get("axis"), facts.get("unit"), facts["role"]
        roles = PLACES["position"] if role in PLACES["position"] else (role,)
        yield name, (roles, (f"axis {axis}",) if axis else (), (f"in {unit}",) if unit else ())


def _inputs_of_table(table: CompensationTable) -> Means:
    for i in table.inputs:
        moves = i.kind in PLACES
        axis = (f"axis {i.axis}",) if moves and i.axis else ()
        yield i.name, (PLACES.get(i.kind, ()), axis, (f"in {i.unit}",) if i.unit else ())
