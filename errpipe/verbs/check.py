"""`errpipe check`: what `run` would refuse of a configuration, all at once, with line and column.

Names are resolved without running anything: manifests are read, headers and the first rows of tables, then every
component, axis, sensor, group, target and machine file of a pipeline is looked up. No heavy package is imported, so
that a check takes a fraction of a second. What only the numbers can show (too few runs, parameters that are not
identifiable) is left to `run`.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from errpipe import files, formats, yamlfile
from errpipe.domain import components, protocols
from errpipe.domain.recording import Manifest, Recording
from errpipe.errors import ConfigError, DataError, ErrpipeError, Problem, did_you_mean

SAMPLE_BYTES = 1 << 20  # of each table that are looked at; a header row has less, too
RAW_TABLES = (".csv", ".tsv", ".xlsx", ".xls", ".ods", ".parquet", ".tdms", ".h5", ".hdf5", ".mat", ".xml")
SAMPLE_ROWS = 400  # rows of each table that are looked at; a wrong column is wrong in its first rows
CALENDAR = ("day", "month", "year")
Place = tuple[str | int, ...]


def problems(pipeline: Any, data: bool = True) -> list[Problem]:
    """Everything wrong with the names of a pipeline that was read; data: whether inputs are looked into."""
    from errpipe.pipeline.spec import missing_inputs

    all_problems = list(missing_inputs(pipeline, pipeline.stages)) if data else []
    absent = {(p.line, p.column) for p in all_problems}
    seen: dict[str, Recording | None] = {}
    for number, stage in enumerate(pipeline.stages):
        try:
            recording, of_source = _source(stage, pipeline, seen, data)
            all_problems, seen[stage.label] = [*all_problems, *of_source], recording
            several = hasattr(stage, "acts_on") and len(pipeline.links.get(stage.label, {}).get("error_model", ())) > 1
            of_stage = _of_stage(stage, None if several else recording)  # its components may be another recording's
            places = [*_machine(stage, data), *of_stage, *_tests(stage, pipeline, seen)]
        except ErrpipeError as err:
            places = [((), str(err))]
        for place, text in places:
            problem = pipeline.document.problem(("stages", number, *place), text)
            if (problem.line, problem.column) not in absent:
                all_problems.append(problem)
    return sorted(set(all_problems))


def ungated_exports(pipeline: Any) -> list[Problem]:
    """Stages that export what nothing judges and do not say so: the gate of a run refuses them (exit code 4)."""
    why = "nothing before it judges its model on held-out rows: add a `validate` stage, or say ungated: true"
    return [
        pipeline.document.problem(("stages", number), why)
        for number, stage in enumerate(pipeline.stages)
        if "validation" in stage.takes
        and not getattr(stage, "ungated", True)
        and not pipeline.links.get(stage.label, {}).get("validation")
    ]


def _source(
    stage: Any, pipeline: Any, seen: Mapping[str, Recording | None], data: bool
) -> tuple[Recording | None, list[Problem]]:
    """The recording that a stage works on (its columns only), and what is wrong with the folder it reads."""
    path = getattr(stage, "recording", None)
    if isinstance(path, Path):
        manifest = path / "recording.yaml" if path.is_dir() else path
        place = ("stages", pipeline.stages.index(stage), "recording")
        if path.is_file() and path.suffix.lower() in RAW_TABLES:
            text = f"{path} is a table, no recording (a folder with recording.yaml; errpipe import writes one)"
            return None, [pipeline.document.problem(place, text)]
        if not data or manifest.name != "recording.yaml" or not path.exists():
            return None, []
        if not manifest.is_file():
            text = f"{path} holds no recording.yaml (errpipe import writes one from measurement files)"
            return None, [pipeline.document.problem(place, text)]
        try:
            return header_of(manifest), []
        except ConfigError as err:
            return None, list(err.problems)
    for names in pipeline.links.get(stage.label, {}).values():
        for name in names:
            if seen.get(name) is not None:
                return seen[name], []
    return None, []


def header_of(path: Path) -> Recording:
    """A recording without rows: its manifest and the columns its tables have. Raises ConfigError with every problem."""
    from errpipe.domain.written_manifest import WrittenManifest

    document = yamlfile.read(path)
    manifest: Any = document.validate(WrittenManifest)
    levels: dict[str, set[str]] | None = {}
    for n, table in enumerate(manifest.tables):
        file = path.parent / table
        if not file.is_file():
            document.problems.append(document.problem(("tables", n), "no such file next to the manifest"))
        elif table.endswith(".parquet"):
            levels = None
        else:
            try:
                table_rows = _sample(file)
            except OSError as err:
                document.problems.append(document.problem(("tables",), f"{file.name} {files.why(err)}"))
                continue
            document.problems += [document.problem(place, text) for place, text in _table(file, table_rows, manifest)]
            levels = _with_levels(levels, table_rows)
    document.raise_problems()
    plain = Manifest.model_validate(manifest.model_dump())
    names = [n for n, c in plain.columns.items() if c.role != "ignore"]
    counts = {name: len(texts) for name, texts in (levels or {}).items()}
    return Recording(plain, SimpleNamespace(columns=names, levels=counts))  # a header, no rows


def _with_levels(levels: dict[str, set[str]] | None, sample: _Sample) -> dict[str, set[str]] | None:
    """The different texts of each column, with those of one more table; None where a table is not known whole."""
    if levels is None or not sample.whole:
        return None
    for k, name in enumerate(sample.header):
        levels.setdefault(name, set()).update(row[k] for row in sample.rows if k < len(row))
    return levels


class _Sample(NamedTuple):
    """Header and first rows of a CSV table, and whether these are all; no header where the text is no CSV."""

    header: list[str]
    rows: list[list[str]]
    whole: bool


def _sample(file: Path) -> _Sample:
    with files.open_regular(file) as stream:
        lines = stream.read(SAMPLE_BYTES).splitlines(keepends=True)
    whole = sum(map(len, lines)) < SAMPLE_BYTES
    try:
        rows = csv.reader(line.decode("utf-8") for line in (lines if whole else lines[:-1]))  # the last may be cut
        return _Sample(next(rows, []), list(rows), whole)
    except (UnicodeDecodeError, csv.Error):
        return _Sample([], [], False)  # `run` reports it with the line of the table


def _table(file: Path, sample: _Sample, manifest: Manifest) -> Iterator[tuple[Place, str]]:
    """What a CSV table's header and first rows say against the manifest."""
    header = sample.header
    if sample.whole and not sample.rows:
        yield ("tables",), f"{file.name} has no rows (a header row and at least one row are needed; half written?)"
    if not header:
        return
    stored = {n: c for n, c in manifest.columns.items() if c.derived is None}
    for name, column in stored.items():
        if name not in header and column.role != "ignore":
            near = did_you_mean(name, header)
            yield ("columns", name), f"{file.name} has no such column (it has: {', '.join(header)}).{near}"
    for name in header:
        if name not in stored:
            near = did_you_mean(name, stored)
            yield (
                ("columns",),
                f"{file.name} has a column {name!r} that is not declared (role ignore is allowed).{near}",
            )
    for k, name in enumerate(header):
        if name not in stored or stored[name].role in ("run", "group", "ignore"):
            continue
        wrong = next((row[k] for row in sample.rows[:SAMPLE_ROWS] if k < len(row) and not _number(row[k])), None)
        if wrong is not None:
            yield ("columns", name), f"{file.name}: {wrong!r} is not a number"


