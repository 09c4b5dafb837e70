"""A recording as a folder: manifest and CSV table, the same bytes for the same rows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from errpipe import jsonfile
from errpipe.domain.manifest_text import manifest_text
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
    return jsonfile.write_text(folder / "recording.yaml", manifest_text(recording.manifest)) or changed
