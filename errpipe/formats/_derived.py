"""Columns that a manifest derives from others, computed on reading: no later code knows that they were."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from errpipe.domain import units
from errpipe.domain.recording import Manifest

UM_PER_MM = 1e3
URAD_PER_DEG = 1e6 * math.pi / 180


def kinds(manifest: Manifest, usual: Mapping[str, str]) -> dict[str, str]:
    """What is read of each column of a table: derived ones not at all, those they are multiples of as numbers."""
    sources = {c.derived.of for c in manifest.columns.values() if c.derived is not None and c.derived.of is not None}
    stored = {n: kind for n, kind in usual.items() if manifest.columns[n].derived is None}
    return {n: "number" if n in sources else kind for n, kind in stored.items()}


def derive(columns: dict[str, Any], raw: Mapping[str, np.ndarray], rows: int, manifest: Manifest) -> dict[str, Any]:
    """The columns in canonical units with the derived ones, in manifest order, ignored ones left out.

    raw: the numbers as written in the table, by column.
    """
    out = dict(columns)
    ways = {n: (c, c.derived) for n, c in manifest.columns.items() if c.derived is not None}
    for name, (c, way) in ways.items():
        convert = units.conversion(c.role, c.unit)
        if way.of is not None:
            value = way.factor * raw[way.of] + way.offset
        elif way.constant is not None:
            value = np.full(rows, way.constant)
        else:
            continue
        out[name] = value if convert is None else convert(value)
    for name, (_, way) in ways.items():
        if way.minus is not None:
            first, second = way.minus
            converted = units.conversion(manifest.columns[first].role, manifest.columns[first].unit)
            rotary = converted is not None and converted.unit == "deg"
            out[name] = (URAD_PER_DEG if rotary else UM_PER_MM) * (out[first] - out[second])
    return {n: out[n] for n, c in manifest.columns.items() if n in out and c.role != "ignore"}


def stated(manifest: Manifest) -> Manifest:
    """The manifest once the derived columns are columns like all others."""
    plain = {n: c.model_copy(update={"derived": None}) for n, c in manifest.columns.items()}
    return manifest.model_copy(update={"columns": plain})
