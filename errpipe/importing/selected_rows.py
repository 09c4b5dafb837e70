"""Rows of one axis, and of one machine, if a column of the file names them for each row."""

from __future__ import annotations

import re

import numpy as np

from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing.layout import Layout, RawColumn
from errpipe.importing.proposed import ImportOptions, slug
from errpipe.importing.sheet import label
from errpipe.importing.words import kind_by_name


def one_axis(layout: Layout, options: ImportOptions) -> Layout:
    """Rows of one axis if a column names the axis of each row. Raises DataError if the axis is ambiguous."""
    for c in layout.columns:
        filled = {str(cell).strip() for cell in c.cells if cell not in (None, "")}
        letters = {text.upper() for text in filled}
        axes = filled and not c.numeric and all(re.fullmatch(r"[XYZABCUVW]\d?", letter) for letter in letters)
        if not axes or kind_by_name(c.header) == "direction":
            continue
        axis = options.axis or min(letters)
        if len(letters) > 1 and options.axis is None:
            raise DataError(
                f"column {c.header!r} contains rows of several axes ({', '.join(sorted(letters))}): "
                "select one with --axis; one recording for each"
            )
        if axis not in letters:
            raise DataError(f"column {c.header!r} has no row of axis {axis} (found: {', '.join(sorted(letters))})")
        kept = _rows(layout, c, np.array([str(cell).strip().upper() == axis for cell in c.cells]), axis)
        kept.above[:0] = [f"Axis: {axis}", c.header]
        return kept
    return layout


def of_one_axis(layout: Layout, guesses: guessing.Guesses, options: ImportOptions) -> tuple[Layout, guessing.Guesses]:
    """Columns of one axis if the positions and readings of several stand side by side, in lists of unequal length.

    Raises DataError if no option states the axis, or that tool points were measured, where a row is one state of the
    machine.
    """
    lists: dict[str, np.ndarray] = {}
    for axis in sorted({str(g.axis) for g in guesses.values() if g.axis}):
        of = [c for c in layout.columns if guesses[c.header].axis == axis and c.numeric]
        places = [np.isfinite(c.values) for c in of if guesses[c.header].kind in ("command", "position")]
        if places and any(guesses[c.header].kind == "error" for c in of):
            lists[axis] = np.all(places, axis=0)
    whole = np.all([*lists.values()], axis=0) if lists else np.zeros(0)
    timed = any(g.kind == "time" for g in guesses.values())
    of_points = any(keys.get("component", "").startswith("E_") for keys in options.sets.values())
    if timed or of_points or len(lists) < 2 or all(int(rows.sum()) == int(whole.sum()) for rows in lists.values()):
        return layout, guesses
    stated = options.axis or (options.component or "")[-1:]
    if stated not in lists:
        reading = next(h for h, g in guesses.items() if g.kind == "error" and g.axis in lists)
        lengths = ", ".join(f"{name} {int(rows.sum())}" for name, rows in lists.items())
        raise DataError(
            f"positions and readings of several axes stand side by side (rows: {lengths}): select one with "
            f"--axis {next(iter(lists))}; one recording for each (of tool points: --set '{reading}.component="
            f"E_{guesses[reading].axis}' and so on)"
        )
    own = [c for c in layout.columns if guesses[c.header].axis in (None, stated)]
    note = f"columns of other axes than {stated} were excluded: their lists stand side by side"
    kept = Layout(own, [*layout.above], [*layout.notes, note], layout.below)
    return kept, {c.header: guesses[c.header] for c in own}


def _rows(layout: Layout, by: RawColumn, keep: np.ndarray, value: str) -> Layout:
    """Some rows of a layout, without the column that distinguishes them."""
    kept = [c.take(np.flatnonzero(keep)) for c in layout.columns if c is not by]
    note = f"{int(keep.sum())} of {len(keep)} rows: those with {by.header} = {value}"
    return Layout(kept, [*layout.above], [*layout.notes, note], layout.below)


def one_machine(layout: Layout, options: ImportOptions) -> Layout:
    """Rows of the named machine. Raises DataError if there are rows of several: a table belongs to one of them."""
    for c in layout.columns:
        texts = [label(cell) for cell in c.cells]
        names = sorted({*texts} - {""})
        stated = options.sets.get(c.header) or options.sets.get(slug(c.header)) or {}
        of_machine = kind_by_name(c.header) == "group" and guessing.group_of(c.header) == "machine"
        if not of_machine or c.unit is not None or "role" in stated or not 1 < len(names) <= 0.5 * len(texts):
            continue
        if options.machine not in names:
            raise DataError(
                f"column {c.header!r} contains rows of several machines ({', '.join(names)}): select one "
                f"with --machine; one recording for each (--set '{c.header}.role=group' keeps them together)"
            )
        return _rows(layout, c, np.array([text == options.machine for text in texts]), options.machine)
    return layout
