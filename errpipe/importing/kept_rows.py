"""Rows of a table that are readings: not sums, comments, statistics over the runs, or duplicates."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from errpipe.errors import DataError
from errpipe.importing import dates, wide
from errpipe.importing.columns import Guesses
from errpipe.importing.header import is_word
from errpipe.importing.layout import Layout, RawColumn
from errpipe.importing.logs import STALE_STEPS
from errpipe.importing.proposed import Proposal
from errpipe.importing.sheet import label


def readings(layout: Layout, guesses: Guesses, p: Proposal) -> np.ndarray:
    """Whether each row is a reading; other exclusions are noted in the proposal."""
    out = ~_figures_below(layout, guesses, p) & ~_written_twice(layout, guesses, p) & ~_repeated(layout, guesses, p)
    measured = _measured_rows(layout, guesses)
    if count := int((out & ~measured).sum()):
        p.notes.append(f"{count} rows without a position, time or reading were excluded (comments, other sensors)")
    return measured & out


MOVING = ("command", "position", "actual", "error")
LESS_FAR = 0.9  # of the row-to-row path of the columns in file order
FALLING = 0.3  # share of the rows that are earlier than the one above: in whole minutes, three rows a minute
OWN_ROWS = 0.5  # share of the rows of positions: with more, a sensor was read there
MOST_REPEATED = 0.1  # share of the rows: above it, the clock of the log is coarse


def in_order_of_time(layout: Layout, guesses: Guesses) -> Layout:
    """The rows sorted by date, if positions and readings then change less from row to row; else in file order.

    A clock that was set back interleaves what it wrote before and after: its order is not that of the readings.
    If no date or clock is later than the one above, and most are earlier, the newest row is the first: the rows are
    reversed. With fewer, a date may stand for a whole run, whose rows are in order.
    """
    clock = next((c for c in layout.columns if guesses[c.header].kind == "time" and not c.numeric), None)
    t, epoch, _ = (dates.seconds(clock) if clock else None) or (np.zeros(1), None, "")
    moving = [c.values for c in layout.columns if guesses[c.header].kind in MOVING and c.numeric and np.any(c.values)]
    of_runs = any(g.kind in ("run", "group") for g in guesses.values())
    order, falls = np.argsort(t, kind="stable"), int((np.diff(t) < 0).sum())
    newest_first = bool((np.diff(t) <= 0).all()) and falls > FALLING * (t.size - 1)
    if not falls or not moving or np.isnan(t).any() or ((of_runs or epoch is None) and not newest_first):
        return layout
    far = [sum(np.nansum(np.abs(np.diff(v[i]))) / np.nanmax(np.abs(v)) for v in moving) for i in (..., order)]
    if far[1] > LESS_FAR * far[0] and not newest_first:
        return layout
    order = np.arange(t.size)[::-1] if newest_first else order
    parts = [c.take(order) for c in layout.columns]
    note = f"{falls} rows were earlier than the row above: rows "
    note += "reversed, the newest was the first" if newest_first else "sorted by date"
    return Layout(parts, layout.above, [*layout.notes, note], layout.below)


SLOW = ("temperature", "pressure", "humidity")  # sensors whose last reading stands for the next seconds


def with_last_sensors(layout: Layout, guesses: Guesses) -> Layout:
    """The layout with the last reading of slow sensors in the rows of positions, if they have rows of their own."""
    clock = next((c for c in layout.columns if guesses[c.header].kind == "time"), None)
    measured = _measured_rows(layout, guesses)
    if clock is None or measured.all() or not measured.any():
        return layout
    t = clock.values if clock.numeric else (dates.seconds(clock) or (clock.values,))[0]
    columns, notes = list[RawColumn](), [*layout.notes]
    for c in layout.columns:
        there = np.isfinite(c.values) & np.isfinite(t)
        columns.append(c)
        if guesses[c.header].kind in SLOW and there.sum() > 1 and not there[measured].mean() > OWN_ROWS:
            rows = np.flatnonzero(there)[np.argsort(t[there], kind="stable")]
            last = np.searchsorted(t[rows], t, side="right") - 1
            at = rows[np.maximum(last, 0)]
            fresh = ~there & (last >= 0) & (t - t[at] <= STALE_STEPS * np.median(np.diff(t[rows])))
            at = np.where(fresh, at, np.arange(at.size))
            columns[-1] = c.take(at)
            notes.append(f"{c.header}: its last reading before each row ({int((fresh & measured).sum())} rows)")
    return Layout(columns, layout.above, notes, layout.below)


def _repeated(layout: Layout, guesses: Guesses, p: Proposal) -> np.ndarray:
    """Rows equal to the row above in every cell, including the time: one reading written twice."""
    rows = list(zip(*(c.cells for c in layout.columns), strict=True))
    out = np.array([False, *(a == b for a, b in pairwise(rows))])
    out &= any(guesses[c.header].kind == "time" for c in layout.columns) and out.mean() <= MOST_REPEATED
    p.notes += [f"{int(out.sum())} duplicates of the row above, including the time: excluded"] if out.any() else []
    return out


def _measured_rows(layout: Layout, guesses: Guesses) -> np.ndarray:
    """Rows with a value in every numeric position column."""
    keep = np.ones(len(layout.columns[0].cells), dtype=bool)
    for c in layout.columns:
        if guesses[c.header].kind in ("command", "position") and c.numeric:
            keep &= np.isfinite(c.values)
    numbers = [np.isfinite(c.values) for c in layout.columns if c.numeric]
    return keep & np.any(numbers, axis=0) if numbers else keep & False


def _figures_below(layout: Layout, guesses: Guesses, p: Proposal) -> np.ndarray:
    """Rows of statistics over the runs: `Mean;400;8.1`. The column of their names has numbers, or other names, above.

    In a column of runs each such name is a statistic; elsewhere they are few.
    """
    rows = len(layout.columns[0].cells)
    out, begun, texts = np.zeros(rows, dtype=bool), np.zeros(rows, dtype=bool), np.zeros(rows)
    for c in layout.columns:
        figure = np.isfinite(c.values)
        words = {int(i): str(c.cells[i]) for i in np.flatnonzero(~figure) if c.cells[i] not in (None, "")}
        after = np.flatnonzero(figure)[-1] if c.numeric else rows  # a word below the last number is not a run
        for_all = [i for i, t in words.items() if wide.statistic(t) or (i > after and re.search(r"[^\W\d]", t))]
        named = [i for i in for_all if not begun[i]]  # in the first filled cell of a row: elsewhere it is a comment
        out[named] |= len(named) < 0.2 * rows
        if guesses[c.header].kind == "run":
            out[[i for i, t in words.items() if wide.is_figure_over_runs(t)]] = True
            last = np.flatnonzero(figure)[-1] if figure.any() else rows
            unknown = next((t for i, t in words.items() if i > last and not out[i]), None)
            if unknown is not None:
                raise DataError(
                    f"{c.header} {unknown!r}, below numbered ones: a run, or a statistic over them? Give it a number "
                    "if it is a run, else delete its rows"
                )
        if c.numeric:  # once a column: it counts the cells
            texts[[i for i, t in words.items() if is_word(t)]] += 1
        begun |= figure
        begun[list(words)] = True
    numeric = sum(c.numeric for c in layout.columns)
    if numeric > 1:  # lines of facts above the numbers, equally wide
        out |= 2 * texts >= numeric
    if out.any():
        first = " ".join(label(c.cells[int(np.argmax(out))]) for c in layout.columns).strip()
        p.notes.append(
            f"{int(out.sum())} rows are statistics over the runs, not readings (the first: {first!r}): excluded"
        )
    return out


def _written_twice(layout: Layout, guesses: Guesses, p: Proposal) -> np.ndarray:
    """Rows from where time goes back to where it continues, all duplicates of earlier rows: overlapping parts."""
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
        p.notes.append(f"{int(out.sum())} rows duplicate earlier rows where time goes back: excluded")
    return out
