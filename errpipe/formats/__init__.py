"""Readers of measurement files: one file per format. A new format is one file here and one entry in FORMATS.

A format module has
    name                        as written in YAML (`format: ecmc_dat`)
    Options                     options of the file (discriminated by `format`)
    sniff(path) -> bool         whether a path looks like it, from its first bytes; never raises
    read(path, options=None)    -> Recording in canonical units; raises ConfigError or DataError
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import ValidationError

from errpipe.domain.recording import Recording
from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.formats import ecmc_dat, manifest_folder, renishaw_rtl
from errpipe.formats._magnitude import refuse_impossible

FORMATS: tuple[ModuleType, ...] = (manifest_folder, ecmc_dat, renishaw_rtl)


def detect(path: Path) -> ModuleType:
    """The format of a path. Raises DataError with the known formats if none or several match."""
    path = Path(path)
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    matches = [f for f in FORMATS if f.sniff(path)]
    if len(matches) != 1:
        names = ", ".join(f.name for f in matches or FORMATS) + (
            "" if matches else "; `errpipe import` converts others"
        )
        hint = f": the folder has no {manifest_folder.MANIFEST}" if path.is_dir() else ""
        what = "fits several formats" if matches else f"is of no known format{hint}"
        raise DataError(f"{path}: {what} (allowed: {names})")
    return matches[0]


def read(path: Path, format: str | None = None, options: Mapping[str, Any] | None = None) -> Recording:
    """Read measurements: in the named format, else in the one that recognises the path.

    options: those of the format. Raises UsageError (format, options), ConfigError or DataError.
    """
    reader = detect(path) if format is None else by_name(format)
    try:
        chosen = reader.Options.model_validate(dict(options or {}))
    except ValidationError as err:
        wrong = err.errors()[0]
        key = ".".join(map(str, wrong["loc"])) or "options"
        allowed = [n for n in reader.Options.model_fields if n != "format"]
        raise UsageError(
            f"format {reader.name}, {key}: {wrong['msg'].lower()} (options: {', '.join(allowed) or 'none'})."
            + did_you_mean(key, allowed)
        ) from None
    recording = reader.read(Path(path), chosen)
    for column, facts in recording.manifest.columns.items():
        if facts.role not in ("run", "group", "ignore"):
            refuse_impossible(recording.array(column), facts.role, facts.unit, column, lambda row: str(path))
    return recording


def by_name(name: str) -> ModuleType:
    """The format of a name. Raises UsageError naming the nearest."""
    known = {f.name: f for f in FORMATS}
    if name not in known:
        raise UsageError(f"no format is named {name!r} (allowed: {', '.join(known)}).{did_you_mean(name, known)}")
    return known[name]
