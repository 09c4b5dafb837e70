"""Wide layouts: a row per target, a column per run (and direction). Unfolded into one reading a row."""

from __future__ import annotations

import re

import numpy as np

from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing.layout import Layout, RawColumn, unit_of

_RUN = re.compile(r"\d+")
_SIGN = re.compile(r"([+\-−↑↓→←])\s*$")
KINDS = ("ignore", "error", "run", "direction", "actual", "position", "command")


class Wide:
    """The target column, and the run and side (+1, -1, None) of every column of readings."""

    def __init__(self, target: RawColumn, readings: list[tuple[RawColumn, str, float | None]]):
        self.target, self.readings = target, readings


def run_and_side(header: str) -> tuple[str | None, float | None]:
    """'Lauf 2 auf' -> ('2', +1); '3-' -> ('3', -1); 'Run 1' -> ('1', None)."""
    text = header.strip()
    side = None
    sign = _SIGN.search(text)
    if sign:
        side = guessing.side("-" if sign.group(1) == "−" else sign.group(1))
        text = text[: sign.start()]
    else:
        words = re.split(r"[\s_.\-/]+", text.lower())
        for word in words[::-1]:
            if not word.isdigit() and word not in ("pos", "u", "d", "ab.") and (found := guessing.side(word)):
                side = found
                break
    numbers = _RUN.findall(text)
    return (numbers[-1] if numbers else None), side


def find(layout: Layout, guesses: dict[str, guessing.ColumnGuess]) -> Wide | None:
    """The wide layout of a table, or None where a row is one reading."""
    numeric = [c for c in layout.columns if c.numeric]
    targets = [
        c for c in numeric if guesses[c.header].kind in ("command", "position") and run_and_side(c.header)[0] is None
    ]
    if not targets and numeric and _rises(numeric[0]):
        targets = numeric[:1]
    if len(targets) != 1:
        return None
    readings = []
    for c in numeric:
        run, side = run_and_side(c.header)
        if c is targets[0] or guesses[c.header].kind not in KINDS or (run is None and side is None):
            continue
        readings.append((c, run or "1", side))
    pairs = {(run, side) for _, run, side in readings}
    if len(readings) < 2 or len(pairs) < len(readings):
        return None
    return Wide(targets[0], readings)


def _rises(c: RawColumn) -> bool:
    x = c.values[np.isfinite(c.values)]
    return x.size > 2 and bool(np.all(np.diff(x) > 0) or np.all(np.diff(x) < 0))


def unfold(found: Wide) -> tuple[np.ndarray, list[str], np.ndarray, np.ndarray]:
    """Row of the table, run, side and reading of every reading: runs after one another.

    A pass down goes through the targets as they fall. Raises DataError where no row has a target and a reading.
    """
    target, readings = found.target.values, [c for c, _, _ in found.readings]
    keep = np.isfinite(target) & np.any([np.isfinite(c.values) for c in readings], axis=0)
    rows = np.flatnonzero(keep)
    if not rows.size:
        raise DataError("no row holds a target and a reading")
    rising = target[rows[-1]] > target[rows[0]]
    order, run, side, value = [], [], [], []
    for c, label, way in found.readings:
        own = rows if way is None or rising == (way > 0) else rows[::-1]
        own = own[np.isfinite(c.values[own])]
        order.append(own)
        run += [label] * own.size
        side += [np.nan if way is None else way] * own.size
        value.append(c.values[own])
    return np.concatenate(order), run, np.array(side), np.concatenate(value)


def unit_above(lines: list[str]) -> str | None:
    """The unit of the readings that the lines above the table name."""
    for line in lines:
        if re.search(r"(unit|einheit|abweich|deviation|error|fehler|reading)", line, re.IGNORECASE):
            for word in re.split(r"[\s\[\]():;,=]+", line)[::-1]:
                if unit_of(word) in ("um", "mm", "inch", "thou", "nm", "urad", "arcsec"):
                    return unit_of(word)
    return None
