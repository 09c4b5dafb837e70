"""Doors for measurements: one file a format. A new format is one file here and one entry in FORMATS.

A format module has
    name                        as it stands in YAML (`format: ecmc_dat`)
    Options                     what a person may say about the file (discriminated by `format`)
    sniff(path) -> bool         whether a path looks like it, from its first bytes; never raises
    read(path, options=None)    -> Recording in canonical units; raises ConfigError or DataError
"""

from __future__ import annotations

import functools
import operator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from errpipe.errors import DataError
from errpipe.formats import ecmc_dat, manifest_folder, renishaw_rtl

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

FORMATS: tuple[ModuleType, ...] = (manifest_folder, ecmc_dat, renishaw_rtl)

AnyOptions = Annotated[functools.reduce(operator.or_, (f.Options for f in FORMATS)), Field(discriminator="format")]


def detect(path: Path) -> ModuleType:
    """The format of a path. Raises DataError naming what is known where none or several fit."""
    path = Path(path)
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    found = [f for f in FORMATS if f.sniff(path)]
    if len(found) != 1:
        names = ", ".join(f.name for f in found or FORMATS)
        what = "fits several formats" if found else f"is of no known format{_hint(path)}"
        raise DataError(f"{path}: {what} (allowed: {names})")
    return found[0]


def read(path: Path, options: Any = None) -> Recording:
    """Read measurements of any known format: the one `options` is for, else the one the path looks like."""
    if options is None:
        return detect(path).read(path)
    return by_name(options.format).read(path, options)


def by_name(name: str) -> ModuleType:
    """The format of a name. Raises KeyError."""
    return {f.name: f for f in FORMATS}[name]


def _hint(path: Path) -> str:
    return f": the folder has no {manifest_folder.MANIFEST}" if path.is_dir() else ""
