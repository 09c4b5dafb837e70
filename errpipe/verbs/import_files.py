"""`errpipe import`: files as labs and shops have them into a recording folder, every guess shown and confirmed."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from errpipe import formats
from errpipe.domain import components, units
from errpipe.domain.recording import Recording
from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.files import missing
from errpipe.formats import _derived, manifest_folder
from errpipe.importing import (
    archives,
    features,
    named_values,
    order,
    other_tests,
    repeated_runs,
    resolve,
    several_files,
    signs,
    temperatures,
    unstated,
)
from errpipe.importing.columns import with_period
from errpipe.importing.header import is_legend, with_legend
from errpipe.importing.layout import NoReadingError, find_layout, stated_by_name
from errpipe.importing.logs import add_logs
from errpipe.importing.long_form import unstacked
from errpipe.importing.pairs import paired
from errpipe.importing.proposal import propose
from errpipe.importing.proposed import ImportOptions, Proposal, slug
from errpipe.importing.readers import open_file
from errpipe.importing.sheet import ReaderOptions, Sheet, filled_cells
from errpipe.importing.transpose import transposed
from errpipe.importing.units import unit_of
from errpipe.validation import plausibility
from errpipe.verbs._import_folders import folders_of, of_one_axis, only_some, refuse_twice
from errpipe.verbs._import_written import manifest_of, write

__all__ = ["options_of", "plain", "prepare", "write"]

LARGEST_LEGEND = 1 << 16  # bytes of a file that only names channels: 500 lines
TEXTS = (".csv", ".txt", ".tsv")  # endings of such a file
NOTES = 200  # rows of a sheet without a table in which the sign may be stated
MAX_SHEETS = 64  # with measurements, of one file; the rest is not opened


def prepare(files: Sequence[Path], reader: ReaderOptions, options: ImportOptions) -> tuple[Proposal, dict[str, Any]]:
    """The proposed recording of some files, and what is to be shown before it is confirmed.

    A file in an archive is one of them. Raises DataError for a file that cannot be read, UsageError for an option that
    does not fit.
    """
    with tempfile.TemporaryDirectory(prefix="errpipe-") as folder:
        places = {Path(folder) / str(n): Path(file) for n, file in enumerate(files)}
        try:
            opened = {place: archives.unpacked(file, place) for place, file in places.items()}
            inside = {f: folders_of(f, p, places[p]) for p, (of, _) in opened.items() for f in of if f != places[p]}
            notes = [note for _, of in opened.values() for note in of]
            out = _prepared([file for of, _ in opened.values() for file in of], inside, reader, options, notes)
            for text, lines in (r for place in places.values() if place.is_dir() for r in archives.remarks(place)):
                signs.refuse_beside(out[0], lines, text)
            return out
        except (DataError, UsageError) as err:
            message = str(err)
            for place, file in places.items():
                message = message.replace(f"{place}{os.sep}", f"{file}, ")
                message += only_some(file) if message.startswith(f"{file}{os.sep}") and "--" not in message else ""
            raise type(err)(message) from None


def _prepared(
    files: Sequence[Path],
    inside: Mapping[Path, tuple[str, ...]],
    reader: ReaderOptions,
    options: ImportOptions,
    notes: Sequence[str],
) -> tuple[Proposal, dict[str, Any]]:
    parts, sources, empty = {}, [], []
    refuse_twice(files)
    files, left_out = of_one_axis(files, inside, options)
    legends = _legends(files, reader)
    named = [sheet for sheets in legends.values() for sheet in sheets]
    for file in [f for f in map(Path, files) if f not in legends]:
        proposal, source = _of_known_format(file, reader, options), "a format with a reader of its own"
        try:
            if proposal is None:
                proposal, source = _of_any_sheet(file, reader, options, len(files) > 1, named, inside.get(file, ()))
        except NoReadingError as err:
            empty.append(f"{file.name}: {err}: this file is left out")
            continue
        parts[file] = proposal
        sources.append(
            {"file": "/".join((*inside.get(file, ())[1:], file.name)), "kind": source, "rows": proposal.rows}
        )
    for file, sheets in legends.items():
        if not any(f"{s.name!r} names" in note for s in sheets for part in parts.values() for note in part.notes):
            raise DataError(f"{file}: it only names channels, and none of the other files")
        sources.append({"file": file.name, "kind": "names of channels", "rows": len(sheets[0].rows)})
    _refuse_unknown_sets(parts.values(), options)
    names = several_files.names_of_files([*parts], inside)
    unstated.refuse_another_scale(
        dict(zip(names, parts.values(), strict=True)), {*options.sets, *map(slug, options.sets)}
    )
    if not parts:
        raise DataError("\n".join(empty))
    logs = [file for file, part in parts.items() if part.first("error") is None]
    if len(logs) == len(parts):
        _of_any_sheet(logs[0], reader, options)  # raises: what the file lacks
    measured = {file: part for file, part in parts.items() if file not in logs}
    names = several_files.names_of_files([*measured], inside)
    several_files.refuse_states(names, "files", "import the one that is meant")
    if not logs:
        temperatures.of_names(measured.values(), names)
    runs = several_files.sides_of_names([*measured.values()], names)
    complete = several_files.concatenate_files([*measured.values()], runs)
    order.sides_of_falling_runs(complete)
    repeated_runs.separate(complete)
    add_logs(complete, {file: parts[file] for file in logs}, inside)
    complete.notes[:] = [*notes, *left_out, *complete.notes, *empty]
    shown = _shown(complete, sources)
    return complete, {**shown, "checks": _plausible(complete, options)}


def _refuse_unknown_sets(parts: Iterable[Proposal], options: ImportOptions) -> None:
    """Raise UsageError for a `--set` of a column that no file has, or that is made of others: it would be ignored."""
    parts = list(parts)
    known = dict.fromkeys(name for part in parts for name in (*sorted(part.headers), *part.entries))
    written = {*known, *map(slug, known)}
    for name in (n for n in options.sets if n not in written and slug(n) not in written):
        raise UsageError(
            f"--set {name}: no such column (columns: {', '.join(known)}).{did_you_mean(name, list(known))}"
        )
    for part in parts:
        of_file = {*part.headers, *map(slug, part.headers)}
        for name, keys in options.sets.items():
            entry = part.entries.get(part.names.get(name, slug(name)))
            made = entry if entry and name not in of_file else {}
            idle = [k for k in ("role", "unit") if made and keys.get(k, made.get(k)) != made.get(k)]
            if entry is None and name in of_file and keys.get("role", "ignore") in resolve.PLACES:
                idle = ["role"]  # a column of readings of a wide layout
            if idle:
                why = part.guesses.get(part.names.get(name, slug(name)), "its readings become deviations")
                raise UsageError(
                    f"--set {name}.{idle[0]} would be ignored ({why.split(';')[0]}): set it for a file's column, or "
                    "write a column of targets, one of readings, and one of runs"
                )


def _legends(files: Sequence[Path], reader: ReaderOptions) -> dict[Path, list[Sheet]]:
    """The files that name the channels of the others, with their sheets: a list of tags beside their history."""
    texts = [f for f in map(Path, files) if f.suffix.lower() in TEXTS and f.is_file() and len(files) > 1]
    small = [f for f in texts if f.stat().st_size < LARGEST_LEGEND and not any(k.sniff(f) for k in formats.FORMATS)]
    opened = {f: open_file(f, reader)[1] for f in small}
    legends = {f: sheets for f, sheets in opened.items() if all(map(is_legend, sheets))}
    return legends if len(legends) < len(files) else {}


def _of_sheet(sheet: Sheet, reader: ReaderOptions, options: ImportOptions, may_be_log: bool) -> Proposal:
    """The proposal of one sheet: features that were probed, else columns. Raises DataError where it holds neither."""
    proposed = features.proposal(sheet, options)
    if proposed is not None:
        return proposed
    cells = transposed(unstacked(sheet if reader.names else paired(named_values.tabled(sheet))))
    return propose(with_period(find_layout(cells, reader.names), reader.period), options, may_be_log)


def _of_any_sheet(
    file: Path,
    reader: ReaderOptions,
    options: ImportOptions,
    may_be_log: bool = False,
    legends: Sequence[Sheet] = (),
    folders: Sequence[str] = (),
) -> tuple[Proposal, str]:
    """The proposal of the first sheet of a file that holds measurements, and what was opened; others are named.

    folders: names that state what the name of the file does not.
    """
    kind, sheets = open_file(file, reader)
    for sheet in sheets:
        sheet.above += next((lines for name in folders[::-1] if (lines := stated_by_name(name, "folder: "))), [])
    out, problems, asked = list[tuple[Proposal, str]](), dict[str, list[str]](), ""
    for sheet in with_legend([*sheets, *legends])[: len(sheets)]:
        if len(out) == MAX_SHEETS:
            break
        try:
            out.append((_of_sheet(sheet, reader, options, may_be_log), sheet.name))
        except DataError as err:
            if isinstance(err, NoReadingError) and may_be_log and len(sheets) == 1:
                raise
            reason = str(err).removeprefix(f"{sheet.name}: ") if len(sheets) > 1 else str(err)
            problems.setdefault(reason, []).append(sheet.name)
            question = "--" in reason and not reason.startswith(resolve.NO_DEVIATION)
            if question and not out and not asked:
                asked = f"{sheet.name}: {reason}" if len(sheets) > 1 else reason
    if not out:
        hint = "" if features.WHO in asked else other_tests.identify(sheets[:MAX_SHEETS], "" if asked else kind)
        reasons = [f"{', '.join(dict.fromkeys(of))}: {why}" if len(sheets) > 1 else why for why, of in problems.items()]
        if len(reasons) > several_files.MAX_SHEETS_NAMED:
            reasons = [*reasons[: several_files.MAX_SHEETS_NAMED], "and others"]
        raise DataError(f"{file}: {'; '.join(reasons)}{'.' if hint else ''}{hint}")
    if asked:  # the sheet before may be the one that is meant
        raise DataError(f"{file}: {asked}. Or, of the other sheets, --sheet {out[0][1]!r}")
    several_files.refuse_states([name for _, name in out], "sheets", "choose one with --sheet")
    out = several_files.runs_of_sheets(out)
    proposal, name = out[0]
    for sheet in [s for s in sheets if s.name not in [n for _, n in out]]:
        signs.refuse_beside(proposal, (" ".join(map(str, filled_cells(row))) for row in sheet.rows[:NOTES]), sheet.name)
    if len(out) > 1:
        others = ", ".join(other for _, other in out[1 : 1 + several_files.MAX_SHEETS_NAMED])
        proposal.notes.append(f"{name} is imported; other sheets hold measurements too: {others} (--sheet chooses one)")
    return proposal, f"{kind}, {name}" if len(sheets) > 1 else kind


def _of_known_format(file: Path, reader: ReaderOptions, options: ImportOptions) -> Proposal | None:
    """A file of a vendor's own format (`errpipe formats`), as its own reader reads it.

    Raises UsageError for an option whose value such a file states itself: it would be ignored.
    """
    if not file.exists():
        raise DataError(f"{file}: {missing(file)}")
    if not any(f.sniff(file) for f in formats.FORMATS):
        return None
    known = formats.detect(file)
    _refuse_idle_options(file, known.name, {**asdict(reader), **asdict(options)})
    recording = formats.read(file, known.name, {} if options.axis is None else {"axis": options.axis})
    proposal = Proposal(notes=[f"{file.name} is of the format {known.name}: nothing is guessed"])
    taken = getattr(known.Options(), "axis", None)
    if taken is not None and options.axis is None:
        proposal.notes[0] = f"{file.name} is of the format {known.name}, which names no axis: taken as {taken} (--axis)"
    if recording.manifest.machine:
        proposal.facts["machine"] = recording.manifest.machine
    for name, column in recording.manifest.columns.items():
        if name in recording.frame:
            text = column.role in ("run", "group")
            values: Any = recording.frame[name].astype(str).tolist() if text else np.asarray(recording.array(name))
            proposal.put(name, values, **column.model_dump(exclude_none=True))
    return proposal


def _refuse_idle_options(file: Path, name: str, given: dict[str, Any]) -> None:
    """Raise UsageError for an option that a format with a reader of its own does not take."""
    keys = ("component", "unit", "sign", "resolution", "torque_constant", "names", "period", "sheet")
    idle = [key for key in keys if given[key]]
    idle += [f"set {column}.{key}" for column, of in given["sets"].items() for key in of if key in ("role", "unit")]
    if idle:
        raise UsageError(
            f"{file}: of the format {name}, whose columns, units and sign are known: --{idle[0].replace('_', '-')} "
            "would be ignored (allowed: --axis, --title, --machine). Where the file is wrong, correct the "
            "recording.yaml that is written"
        )


def _shown(proposal: Proposal, sources: list[dict[str, Any]]) -> dict[str, Any]:
    """What a person reads before confirming: the files, every column with its guess, the notes."""
    lines = [f"{s['file']}: {s['kind']}, {s['rows']} rows" for s in sources]
    lines += [f"  note: {note}" for note in proposal.notes]
    width = max(len(n) for n in proposal.entries)
    for name, entry in proposal.entries.items():
        facts = [entry["role"], *(str(entry[k]) for k in ("component", "axis", "unit", "of") if entry.get(k))]
        lines.append(
            f"  {name:<{width}}  {' '.join(facts)}"
            + (f"  = {_derivation(entry['derived'])}" if "derived" in entry else "")
        )
        if name in proposal.guesses:
            lines.append(f"  {'':<{width}}    guess: {proposal.guesses[name]}")
    columns = [{"name": n, **e, "guess": proposal.guesses.get(n, "")} for n, e in proposal.entries.items()]
    return {"sources": sources, "notes": proposal.notes, "columns": columns, "says": lines}


def _derivation(derived: dict[str, Any]) -> str:
    if derived.get("minus"):
        return " - ".join(derived["minus"])
    if derived.get("of"):
        return f"{derived.get('factor', 1.0):g} * {derived['of']}"
    return f"{derived['constant']:g}"


def _plausible(proposal: Proposal, options: ImportOptions) -> list[str]:
    """Everything implausible about the proposed recording, in words.

    Raises DataError if the readings are evidence against an assumed sign: a wrong one doubles the error.
    """
    manifest = manifest_of(proposal, options, [Path("x")])
    raw, out = dict(proposal.data), {}
    for name, values in raw.items():
        column = manifest.columns[name]
        try:
            convert = units.conversion(column.role, column.unit)
        except ValueError as err:
            raise UsageError(f"import: {name}: {err}") from None
        out[name] = values if convert is None else convert(values)
    columns = _derived.derive(out, raw, proposal.rows, manifest)
    findings = plausibility.findings(Recording(manifest_folder.canonical(manifest), pd.DataFrame(columns)))
    against = next((f for f in findings if f.of_sign and signs.ASSUMED in proposal.guesses.get(f.column, "")), None)
    if against is not None:
        raise DataError(
            f"{against}. The file does not state its sign: declare it with --sign (commanded-minus-actual, or "
            "actual-minus-commanded: then the reading rises when the axis is jogged beyond a target, in + direction)"
        )
    return [str(f) for f in findings]


def options_of(**stated: Any) -> ImportOptions:
    """Options of the command line. Raises UsageError for a `--set` that is not COLUMN.key=value."""
    sets: dict[str, dict[str, str]] = {}
    keys = ("role", "unit", "axis", "component", "location", "of")
    for text in stated.pop("sets"):
        target, equals, value = text.partition("=")
        name, dot, key = target.rpartition(".")
        if not equals or not dot or not name or key not in keys:
            raise UsageError(f"--set {text}: not of the form COLUMN.key=value (keys: {', '.join(keys)})")
        sets.setdefault(name, {})[key] = value.strip()
        _refuse_no_component(f"--set {text}:" if key == "component" else "", value.strip())
    if unit := unit_of(stated.get("unit") or ""):
        stated["unit"] = unit
    options = ImportOptions(**stated, sets=sets)
    _refuse_no_component("--component", options.component)
    if options.axis is not None and not re.fullmatch(r"[A-CP-SU-Z]\d?", options.axis):  # ISO 841: have components
        raise UsageError(f"--axis {options.axis}: not an axis (allowed: a capital letter such as X, X1, C)")
    return options


def _refuse_no_component(option: str, name: str | None) -> None:
    """Raise UsageError if an option (empty: none) names no component of ISO 230-1."""

    try:
        components.parse(name) if option and name is not None else None
    except ValueError as err:
        raise UsageError(f"{option} {err}") from None


def plain(shown: dict[str, Any]) -> dict[str, Any]:
    """What was shown, without the lines to print."""
    return {k: (asdict(v) if hasattr(v, "__dataclass_fields__") else v) for k, v in shown.items() if k != "says"}
