"""Doors of `errpipe import`: one file per kind of measurement file. A new one is one file here and one entry in DOORS.

A door module has
    name                    as `errpipe formats` lists it
    suffixes                file name endings it is asked for first
    sniff(path, head)       whether the first bytes look like it; never raises
    read(path, options)     -> list of Sheet; raises DataError
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

from errpipe.errors import DataError
from errpipe.importing.doors import delimited, excel, halsampler, hdf5, matlab, mtconnect, tdms
from errpipe.importing.sheet import DoorOptions, Sheet

DOORS: tuple[ModuleType, ...] = (excel, tdms, hdf5, matlab, mtconnect, halsampler, delimited)

MOST_BYTES = 256 << 20  # 256 MB: a larger log belongs in Parquet beside a manifest, which is read in blocks
HEAD_BYTES = 1 << 16


def open_file(path: Path, options: DoorOptions) -> tuple[str, list[Sheet]]:
    """Name of the door that takes a file, and its sheets. Raises DataError."""
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    size = path.stat().st_size
    if size == 0:
        raise DataError(f"{path}: the file is empty")
    if size > MOST_BYTES:
        raise DataError(
            f"{path}: {size >> 20} MB (at most {MOST_BYTES >> 20} MB are imported; write larger logs as CSV or Parquet "
            "beside a recording.yaml, which is read in blocks)"
        )
    with path.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
    for door in DOORS:
        if door.sniff(path, head):
            sheets = door.read(path, options)
            if not any(sheet.rows for sheet in sheets):
                raise DataError(f"{path}: no rows ({door.name})")
            return door.name, sheets
    kinds = ", ".join(door.name for door in DOORS)
    raise DataError(f"{path}: neither text nor any other kind of file that is imported (allowed: {kinds})")