def _number(text: str) -> bool:
    try:
        return text == "" or float(text) == float(text)
    except ValueError:
        return False


# ---------------------------------------------------------------- names of a stage


def _machine(stage: Any, data: bool) -> Iterator[tuple[Place, str]]:
    """A machine file is read where a stage names one; components left out must be of the machine."""
    from errpipe.domain.machine import Machine

    path = getattr(stage, "machine", None)
    if not isinstance(path, Path) or not data or not path.is_file():
        return
    try:
        yamlfile.load(path, Machine)
    except ConfigError as err:
        for problem in err.problems[:5]:
            yield ("machine",), str(problem)
    for k, name in enumerate(getattr(stage, "without", ())):
        try:
            components.parse(name)
        except ValueError as err:
            yield ("without", k), str(err)


def _tests(stage: Any, pipeline: Any, seen: Mapping[str, Recording | None]) -> Iterator[tuple[Place, str]]:
    """Recordings that a machine is identified from say which test they are, and hold its readings."""
    if not getattr(stage, "reads_tests", False):
        return
    for name in pipeline.links.get(stage.label, {}).get("recordings", ()):
        recording = seen.get(name)
        if recording is None or any(components.is_error_motion(c) for c in recording.components()):
            continue
        try:
            text = protocols.missing_readings(recording)
        except DataError as err:
            text = str(err)
        if text:
            yield (), f"recording of {name}: {text}"


