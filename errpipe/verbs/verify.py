"""Exported files read again and proved: checksums, twins, the model behind the table, every controller's file."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from errpipe import jsonfile
from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.domain.table import CompensationTable
from errpipe.errors import DataError, VerifyError
from errpipe.files import inside
from errpipe.fitting.components import evaluate
from errpipe.guard.in_table import without_guard
from errpipe.stages import _artefacts
from errpipe.stages._replace import refuse_interrupted
from errpipe.stages.predict import table_values
from errpipe.stages.targets import CHECKLIST, in_words, losses
from errpipe.tables import bounds, ect
from errpipe.targets import TARGETS

STATES = 2000  # random states at which table and model are compared
SAME_UM = 5e-6  # of a loss: more than the last of the digits that `export.json` keeps


def verify(folder: Path) -> dict[str, Any]:
    """Prove everything in an export folder, or a table alone. Raises VerifyError on the first that does not hold."""
    folder = Path(folder)
    if folder.is_file() and (folder.suffix in (".ect", ".json") or ect.sniff(folder)):
        name = ect.fingerprint(_artefacts.read_table(folder))
        holds = f"table {name}: checksum, layout and limits hold (its export folder would prove its model)"
        return {"checks": 1, "says": [f"{folder.name}: {holds}"]}
    if (folder / "objects").is_dir() and (folder / "machines").is_dir():
        raise VerifyError(f"{folder}: a registry, which `errpipe log {folder} --public-key KEY` verifies")
    if not folder.exists():
        raise DataError(f"{folder}: there is no such folder (what an export wrote is needed)")
    if not folder.is_dir():
        raise DataError(f"{folder}: is no table (one, or the folder that an export wrote is needed: {folder.parent})")
    if not (folder / "export.json").is_file():
        below = sorted(p.parent for depth in ("*", "*/*") for p in folder.glob(f"{depth}/export.json"))
        hint = f". Did you mean {below[0]}?" if below else ""
        raise VerifyError(f"{folder}: holds no export.json, so nothing here was exported by errpipe{hint}")
    listed = jsonfile.read(folder / "export.json")
    refuse_interrupted(folder / "export.json", listed)
    document = _checked_document(folder / "export.json", listed)
    table = ect.read(folder / _artefacts.TABLE)
    checks = [f"{_artefacts.TABLE}: checksum, layout and limits hold"]
    if ect.read_json(folder / _artefacts.TWIN) != table:
        raise VerifyError(f"{folder / _artefacts.TWIN}: is not the twin of {_artefacts.TABLE}")
    checks.append(f"{_artefacts.TWIN}: holds the same table")
    if (folder / _artefacts.MODEL).is_file():
        checks.append(_model(folder, table))
    checks += _targets(folder, table, document)
    checks.append(_checksums(folder, document))
    return {"checks": len(checks), "says": checks}


def _checked_document(path: Path, document: Any) -> dict[str, Any]:
    """The document, whose files and checksums have the types that an export writes. Raises VerifyError."""
    rows, sums = (document.get("files"), document.get("sha256", {})) if isinstance(document, dict) else (None, None)
    numbers = ("bound_um", "largest_um", "rms_um", "table_rms_um", "constant_um", "states")

    def sound(row: Any) -> bool:
        if not isinstance(row, dict) or not all(isinstance(row.get(key), str) for key in ("file", "error")):
            return False
        lost = row.get("losses", [])
        return isinstance(lost, list) and all(
            isinstance(x, dict)
            and isinstance(x.get("axis"), str)
            and all(isinstance(x.get(key, 0), int | float) for key in numbers)
            for x in lost
        )

    if not isinstance(rows, list) or not all(map(sound, rows)):
        raise VerifyError(f"{path}: its list of files is not one that an export writes")
    if not isinstance(sums, dict) or not all(isinstance(digest, str) for digest in sums.values()):
        raise VerifyError(f"{path}: its checksums are not those that an export writes")
    return document


def _model(folder: Path, table: CompensationTable) -> str:
    """The table beside its model on random states and all corners of validity, both directions, after settling."""
    path = folder / _artefacts.MODEL
    model = _artefacts.read_model(path)
    if jsonfile.fingerprint(_artefacts.model_json(model)) != table.fingerprint:
        raise VerifyError(f"{path}: is not the model that {_artefacts.TABLE} was compiled from")
    states = every_state(model)
    by_model, by_table = evaluate(model, states), table_values(without_guard(table), model, states)
    allowed = {c.name: c.gridding for c in bounds.components(table)}
    worst = 0.0
    for name, values in by_table.items():
        difference = float(np.nanmax(np.abs(values - by_model[name])))
        if not difference <= 2 * allowed.get(name, 0.0) + 2e-3:
            raise VerifyError(
                f"{path}: {name} of the table differs from the model by {difference:.4g} um inside validity"
            )
        worst = max(worst, difference)
    return f"{_artefacts.MODEL}: the table gives it back within {worst:.3g} um on {len(states)} states"


def every_state(model: ErrorModel) -> Recording:
    """Random states of a model's columns inside validity, with its ends, as runs that settle; two rows a run matter.

    Each run starts in the middle of validity, jumps to its state, and stays there until every lag has settled.
    """
    rng = np.random.default_rng(1)
    kinds = {name: Column.model_validate(facts) for name, facts in model.columns.items()}
    frame = {"run": np.repeat(np.arange(STATES).astype(str), 3), "t": np.tile([0.0, 1e9, 2e9], STATES)}
    for name, kind in kinds.items():
        low, high = model.validity.ranges.get(name, (0.0, 1.0))
        drawn = rng.uniform(low, high, STATES)
        ends = rng.random(STATES)
        drawn = np.where(ends < 0.15, low, np.where(ends > 0.85, high, drawn))
        values = np.column_stack([np.full(STATES, (low + high) / 2), drawn, drawn])
        if kind.role == "direction":
            values = np.repeat(np.where(rng.random(STATES) < 0.5, 1.0, -1.0), 3).reshape(STATES, 3)
        if kind.role == "coolant":
            values = np.round(values)
        frame[name] = values.ravel()
    kinds = {"run": Column(role="run"), "t": Column(role="time", unit="s"), **kinds}
    manifest = Manifest(recording=1, tables=("states.csv",), columns=kinds, constants=model.constants)
    return Recording(manifest, pd.DataFrame({name: frame[name] for name in kinds}))


def _targets(folder: Path, table: CompensationTable, document: dict[str, Any]) -> list[str]:
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in document["files"]:
        inside(folder, row["file"], VerifyError)
        if "/" in row["file"]:
            groups.setdefault(row["file"].split("/")[0], []).append(row)
    checks = []
    for name, rows in groups.items():
        if name not in TARGETS.tags:
            raise VerifyError(f"{folder}: export.json lists files of {name!r}, which is no target of this version")
        target = TARGETS[name]
        files = {}
        for row in rows:
            path = inside(folder, row["file"], VerifyError)
            _check_digest(path, document.get("sha256", {}).get(row["file"]))
            files[path.name] = path.read_text(encoding="utf-8")
        lost = losses(table, target, files)
        if not document.get("sha256") and not ("losses" in rows[0] and _comparable(lost, rows[0])):
            raise VerifyError(
                f"{folder / name}: cannot be verified: export.json keeps no checksum of its files and no "
                "losses to compare; export again"
            )
        if not _is_same_loss(lost, rows[0]):
            before = rows[0]["error"]
            raise VerifyError(f"{folder / name}: now loses {in_words(lost)}; it lost {before} when it was exported")
        checks.append(f"{name}: read back as the controller does; loses {in_words(lost)}")
        beside = sorted({p.name for p in (folder / name).iterdir()} - files.keys() - {CHECKLIST})
        checks += [f"{name}/{other}: NOT of this export, and not proved: load it only on purpose" for other in beside]
    return checks


def _comparable(lost: list[dict[str, Any]], row: dict[str, Any]) -> bool:
    """Whether a loss was measured on the states of the export's, and without its constant."""
    exported = {x["axis"]: x for x in row.get("losses", lost)}
    return all(x.get("states") == y["states"] and "constant_um" in x for x in exported.values() for y in lost)


