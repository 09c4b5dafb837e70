"""Artefacts between stages: recordings, error models and tables, read back from a stage's folder."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from errpipe import jsonfile
from errpipe.errors import DataError, MissingColumn, UsageError, VerifyError, first_problem
from errpipe.pipeline.stage import Context

if TYPE_CHECKING:
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Recording
    from errpipe.domain.table import CompensationTable
    from errpipe.fitting.source import Source
    from errpipe.models import Family

TRUTH = "truth.json"
MODEL = "error_model.json"
PROCEDURE = "fit.json"  # the model family and its options: enough to repeat the fit without a held-out group
VALIDATION = "validation.json"
UNGATED = "Ungated, not shown to be better than no compensation"  # in the title of such a table
SIGN_ASSUMED = "Sign assumed"  # in the title of a table of readings whose file does not state their sign
# Among the notes of a model of such readings, in comments of its files, in reports
SIGN_NOTE = "The sign of the readings was assumed (their file does not state it); a wrong one doubles the error"
TABLE = "table.ect"
TWIN = "table.json"


def ungated_title(title: str) -> str:
    """Title of a table that was exported although nothing showed that it helps; at most 127 characters."""
    return f"{UNGATED}: {title}"[:127]


def sign_assumed(recordings: Iterable[Recording]) -> bool:
    """Whether `import` assumed the sign of the readings of any of the recordings."""
    signs = (recording.manifest.constants.get("sign") for recording in recordings)
    return any(sign is not None and sign.value == "assumed" for sign in signs)


def sign_noted(model: ErrorModel) -> bool:
    """Whether a model notes that the sign of its readings was assumed."""
    return any(SIGN_NOTE in note for note in model.notes)


def with_sign_note(model: ErrorModel) -> ErrorModel:
    """A model with the note that the sign of its readings was assumed."""
    return model if sign_noted(model) else model.model_copy(update={"notes": (*model.notes, SIGN_NOTE)})


def sign_title(title: str) -> str:
    """Title of a table of readings whose sign was assumed; at most 127 characters."""
    return title if SIGN_ASSUMED in title else f"{SIGN_ASSUMED}: {title}"[:127]


def warnings_in(title: str) -> list[str]:
    """The warnings that a table's title holds, a sentence each."""
    marks = {SIGN_ASSUMED: SIGN_NOTE, UNGATED: UNGATED}
    return [says for mark, says in marks.items() if mark in title]


def recording_in(folder: Path) -> Recording:
    """The recording a stage (or a person) left in a folder."""
    from errpipe.formats import manifest_folder

    return manifest_folder.read(folder)


def with_cleaning_reason(folder: Path, missing: MissingColumn) -> MissingColumn:
    """What to raise where a model reads a column that cleaning has set aside: its reason; else what was raised."""
    name, report = str(missing).partition(":")[0], Path(folder) / "cleaning.json"
    done = [d for r in jsonfile.read(report)["rules"] for d in r["done"]] if report.is_file() else []
    reasons = [d["reason"] for d in done if d["what"] == "set column aside" and d["column"] == name]
    if not reasons:
        return missing
    return MissingColumn(f"{name}: cleaning set it aside: {reasons[0]}. Mend the column, or fit without it")


def source_in(folder: Path) -> Source | None:
    """The recording a stage left in a folder, to be read batch by batch; None where a person put it there."""
    from errpipe.fitting.source import Source
    from errpipe.formats import manifest_folder

    rows = manifest_folder.rows_written(folder)
    if not rows:
        return None
    ends, complete, runs = manifest_folder.summary_rows(folder)
    return Source(rows, ends, partial(manifest_folder.iter_batches, folder), complete, runs)


def recordings_in(context: Context) -> dict[str, Recording]:
    """Every recording of the slot `recordings`, by the name of its stage."""
    return {name: recording_in(folder) for name, folder in context.every("recordings").items()}


def read_model(path: Path) -> ErrorModel:
    """An error model from its JSON file. Raises VerifyError if it is not one."""
    from errpipe.domain.error_model import ErrorModel
    from errpipe.domain.recording import Column

    place: tuple[str, ...] = ()
    try:
        model = ErrorModel.model_validate(jsonfile.read(path))
        for name, facts in model.columns.items():
            place = ("columns", name)
            Column.model_validate(facts)
        return model
    except ValidationError as err:
        raise VerifyError(f"{path}: not an error model: {first_problem(err, *place)}") from None


