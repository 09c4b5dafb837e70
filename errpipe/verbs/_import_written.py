"""The recording that an import writes: its manifest with a comment beside every guess, and its table."""

from __future__ import annotations

import csv
import io
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from errpipe import jsonfile
from errpipe.domain import manifest_text
from errpipe.domain.recording import Manifest
from errpipe.errors import DataError, ErrpipeError, UsageError, first_problem
from errpipe.formats import manifest_folder
from errpipe.importing import signs
from errpipe.importing.proposed import ImportOptions, Proposal, slug

TABLE = "recording.csv"
DIGITS = 12  # of a number in the table: more than any instrument has


def write(
    proposal: Proposal, folder: Path, options: ImportOptions, files: Sequence[Path], overwrite: bool = False
) -> dict[str, Any]:
    """Write the confirmed recording: `recording.yaml` with a comment beside every guess, and `recording.csv`.

    Raises DataError and writes nothing where the reader of recordings would refuse it; UsageError where a recording
    stands there that was changed since it was imported, unless `overwrite`.
    """
    if Path(folder).exists() and not Path(folder).is_dir():
        raise UsageError(f"{folder}: is a file (a folder for the recording is needed)")
    manifest = manifest_of(proposal, options, files)
    table, text = _csv(proposal), _commented(manifest_text.manifest_text(manifest), proposal)
    parts = {TABLE: table, manifest_folder.MANIFEST: manifest_text.marked(text, table)}
    if not overwrite:
        _refuse_changed(Path(folder), parts)
    with tempfile.TemporaryDirectory(prefix="errpipe-") as trial:
        for name, text in parts.items():
            jsonfile.write_text(Path(trial) / name, text)
        try:
            manifest_folder.read(Path(trial))
        except ErrpipeError as err:
            reason = str(err).replace(f"{trial}/", "").replace(f"{trial}\\", "")
            raise DataError(
                f"{', '.join(map(str, files))}: nothing was written, for the recording would be refused: {reason}"
            ) from None
    for name, text in parts.items():
        jsonfile.write_text(Path(folder) / name, text)
    return {
        "folder": str(folder),
        "rows": proposal.rows,
        "says": [
            f"{Path(folder) / manifest_folder.MANIFEST}: {proposal.rows} rows, {len(proposal.entries)} columns",
            _next_step(proposal, folder),
        ],
    }


def _next_step(proposal: Proposal, folder: Path) -> str:
    """What to do with the recording: the template for what it holds, or the stage that reads its test."""
    test = proposal.facts.get("protocol")
    if test is not None and test not in ("hole_pattern", "ball_plate"):
        return (
            f"next: a pipeline of the stages ingest (recording: {folder}) and identify, with a machine.yaml, together "
            "with the other tests of this machine (errpipe init --template five-axis DIR shows one)"
        )
    has_place = any(proposal.first(role) for role in ("position", "command"))
    template = "drilled-plate" if test else "laser-iso230" if has_place else "spindle-drift"
    template = "diagnose-log" if proposal.first("simulated") else template
    return f"next: errpipe init --template {template} DIR --recording {folder}"


def _refuse_changed(folder: Path, parts: dict[str, str]) -> None:
    """Raise UsageError if the folder's recording was edited after its import."""
    there = {name: folder / name for name in parts if (folder / name).exists()}
    texts = {name: file.read_text("utf-8", errors="replace") for name, file in there.items()}
    if not there or texts == parts:
        return
    if not manifest_text.is_unchanged(texts.get(manifest_folder.MANIFEST, ""), texts.get(TABLE, "")):
        raise UsageError(
            f"{', '.join(map(str, there.values()))}: changed since it was imported, or not written by an import: "
            "nothing was written. Name another folder with --out, or use --overwrite to replace these files"
        )


def manifest_of(proposal: Proposal, options: ImportOptions, files: Sequence[Path]) -> Manifest:
    """The manifest of a proposed recording. Raises UsageError for what `--set` says that fits no column."""
    title = options.title or ", ".join(Path(f).stem for f in files)
    columns = {name: dict(entry) for name, entry in proposal.entries.items()}
    for written_name, keys in options.sets.items():
        name = slug(written_name)
        if name in columns:  # the unit of a column of the file was stated before its numbers were read
            keep = ("axis", "component", "location", "of", *(("unit",) if name not in proposal.names.values() else ()))
            columns[name] |= {k: v for k, v in keys.items() if k in keep}
    assumed = any(signs.ASSUMED in why for why in proposal.guesses.values())
    facts = proposal.facts | ({"sign": "assumed"} if assumed else {})
    machine = options.machine or facts.pop("machine", "")
    document: dict[str, Any] = {"recording": 1, "title": title, "machine": machine, "tables": [TABLE]}
    document |= {"constants": {name: {"value": text} for name, text in facts.items()}, "columns": columns}
    try:
        return Manifest.model_validate(document)
    except ValidationError as err:
        raise UsageError(f"import: {first_problem(err)}") from None


def _csv(proposal: Proposal) -> str:
    names = [n for n in proposal.entries if n in proposal.data]
    columns = [[_cell_text(v) for v in proposal.data[n]] for n in names]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(zip(*columns, strict=True))
    return stream.getvalue()


def _cell_text(value: Any) -> str:
    if isinstance(value, str):
        return re.sub(r"[\x00-\x1f]+", " ", value)
    return "" if value != value else f"{float(value):.{DIGITS}g}"


def _commented(text: str, proposal: Proposal) -> str:
    lines = []
    for line in text.splitlines():
        name = line.strip().split(":", 1)[0].strip('"')
        why = proposal.guesses.get(name) if line.startswith("  ") else None
        lines.append(f"{line}  # guess, confirmed: {' '.join(why.split())}" if why else line)
    head = ["# Written by errpipe import. Comments say what was guessed and confirmed; correct wrong lines."]
    return "\n".join([*head, *(f"# {' '.join(note.split())}" for note in proposal.notes), *lines, ""])
