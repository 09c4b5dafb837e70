"""Exports in which every channel has its own time column: `t, A, t, B`, with a label in each row above."""

from __future__ import annotations

import re

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, Sheet, decimal_comma, filled_cells, label, number
from errpipe.importing.units import split_header
from errpipe.importing.words import plain

_NAME = re.compile(r"(channel|signal|kanal)? ?name|symbol ?name|signal|channel|kanal")
_UNIT = re.compile(r"units?|einheit")
_SAMPLE = re.compile(r"sampl\w* ?(time|period|interval)|abtastzeit|time|zeit")


def paired(sheet: Sheet) -> Sheet:
    """The sheet with one time column, if rows above the data repeat a label next to the value of each channel.

    `Name;SetPos;Name;ActPos` above `SampleTime[ms];4;SampleTime[ms];4`: the label is above the times. Any other
    sheet unchanged. Raises DataError if the channels have different times.
    """
    rows = [row for row in sheet.rows if filled_cells(row)]
    labelled = {k: row for k, row in enumerate(rows) if _repeats(row)}
    if sheet.header is not None or len(labelled) < 2:
        return sheet
    start = max(labelled) + 1
    by_label = {plain(split_header(label(row[0]))[0]): row for _, row in sorted(labelled.items(), reverse=True)}
    named = next((row for text, row in by_label.items() if _NAME.fullmatch(text)), None)
    comma = decimal_comma(rows[start:])
    data = [row for row in rows[start:] if number(row[0], comma) is not None]
    if named is None or len(data) < 3:
        return sheet
    channels = range(1, len(filled_cells(named)), 2)
    for k in channels[1:]:
        if any(len(row) > k and row[k - 1] not in (None, "") and row[k - 1] != row[0] for row in data):
            raise DataError(
                f"{sheet.name}: {label(named[k])!r} has different times from {label(named[1])!r}: export the same times"
            )
    units = next((row for text, row in by_label.items() if _UNIT.fullmatch(text)), [])
    sample = next((label(row[0]) for text, row in by_label.items() if _SAMPLE.fullmatch(text)), "")
    ticks = split_header(sample)[1] or "s"
    header = [f"time [{ticks}]"]
    for k in channels:
        unit = label(units[k]) if len(units) > k else ""
        header.append(f"{label(named[k])} [{unit}]" if unit else label(named[k]))
    cells: list[list[Cell]] = [[row[0], *(row[k] if len(row) > k else None for k in channels)] for row in data]
    above = [" ".join(map(label, filled_cells(row))) for row in rows[: min(labelled)]]
    notes = [*sheet.notes, f"{len(channels)} channels, each with its own column of times, which are equal"]
    return Sheet(sheet.name, cells, header, notes, above)


def _repeats(row: list[Cell]) -> bool:
    """Whether every second cell of a row, from the first, is the same word."""
    labels = {label(c) for c in row[0::2] if c not in (None, "")}
    again = len(row) > 3 and len(labels) == 1 and row[2] not in (None, "")
    return again and re.search(r"[^\W\d]", labels.pop()) is not None
