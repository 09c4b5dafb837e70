"""A recording as a folder: manifest and CSV table, the same bytes for the same rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from errpipe import jsonfile
from errpipe.domain.recording import Column, Constant, Manifest, Recording


def of_one_table(
    title: str, machine: str, columns: Mapping[str, Column], frame: pd.DataFrame, constants: Mapping[str, Constant]
) -> Recording:
    """A recording of one table, which `write` calls recording.csv."""
    facts = {"title": title, "machine": machine, "columns": columns, "constants": constants}
    return Recording(Manifest(recording=1, tables=("recording.csv",), **facts), frame)


def write(folder: Path, recording: Recording) -> bool:
    """Write `recording.yaml` and its first table atomically. True if any byte changed.

    Values are already in canonical units, as stated in the manifest.
    """
    folder = Path(folder)
    table = recording.frame.to_csv(index=False, lineterminator="\n")
    changed = jsonfile.write_text(folder / recording.manifest.tables[0], table)
    return jsonfile.write_text(folder / "recording.yaml", manifest_text(recording)) or changed


def manifest_text(recording: Recording) -> str:
    """The manifest as YAML: one line per column, keys in their own order."""
    plain = recording.manifest.model_dump(mode="json", exclude_defaults=True)
    lines = ["recording: 1"]
    for key in ("title", "machine", "tables"):
        if plain.get(key):
            lines.append(f"{key}: {_flow(plain[key])}")
    for key in ("constants", "columns"):
        if plain.get(key):
            lines.append(f"{key}:")
            lines += [f"  {name}: {_flow(value)}" for name, value in plain[key].items()]
    return "\n".join(lines) + "\n"


def _flow(value: object) -> str:
    """JSON, which is YAML 1.2 in flow style."""
    return json.dumps(value, ensure_ascii=False)
