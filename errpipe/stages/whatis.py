"""What a file is, in a few lines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from errpipe.errors import DataError
from errpipe.stages import _artefacts

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
    file = Path(file)
    if file.is_dir() or file.name == "recording.yaml":
        return _recording(file)
    if not file.is_file():
        raise DataError(f"{file}: there is no such file")
    if file.suffix == ".ect":
        return _table(file)
    if file.suffix == ".json":
        return _json(file)
    if file.suffix in (".yaml", ".yml"):
        return _pipeline(file)
    from errpipe import formats

    known = [f.name for f in formats.FORMATS if f.sniff(file)]
    if known:
        return {"kind": "measurement file", "format": known[0]}
    raise DataError(f"{file}: neither a table, a model, a pipeline, a recording nor a measurement file of errpipe")


def _table(file: Path) -> dict[str, Any]:
    from errpipe.tables import bounds, held

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
        "held_costs_um": {h.output: round(h.largest, 4) for h in held.outputs(table, otherwise=held.USUAL)},
        "bytes": file.stat().st_size,
        "work_bytes": {"double": bounds.work_bytes(table), "single, 32-bit": bounds.work_bytes(table, real=4)},
    }


def _json(file: Path) -> dict[str, Any]:
    from errpipe import jsonfile

    value = jsonfile.read(file)
    if isinstance(value, dict):
        if "table" in value:
            return _table(file)
        if "error_model" in value:
            return _model(file)
        for key, what in DOCUMENTS.items():
            if value.get(key) == 1:
                return {"kind": what, "version": 1, "keys": sorted(value)}
    raise DataError(f"{file}: JSON, but not a document of errpipe")


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
    }


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
    from errpipe.stages import STAGES

    pipeline = load_pipeline(file, STAGES, sets=[])
    return {"kind": "pipeline", "title": pipeline.title, "stages": [s.label for s in pipeline.stages]}