def _of_stage(stage: Any, recording: Recording | None) -> Iterator[tuple[Place, str]]:
    """Names in the options of one stage: targets, formats, and against a recording all others."""
    yield from _targets(stage)
    yield from _format(stage)
    if recording is None:
        return
    for k, rule in enumerate(getattr(stage, "rules", ())):
        for j, name in enumerate(getattr(rule, "trust", ())):
            if name not in recording.frame.columns:
                yield ("rules", k, "trust", j), _no_column(recording, name)
    yield from _responses(stage, recording)
    if hasattr(stage, "missing_input") and (lacking := stage.missing_input(recording)):
        yield ("family",) if "family" in stage.model_fields_set else (), lacking
    yield from _holdout(stage, recording)
    yield from _pairs(stage, recording)
    yield from _iso230(recording) if getattr(stage, "iso230_2", False) else ()


def _targets(stage: Any) -> Iterator[tuple[Place, str]]:
    names: Any = getattr(stage, "targets", ())
    if not isinstance(names, tuple) or not names or not all(isinstance(n, str) for n in names):
        return
    from errpipe.targets import TARGETS

    known = TARGETS.tags
    for k, name in enumerate(names):
        if name not in known:
            yield ("targets", k), f"no target {name!r} (errpipe targets lists them).{did_you_mean(name, known)}"
        elif name in names[:k]:
            yield ("targets", k), f"target {name!r} is listed twice"


def _format(stage: Any) -> Iterator[tuple[Place, str]]:
    name = getattr(stage, "format", None)
    if not isinstance(name, str):
        return
    try:
        formats.by_name(name)
    except ErrpipeError as err:
        yield ("format",), str(err)


def _no_column(recording: Recording, name: str) -> str:
    names = list(recording.frame.columns)
    return f"the recording has no column {name!r} (columns: {', '.join(names)}).{did_you_mean(name, names)}"


def _responses(stage: Any, recording: Recording) -> Iterator[tuple[Place, str]]:
    """Components that the recording must hold, and the columns of every term."""
    listed = getattr(stage, "components", None)
    if not isinstance(listed, tuple) or not all(hasattr(c, "terms") for c in listed):
        have = recording.components()
        lacking = [response for response in getattr(stage, "responses", ()) if response not in have]
        yield from ((("component",), _no_response(response, have)) for response in lacking)
        return
    for n, spec in enumerate(listed):
        yield from _component(spec, recording, ("components", n), getattr(stage, "method", "linear"))
    for k, term in enumerate(getattr(stage, "nuisance", ())):
        yield from _term(term, recording, ("nuisance", k))


def _component(spec: Any, recording: Recording, place: Place, method: str) -> Iterator[tuple[Place, str]]:
    """A response to be fitted, and its terms; method: of the fit."""
    have = recording.components()
    if spec.component not in have:
        yield (*place, "component"), _no_response(spec.component, have)
    if not spec.terms:
        yield (*place, "terms"), "no term is named: a component without terms predicts nothing"
    for k, term in enumerate(spec.terms):
        yield from _term(term, recording, (*place, "terms", k))
        if term in spec.terms[:k]:
            yield (*place, "terms", k), "the same term twice: their parameters cannot be distinguished"
    for k, text in _too_many(spec.terms, recording) if method != "ridge" else ():
        yield (*place, "terms", k), text


def _no_response(name: str, have: tuple[str, ...]) -> str:
    return f"the recording has no error of {name} (it has: {', '.join(have) or 'none'}).{did_you_mean(name, have)}"


