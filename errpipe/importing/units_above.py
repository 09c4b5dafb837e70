"""Units stated in lines above a table: of all its columns, or of its readings."""

from __future__ import annotations

import re

import numpy as np

from errpipe.importing.sheet import Cell, filled_cells, label
from errpipe.importing.units import split_header, unit_of, units_in
from errpipe.importing.words import kind_by_name, plain

DEEPEST = 12  # lines above the header in which a line of units is searched for
LARGEST = {"mm": 5.0, "inch": 0.2}  # reading: no axis that is to be compensated has a larger error
UNITS_OF_READINGS = ("um", "mm", "inch", "0.001 inch", "nm", "urad", "arcsec")
UNITS = re.compile(r"(?:(?:y_)?unit|einheit|unidad|unità|unité)(?:s|en|es|_label)?", re.IGNORECASE)


def units_of_columns(rows: list[list[Cell]], end: int, names: list[str]) -> list[str | None]:
    """The units in a line above the header that contains nothing else: `Units,mm,um`, or LabVIEW's `Y_Unit_Label`.

    `Units: inch` (mm, m) applies to the positions; whether also to the readings is inferred from their size.
    """
    width = len(names)
    for row in rows[max(end - DEEPEST, 0) : end]:
        cells = [label(c) for c in row[1:]]
        filled = [label(c).lstrip("#%/;! ") for c in filled_cells(row)]
        if len(filled) == 1 and UNITS.match(filled[0]):
            cells = [word for word in re.split(r"[\s:=]+", filled[0])[1:] if word]
        if not filled or not UNITS.match(filled[0]) or not all(unit_of(c) for c in cells if c):
            continue
        units = [unit_of(c) if c else None for c in cells]
        if units.count(None) == len(units) - 1 and (of_all := next(filter(None, units))) in ("inch", "mm", "m"):
            places = ("command", "position", "actual")
            return [of_all if kind_by_name(n) in places and not split_header(n)[1] else None for n in names]
        if label(row[0]).lower().startswith("y_") or len(row) == width:  # the key is above a column of its own
            return ([None, *units] + [None] * width)[:width]
        if len([u for u in units if u]) == width:
            return [u for u in units if u]
    return [None] * width


def unit_above(lines: list[str], values: np.ndarray) -> str | None:
    """The unit of the readings named in the lines above the table: in a line on readings, else in one on units.

    A line on units may refer to the positions: mm or inch only if no reading is larger than a deviation.
    """
    large = np.abs(values[np.isfinite(values)]).max(initial=0.0)
    readings = r"(abweich|deviation|error|fehler|reading|ecart)"
    clauses = [*lines, *(c for line in lines for c in re.split(r"[,;] |\b(?:and|und|et)\b", line) if c != line)]
    for words in (readings, r"(unit|einheit)"):
        for line in map(plain, clauses):
            of_targets = re.search(rf"(target|position|soll|ziel|nominal|temp)(?!\w* ?{readings})", line)
            if re.search(words, line) and not of_targets:
                for unit in units_in(line)[::-1]:
                    of_positions = words != readings and large > LARGEST.get(unit, np.inf)
                    if (unit in UNITS_OF_READINGS or unit.startswith("0.")) and not of_positions:
                        return unit
    return None
