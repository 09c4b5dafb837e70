"""Output of DMIS programs (ISO 22093): nominal (F) and actual features (FA), and coordinate tolerances (TA, CORTOL).

`OUTPUT/FA(P1),TA(T1)` links them to `TA(T1)=TOL/CORTOL,XAXIS,0.0031,INTOL`, a deviation.
"""

from __future__ import annotations

import re
from pathlib import Path

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, ReaderOptions, Sheet

name = "DMIS"
suffixes = (".dmo", ".dmi", ".dms")
_FEATURE = re.compile(r"^\s*(FA?)\(([^)]+)\)\s*=\s*FEAT/\w+,(?:\w+,)?CART((?:,[^,]+){3})", re.MULTILINE)
_TOLERANCE = re.compile(r"^\s*TA\(([^)]+)\)\s*=\s*TOL/CORTOL,([XYZ])AXIS,([^,\s]+)", re.MULTILINE)
_OUTPUT = re.compile(r"^\s*(?:OUTPUT|EVAL)/FA?\(([^)]+)\)(.*)$", re.MULTILINE)
_UNIT = re.compile(r"^\s*UNITS/(MM|CM|M|INCH|FEET)\b", re.MULTILINE)
AXES, KINDS = "XYZ", {"F": "Nominal", "FA": "Actual", "TA": "Deviation"}


def sniff(path: Path, head: bytes) -> bool:
    """Whether a feature is defined."""
    return re.search(rb"^\s*FA?\([^)]+\)\s*=\s*FEAT/", head, re.MULTILINE) is not None


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """A row per feature with a nominal position. Raises DataError if none was measured, and for unknown units."""
    text = re.sub(r"\$\s*\n\s*", "", path.read_text(encoding="latin-1"))
    places = {(kind, label): numbers.strip(",").split(",") for kind, label, numbers in _FEATURE.findall(text)}
    measured = {label: (axis, value) for label, axis, value in _TOLERANCE.findall(text)}
    for feature, rest in _OUTPUT.findall(text):
        for axis, value in (measured[t] for t in re.findall(r"TA\(([^)]+)\)", rest) if t in measured):
            places.setdefault(("TA", feature), [""] * 3)[AXES.index(axis)] = value
    unit = (found[1] if (found := _UNIT.search(text)) else "MM").lower()
    if unit not in ("mm", "inch"):
        raise DataError(f"{path}: UNITS/{unit.upper()} (allowed: MM, INCH)")
    rows: list[list[Cell]] = []
    for label in [label for kind, label in places if kind == "F"]:
        cells = zip(*(places.get((kind, label), [""] * 3) for kind in KINDS), strict=True)
        rows.append([label, *(cell.strip() or None for of_axis in cells for cell in of_axis)])
    if len(places) == len(rows):
        raise DataError(f"{path}: no feature with a nominal (F) and an actual place (FA), or a deviation (TA, CORTOL)")
    header = ["Feature", *(f"{kind} {x} [{unit}]" for x in AXES for kind in KINDS.values())]
    return [Sheet(path.stem, rows, header).limited()]