def _term(term: Any, recording: Recording, place: Place) -> Iterator[tuple[Place, str]]:
    """The columns a term reads, by the term itself; a field that names a temperature must name one."""
    from errpipe.terms import TEMPERATURE

    columns = recording.manifest.columns
    for name, field in type(term).model_fields.items():
        value = getattr(term, name)
        if isinstance(value, str) and TEMPERATURE in field.metadata:
            if value not in recording.frame.columns:
                near = did_you_mean(value, recording.names("temperature"))
                sensors = ", ".join(recording.names("temperature")) or "none"
                yield (*place, name), f"the recording has no column {value!r} (temperatures: {sensors}).{near}"
                return
            if columns[value].role != "temperature":
                yield (*place, name), f"{value!r} is no temperature (role {columns[value].role})"
                return
    try:
        drivers = term.drivers(recording)
    except (KeyError, ErrpipeError) as err:
        key = "axis" if "axis" in type(term).model_fields else ""
        yield (*place, key) if key else place, str(err.args[0] if err.args else err)
        return
    except Exception:  # a term that needs numbers to name its columns is left to `run`
        return
    for name in drivers:
        if name not in recording.frame.columns and name != "row":
            field_name = next((k for k in type(term).model_fields if getattr(term, k) == name), None)
            yield (*place, field_name) if field_name else place, _no_column(recording, name)


def _too_many(terms: Sequence[Any], recording: Recording) -> Iterator[tuple[int, str]]:
    """Terms of one column with more parameters than that column has different values: no rows can distinguish them."""
    from errpipe.terms import Term

    parameters_over: dict[str, int] = {}
    for k, term in enumerate(terms):
        try:
            drivers = term.drivers(recording)
        except Exception:  # reported by `_term`, or left to `run`
            continue
        places = (*recording.names("command"), *recording.names("position"))
        by_place = len(drivers) == 1 and drivers[0] in places
        if not by_place or not term.rowwise or type(term).penalty is not Term.penalty:
            continue
        levels = recording.frame.levels.get(drivers[0])
        count = sum(parameter.name not in term.fixed for parameter in term.linear())
        parameters_over[drivers[0]] = parameters_over.get(drivers[0], 0) + count
        if levels is not None and parameters_over[drivers[0]] > levels:
            yield k, f"{parameters_over[drivers[0]]} parameters over {drivers[0]}, which has {levels} different values"


def _holdout(stage: Any, recording: Recording) -> Iterator[tuple[Place, str]]:
    """The group that is to be held out is a column, a kind of group, or a calendar unit of a dated clock."""
    chosen = getattr(stage, "holdout", None)
    wanted: Any = getattr(chosen, "of", None)
    where: Place = ("holdout", "of")
    if wanted is None and chosen is None and hasattr(stage, "options"):
        wanted, where = getattr(stage.options, "environment", None), ("options", "environment")
        if not isinstance(wanted, str) or "environment" not in stage.options.model_fields_set:
            return
    if wanted is None:
        return
    columns = recording.manifest.columns
    groups = {n for n, c in columns.items() if c.role in ("group", "run")}
    groups |= {str(c.of) for c in columns.values() if c.of}
    dated = any(c.epoch for c in columns.values())
    if wanted in groups or (wanted in CALENDAR and dated):
        return
    if wanted in CALENDAR:
        yield where, f"{wanted!r}: no column of role time has an epoch, so no row has a date"
        return
    yield where, f"the recording has no group {wanted!r} (it has: {', '.join(sorted(groups)) or 'none'})."


def _pairs(stage: Any, recording: Recording) -> Iterator[tuple[Place, str]]:
    """Simulated values where the recording is declared to hold them, or a file to bring them."""
    by = getattr(stage, "by", None)
    if by is None:
        return
    from errpipe.simulation.twin_options import FromCsv, FromRecorded

    if isinstance(by, FromRecorded) and not recording.names("simulated"):
        yield ("by", "kind"), "the recording has no column of role simulated"
    if isinstance(by, FromCsv):
        if getattr(stage, "file", None) is None:
            yield ("by",), "a CSV simulation needs `file`"
        for name in by.columns:
            if name not in recording.components():
                yield ("by", "columns", name), _no_response(name, recording.components())


def _iso230(recording: Recording) -> Iterator[tuple[Place, str]]:
    parsed = [components.parse(c) for c in recording.components()]
    axes = [c.axis for c in parsed if c.kind in ("positioning", "angular positioning")]
    if not axes:
        yield ("iso230_2",), "no positioning deviation (such as EXX) is recorded, so there are no figures of ISO 230-2"
    elif not any(recording.names("direction", axis=axis) for axis in axes):
        yield ("iso230_2",), f"no column holds the direction of {axes[0]}, so there are no figures of ISO 230-2"
