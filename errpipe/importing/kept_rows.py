"""Rows of a table that are readings: not sums, remarks, figures over the runs, or copies of rows before."""

from __future__ import annotations

import re

import numpy as np

from errpipe.importing import wide
from errpipe.importing.columns import ColumnGuess
from errpipe.importing.header import is_word
from errpipe.importing.layout import Layout
from errpipe.importing.proposed import Proposal
from errpipe.importing.sheet import label


def readings(layout: Layout, guesses: dict[str, ColumnGuess], p: Proposal) -> np.ndarray:
    """Whether each row is a reading; what else is left out is noted in the proposal."""
    out = ~_figures_below(layout, guesses, p) & ~_written_twice(layout, guesses, p)
    return _measured_rows(layout, guesses) & out


def _measured_rows(layout: Layout, guesses: dict[str, ColumnGuess]) -> np.ndarray:
    """Rows in which every position column that has numbers has one."""
    keep = np.ones(len(layout.columns[0].cells), dtype=bool)
    for c in layout.columns:
        if guesses[c.header].kind in ("command", "position") and c.numeric:
            keep &= np.isfinite(c.values)
    numbers = [np.isfinite(c.values) for c in layout.columns if c.numeric]
    return keep & np.any(numbers, axis=0) if numbers else keep & False


def _figures_below(layout: Layout, guesses: dict[str, ColumnGuess], p: Proposal) -> np.ndarray:
    """Rows of figures over the runs: `Mean;400;8.1`. The column of their names has numbers, or other names, above.

    In a column of runs each such name is one; elsewhere they are few.
    """
    rows = len(layout.columns[0].cells)
    out, begun, texts = np.zeros(rows, dtype=bool), np.zeros(rows, dtype=bool), np.zeros(rows)
    for c in layout.columns:
        figure = np.isfinite(c.values)
        words = {int(i): str(c.cells[i]) for i in np.flatnonzero(~figure) if c.cells[i] not in (None, "")}
        after = np.flatnonzero(figure)[-1] if c.numeric else rows  # a word below the last number is no run
        for_all = [i for i, t in words.items() if wide.statistic(t) or (i > after and re.search(r"[^\W\d]", t))]
        named = [i for i in for_all if not begun[i]]  # in the first filled cell of a row: elsewhere it is a remark
        out[named] |= len(named) < 0.2 * rows
        out[[i for i, t in words.items() if guesses[c.header].kind == "run" and wide.is_figure_over_runs(t)]] = True
        texts[[i for i, t in words.items() if c.numeric and is_word(t)]] += 1
        begun |= figure
        begun[list(words)] = True
    numeric = sum(c.numeric for c in layout.columns)
    if numeric > 1:  # lines of facts above the numbers, as wide as they are
        out |= 2 * texts >= numeric
    if out.any():
        first = " ".join(label(c.cells[int(np.argmax(out))]) for c in layout.columns).strip()
        p.notes.append(
            f"{int(out.sum())} rows are figures over the runs, not readings (the first: {first!r}): left out"
        )
    return out


def _written_twice(layout: Layout, guesses: dict[str, ColumnGuess], p: Proposal) -> np.ndarray:
    """Rows from where time goes back to where it goes on, all of them copies of rows before: parts that overlap."""
    clock = next((c for c in layout.columns if guesses[c.header].kind == "time" and c.numeric), None)
    out = np.zeros(len(layout.columns[0].cells), dtype=bool)
    if clock is None or out.size < 2:
        return out
    latest = np.fmax.accumulate(clock.values)
    again = np.r_[False, clock.values[1:] <= latest[:-1]]
    if not (clock.values[1:] < latest[:-1]).any():
        return out
    rows = list(zip(*(c.cells for c in layout.columns), strict=True))
    for stretch in np.split(np.flatnonzero(again), np.flatnonzero(np.diff(np.flatnonzero(again)) > 1) + 1):
        out[stretch] = stretch.size > 1 and set(rows[stretch[0] : stretch[-1] + 1]) <= set(rows[: stretch[0]])
    if out.any():
        p.notes.append(f"{int(out.sum())} rows are copies of rows before, where time goes back: left out")
    return out
