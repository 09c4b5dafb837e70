"""What a controller would predict for every row of a recording, from an error model or from the table itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from errpipe.stages import _artefacts

if TYPE_CHECKING:
    import numpy as np

    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.domain.table import CompensationTable


def predict(source: Path, recording: Path, out: Path) -> dict[str, Any]:
    """Write one row per recording row: run, time, and NAME_predicted, _lower, _upper, _outside per response."""
    from errpipe import jsonfile
    from errpipe.domain.error_model import ErrorModel
    from errpipe.validation import predict as rows

    found = _artefacts.model_or_table(source)
    read = _artefacts.recording_in(Path(recording))
    source_of = _of_model(found) if isinstance(found, ErrorModel) else _of_table(found, Path(source))
    frame = rows.predict(source_of, read)
    jsonfile.write_text(Path(out), frame.to_csv(index=False, lineterminator="\n"))
    told = {"written": str(out), "rows": len(frame), "columns": list(frame.columns)}
    without = [c for c in source_of.components if c not in source_of.half_width90]
    return told | ({"intervals": _why_empty(found, without)} if without else {})


def _why_empty(found: ErrorModel | CompensationTable, without: list[str]) -> str:
    """Why the columns of the interval are empty, in words."""
    names = ", ".join(without)
    if not hasattr(found, "fingerprint"):
        return f"empty for {names}: the model states no interval"
    return (
        f"empty for {names}: a table carries the deviation alone; its interval stands in the error model that it was "
        f"compiled from, which `{_artefacts.MODEL}` beside it would be (none there has the table's fingerprint)"
    )


def _of_model(model: ErrorModel):
    """The predictor of the table that a model compiles to, as a controller would run it.

    Outside validity it fades as the table does. A model that no controller can be given predicts by its own terms.
    """
    from functools import cache

    from errpipe.errors import GateError
    from errpipe.fitting.components import evaluate
    from errpipe.stages._compile import CompileOptions, compile_model
    from errpipe.validation.predict import of_evaluator

    @cache
    def table() -> CompensationTable | None:
        try:
            return compile_model(model, CompileOptions())
        except GateError:
            return None

    def values(recording: Recording) -> Mapping[str, np.ndarray]:
        compiled = table()
        return evaluate(model, recording) if compiled is None else table_values(compiled, model, recording)

    return of_evaluator(values, model)


def _of_table(table: CompensationTable, path: Path):
    """The predictor of a table, with the intervals of the model that stands beside it where it is the same one."""
    from errpipe import jsonfile
    from errpipe.domain.error_model import ErrorModel, Validity
    from errpipe.validation.predict import Predictor, of_evaluator

    beside = path.parent / _artefacts.MODEL
    if beside.is_file():
        model = _artefacts.read_model(beside)
        if jsonfile.fingerprint(_artefacts.model_json(model)) == table.fingerprint:
            return of_evaluator(lambda recording: table_values(table, model, recording), model)
    bare = ErrorModel(components=())
    seen = Validity(ranges={i.name: i.valid for i in table.inputs if i.valid is not None})
    names = tuple(o.name for o in table.outputs)
    return Predictor(lambda recording: table_values(table, bare, recording), names, seen)


def table_values(table: CompensationTable, model: ErrorModel, recording: Recording) -> Mapping[str, np.ndarray]:
    """Deviations by component from a causal replay of the table, counted from where the model's datum is."""
    from errpipe.drivers.sessions import sessions
    from errpipe.fitting.components import from_run_start
    from errpipe.tables import batch, by_component

    columns = {i.name: recording.array(i.name) for i in table.inputs if i.name in recording.frame.columns}
    replay = batch.evaluate(by_component(table), columns, recording.time(), sessions(recording))
    if model.datum == "run_start":
        return {name: from_run_start(recording, values) for name, values in replay.deviation.items()}
    return replay.deviation