def model_json(model: ErrorModel) -> dict[str, Any]:
    """The canonical JSON value of an error model, without what is at its default."""
    return model.model_dump(mode="json", exclude_defaults=True) | {"error_model": 1}


def fingerprint_of(model: ErrorModel) -> str:
    """Identity of a model: the hash of its canonical JSON."""
    return jsonfile.fingerprint(model_json(model))


def validations_of(model: ErrorModel, folders: Iterable[Path]) -> list[dict[str, Any]]:
    """The validations among those in some stages' folders that judged this very model."""
    documents = [jsonfile.read(folder / VALIDATION) for folder in folders]
    return [v for v in documents if v.get("model") == fingerprint_of(model)]


def write_model(context: Context, recording: Recording, model: ErrorModel, family: Family) -> ErrorModel:
    """Write the error model that a family's fit gave, and that fit; returns the model as written."""
    from errpipe.models import procedure

    inputs = {"recording": context.fingerprint}
    model = model.model_copy(update={"title": context.title or recording.manifest.title, "inputs": inputs})
    model = with_sign_note(model) if sign_assumed([recording]) else model
    context.write_json(MODEL, model_json(model))
    context.write_json(PROCEDURE, procedure(family, fingerprint_of(model)))
    return model


def family_in(folder: Path) -> Family:
    """The model family of an error model in a stage's folder. Raises VerifyError if the stage wrote none, or another's.

    A stage that changes a model and hands on the fit of the unchanged one would be validated by the wrong figures.
    """
    from errpipe.models import family_of

    path, write_both = folder / PROCEDURE, f"a stage that gives an error model writes {MODEL} and {PROCEDURE} with it"
    if not path.is_file():
        raise VerifyError(f"{path}: does not exist; {write_both}")
    document, model = jsonfile.read(path), fingerprint_of(read_model(folder / MODEL))
    if document.get("model", model) != model:  # folders of earlier versions, among them champions, do not name it
        raise VerifyError(f"{path}: is not the fit of the {MODEL} next to it; {write_both} (`_artefacts.write_model`)")
    return family_of(document)


def documents_in(folder: Path, family: Family) -> dict[str, Any]:
    """The further documents of a fit, as far as they are there."""
    return {name: jsonfile.read(folder / name) for name in family.documents if (folder / name).is_file()}


def write_table(folder: Path, table: CompensationTable) -> None:
    """Write a table and its JSON twin. Raises VerifyError if one of the files does not read back as the table."""
    from errpipe.tables import ect

    ect.write(table, folder / TABLE)
    ect.write_json(table, folder / TWIN)
    if ect.read(folder / TABLE) != table or ect.read_json(folder / TWIN) != table:
        raise VerifyError("export: the table read back from its file is not the table that was written")


def _refuse_folder(path: Path, needed: str) -> None:
    """Raise UsageError for a folder, with a table in it if there is one."""
    if path.is_dir():
        inside = next((f for f in ("table.ect", "export/table.ect") if (path / f).is_file()), None)
        raise UsageError(f"{path}: is a folder ({needed} is needed{f': {path / inside}' if inside else ''})")


def read_table(path: Path) -> CompensationTable:
    """A compensation table, binary or JSON twin. Raises DataError without a file, VerifyError if it is not a table."""
    from errpipe.tables import ect

    if not Path(path).exists():
        raise DataError(f"{path}: there is no such file (a compensation table is needed)")
    _refuse_folder(Path(path), "a compensation table")
    return ect.read_either(Path(path))


def model_or_table(path: Path) -> ErrorModel | CompensationTable:
    """The table or error model in a file. Raises DataError for neither, VerifyError for a damaged one."""
    from errpipe.tables import ect

    path = Path(path)
    _refuse_folder(path, "an error model or a compensation table")
    if not path.is_file():
        raise DataError(f"{path}: there is no such file (an error model or a compensation table is needed)")
    if path.suffix == ".ect" or ect.sniff(path):
        return read_table(path)
    if path.suffix != ".json":
        raise DataError(f"{path}: an error model (.json) or a compensation table (.ect, .json) is needed")
    value = jsonfile.read(path)
    if isinstance(value, dict) and "table" in value:
        return read_table(path)
    return read_model(path)
