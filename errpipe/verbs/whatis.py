"""What a file is, in a few lines."""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from errpipe import formats, jsonfile
from errpipe.errors import DataError
from errpipe.pipeline.lock import LOCK
from errpipe.stages import STAGES, _artefacts

DOCUMENTS = {
    "acceptance": "findings that became terms, and why others did not",
    "cleaning": "cleaning report",
    "diagnosis": "diagnosis",
    "export": "export report",
    "fit": "what a fit was asked for",
    "ingest": "ingest report",
    "twin": "where simulated values came from",
    "validation": "validation on held-out rows",
}


def whatis(file: Path) -> dict[str, Any]:
    """Kind, identity and content of any file that errpipe reads or writes. Raises DataError for anything else."""
    from errpipe.tables import ect

    file = Path(file)
    if (file / LOCK).is_file():  # a run folder
        file = file / LOCK
    if (file / "export.json").is_file():
        raise DataError(f"{file}: an export folder (`errpipe verify` proves it; whatis reads its {_artefacts.TABLE})")
    if (file / "objects").is_dir() and (file / "machines").is_dir():
        raise DataError(f"{file}: a registry (`errpipe log` shows what is on which machine)")
    if file.is_dir() or file.name == "recording.yaml":
        return _recording(file)
    if not file.is_file():
        raise DataError(f"{file}: there is no such file")
    if file.suffix == ".ect" or ect.sniff(file):
        return _table(file)
    if file.suffix == ".json":
        return _json(file)
    if file.suffix in (".yaml", ".yml"):
        return _pipeline(file)

    known = [f.name for f in formats.FORMATS if f.sniff(file)]
    if known:
        return {"kind": "measurement file", "format": known[0]}
    if file.suffix == ".lock":
        return _json(file)
    description = _report(file) or _controller_file(file) or _importable(file)
    if description is not None:
        return description
    raise DataError(f"{file}: neither a table, a model, a pipeline, a recording nor a measurement file of errpipe")


def _table(file: Path) -> dict[str, Any]:
    from errpipe.tables import bounds, hold_lag

    table = _artefacts.read_table(file)
    always, thermal = bounds.cost(table)
    return {
        "kind": "compensation table",
        "machine": table.machine,
        "title": table.title,
        "model": table.fingerprint[:16],
        "errpipe": table.version,
        "cycles_s": [table.position_cycle_s, table.thermal_cycle_s],
        "inputs": [f"{i.name} ({i.kind}{', ' + i.unit if i.unit else ''})" for i in table.inputs],
        "valid": {i.name: i.valid for i in table.inputs if i.valid},
        "components": [c.name for c in table.components],
        "outputs": [f"{o.name} -> {o.axis or '-'}, limit {o.magnitude} {o.unit}" for o in table.outputs],
        "profiles": len(table.profiles),
        "operations": {"position cycle": always.operations, "with thermal cycle": thermal.operations},
        "cortex_m4_instructions_at_most": bounds.cortex_m4_instructions(table),
        "held_costs_um": {h.output: round(h.largest, 4) for h in hold_lag.outputs(table, otherwise=hold_lag.USUAL)},
        "bytes": file.stat().st_size,
        "work_bytes": {"double": bounds.work_bytes(table), "single, 32-bit": bounds.work_bytes(table, real=4)},
    }


def _json(file: Path) -> dict[str, Any]:
    value = jsonfile.read(file)
    if isinstance(value, dict):
        if "table" in value:
            return _table(file)
        if "error_model" in value:
            return _model(file)
        if "errpipe_lock" in value and isinstance(value.get("stages"), dict):
            return {"kind": "lock of a run", "version": value["errpipe_lock"], "stages": list(value["stages"])}
        for key, what in DOCUMENTS.items():
            if value.get(key) == 1:
                return {"kind": what, "version": 1, "keys": sorted(value)}
    raise DataError(f"{file}: JSON, but not a document of errpipe")


def _report(file: Path) -> dict[str, Any] | None:
    """A page that errpipe wrote, by its title and last line."""
    if file.suffix != ".html":
        return None
    text = file.read_text(encoding="utf-8", errors="replace")
    title, version = re.search(r"<title>([^<]*)</title>", text), re.search(r'class="lead">[^<]*errpipe ([\w.]+)', text)
    if title is None or version is None:
        return None
    return {"kind": "report", "title": html.unescape(title.group(1)), "errpipe": version.group(1)}


MAX_CONTROLLER_BYTES = 4 << 20  # a larger file is not tried as a controller's


def controller_curves(file: Path) -> list[tuple[Any, list[Any]]]:
    """The targets that read a file as their own, each with its curves; by its folder, else by trying."""
    from errpipe.targets import TARGETS

    if file.suffix in TABLE_SUFFIXES and file.parent.name not in TARGETS.tags:
        return []  # any table of numbers would pass
    if file.stat().st_size > MAX_CONTROLLER_BYTES:
        return []
    text = file.read_bytes().decode("utf-8", "replace")
    readings = []
    for target in [TARGETS[file.parent.name]] if file.parent.name in TARGETS.tags else TARGETS:
        try:
            curves = list(target.read_back({file.name: text}).curves)
        except Exception:  # whatever a reader raises of a file that is not its own
            continue
        if curves:
            readings.append((target, curves))
    return readings


TABLE_SUFFIXES = (".csv", ".tsv", ".txt", ".dat", ".log", ".xlsx", ".json", ".md", ".html", "")


def _controller_file(file: Path) -> dict[str, Any] | None:
    readings = controller_curves(file)
    if not readings:
        return None
    curves = [f"{c.axis} over {c.over}, {len(c.positions)} points" for c in readings[0][1]]
    names = [f"{target.name} ({target.controller})" for target, _ in readings]
    return {"kind": "controller file", "target": " or ".join(names), "sign": readings[0][0].sign, "curves": curves}


def _importable(file: Path) -> dict[str, Any] | None:
    """A file that the import opens."""
    from errpipe.importing.readers import reader_of

    reader = reader_of(file)
    return None if reader is None else {"kind": "measurement file", "format": reader.name, "next": "errpipe import"}


def _model(file: Path) -> dict[str, Any]:
    model = _artefacts.read_model(file)
    return {
        "kind": "error model",
        "machine": model.machine,
        "title": model.title,
        "errpipe": model.version,
        "components": {
            c.component: [f"{t.term['term']}: " + ", ".join(_parameter_text(p) for p in t.parameters) for t in c.terms]
            for c in model.components
        },
        "valid": dict(model.validity.ranges),
    } | ({"notes": list(model.notes)} if model.notes else {})


def _parameter_text(p: Any) -> str:
    interval = f" ({p.ci95[0]:.4g} .. {p.ci95[1]:.4g})" if p.ci95 else ""
    return f"{p.name} {p.value:.4g}{interval} {p.unit}"


def _recording(path: Path) -> dict[str, Any]:
    from errpipe.formats import manifest_folder

    manifest = manifest_folder.load_manifest(path)
    return {
        "kind": "recording",
        "title": manifest.title,
        "machine": manifest.machine,
        "tables": list(manifest.tables),
        "columns": {name: c.role for name, c in manifest.columns.items()},
    }


def _pipeline(file: Path) -> dict[str, Any]:
    from errpipe.pipeline.spec import load_pipeline

    pipeline = load_pipeline(file, STAGES, sets=[])
    return {"kind": "pipeline", "title": pipeline.title, "stages": [s.label for s in pipeline.stages]}
