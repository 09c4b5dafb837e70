"""A run with nothing to do, without reading the pipeline: from a record of the files that the last full run read.

The note lies with the unfinished work in OUT. It holds the command, the bytes of the pipeline file, the values of the
environment that the file names, where the inputs are, and the lock file's hash. Every input and output is still hashed
as `run` does; whatever differs, or cannot be read, sends the caller back to `run`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from errpipe import files, jsonfile
from errpipe.errors import DataError, ErrpipeError
from errpipe.pipeline import lock
from errpipe.pipeline.lock import LOCK, Record, exclusive_lock, hash_file, label_inputs, read_lock, scratch
from errpipe.pipeline.step import Callbacks, Step

if TYPE_CHECKING:
    from errpipe.pipeline.spec import Pipeline

NOTE = "unchanged.json"
_VARIABLE = re.compile(rb"\$\{([A-Za-z_][A-Za-z0-9_]*)")


def note(pipeline: Pipeline, out: Path, sets: Sequence[str]) -> None:
    """Note a run of all stages that ended well."""
    stages = [[stage.label, [os.fspath(path) for path in stage.inputs()]] for stage in pipeline.stages]
    noted = {"command": _command(pipeline.file, sets), "lock": hash_file(out / LOCK), "stages": stages}
    jsonfile.write(scratch(out) / NOTE, noted | {"title": pipeline.title})


def steps(file: Path, out: Path, sets: Sequence[str], callbacks: Callbacks) -> tuple[str, list[Step]] | None:
    """The title and one fresh step a stage where nothing changed since the note; None where a run must look."""
    if not (scratch(out) / NOTE).is_file():
        return None
    try:
        with exclusive_lock(out, callbacks.waiting):
            noted = jsonfile.read(scratch(out) / NOTE)
            if noted["command"] != _command(file, sets) or noted["lock"] != hash_file(out / LOCK):
                return None
            records = read_lock(out)
            if not all(_is_fresh(name, paths, records, out) for name, paths in noted["stages"]):
                return None
            recorded = [(name, records[name]) for name, _ in noted["stages"]]
            fresh = [Step(n, r.kind, "fresh", (), tuple(sorted(r.outputs)), (), r.summary) for n, r in recorded]
    except (ErrpipeError, OSError, KeyError, TypeError, ValueError):
        return None
    for step in fresh:
        callbacks.finished(step)
    return str(noted["title"]), fresh


def _command(file: Path, sets: Sequence[str]) -> str:
    """Fingerprint of what makes the pipeline: its file, `--set`, the environment it names, the code."""
    data = files.read(file, files.MAX_JSON_BYTES, DataError)
    named = sorted({name.decode() for name in _VARIABLE.findall(data + "\n".join(sets).encode())})
    values = [[name, os.environ.get(name)] for name in named]
    content: list[Any] = [lock.package_code(), os.getcwd(), os.fspath(file), jsonfile.fingerprint_bytes(data)]
    return jsonfile.fingerprint([*content, list(sets), values])


def _is_fresh(name: str, paths: Sequence[str], records: Mapping[str, Record], out: Path) -> bool:
    """Whether a stage's inputs and outputs are those of its record, and nothing was interrupted."""
    record = records[name]
    inputs = {label: hash_file(path) for label, path in label_inputs([Path(path) for path in paths]).items()}
    for other in {other for names in record.sources.values() for other in names}:
        taken = {f"{other}/{file}": digest for file, digest in records[other].outputs.items()}
        inputs |= {label: digest for label, digest in taken.items() if label in record.inputs}  # as `unread` of a stage
    outputs_kept = all(hash_file(out / name / file) == digest for file, digest in record.outputs.items())
    return inputs == record.inputs and outputs_kept and not (scratch(out) / f"{name}.json").exists()