def _is_same_loss(lost: list[dict[str, Any]], row: dict[str, Any]) -> bool:
    """Whether a loss is that of the export. One measured on other states, by another version, cannot be compared."""
    exported = {x["axis"]: x for x in row.get("losses", lost)}
    if set(exported) != {x["axis"] for x in lost}:
        return False
    figures = ("bound_um", "largest_um", "rms_um", "table_rms_um") if _comparable(lost, row) else ()
    return all(abs(x[key] - exported[x["axis"]].get(key, x[key])) <= SAME_UM for x in lost for key in figures)


def _check_digest(path: Path, expected: str | None) -> None:
    """Raise VerifyError if a file is missing, or is not the one that was exported."""
    if not path.is_file():
        raise VerifyError(f"{path}: is missing")
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    if expected is not None and digest != expected:
        raise VerifyError(
            f"{path}: was changed after it was exported (SHA-256 {digest[:12]}..., export.json: {expected[:12]}...)"
        )


def _checksums(folder: Path, document: dict[str, Any]) -> str:
    known = document.get("sha256", {})
    for name, expected in known.items():
        _check_digest(inside(folder, name, VerifyError), expected)
    if not known:
        return "no checksums of single files: exported by an errpipe that did not keep them; export again"
    return f"SHA-256 of {len(known)} files, as exported"
