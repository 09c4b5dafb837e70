"""Logs with one row per value (signal, time, value), as historians and databases export them: one column per signal."""

from __future__ import annotations

import re

import numpy as np

from errpipe.importing import quality
from errpipe.importing.dates import refuse_clock_set_back, seconds
from errpipe.importing.header import is_moment, is_word
from errpipe.importing.layout import RawColumn
from errpipe.importing.sheet import Cell, Rows, Sheet, decimal_comma, label, number
from errpipe.importing.words import plain

MOST_SIGNALS = 60  # distinct names in one column; with more it contains comments
MOST_COLUMNS = 12  # signal, time, value, unit, quality, and additions of a database
FEWEST_VALUES = 3  # of each signal
_SIGNAL = re.compile(
    r"(signal|serie|series|tag|var|topic|channel|kanal|name|variable|sensor|field|point|measure(?:ment)?|messstelle|item|path|node"
    r"|data ?item|metric|symbol|display|entity|(sub ?)?type)( ?(name|id))?"
)
_VALUE = re.compile(
    r"(?:var ?|measure )?(value|state|payload|wert|reading|messwert|valeur|valore|valor)"
    r"( ?\(?(float|double|num(ber|eric)?)\)?|::(double|bigint))?"
)
_DATA_ITEM = re.compile(r"data ?item ?(id)?")  # of MTConnect: an identifier beside the name, such as `x2`
_NODE = re.compile(r"^ns=\d+;[sigb]=")  # of an OPC UA server, before the name
_TICKS = re.compile(r"1\d{9}(\d{3}){0,3}(\.\d+)?")  # since 1970, from 2001 to 2033
_LABELLED = re.compile(r"([^\W\d][\w:]*)\{(.*)\}")  # `axis_x_mm{job="mill"}` of Prometheus
_UNIT = re.compile(r"(?:eng(?:ineering)? ?)?(unit|einheit|units|unite|uom)s?")


def unstacked(sheet: Sheet) -> Sheet:
    """The sheet with one row per time and one column per signal; any other sheet unchanged.

    A sheet has this form if one column names signals, one contains dates and one numbers, or if its header states
    so. Values of one time share one row; signals of other times are empty there.
    """
    rows = [r for r in sheet.rows if any(c not in (None, "") for c in r) and not label(r[0]).startswith("#")]
    rows = [row for k, row in enumerate(rows) if k == 0 or row != rows[0]]
    header = [plain(label(c)).strip() for c in (sheet.header or (rows[0] if rows else []))]
    body = rows if sheet.header is not None or not _is_header(rows) else rows[1:]
    header = header if sheet.header is not None or len(body) < len(rows) else []
    widths = {len(row) for row in body} | ({len(header)} if header else set())
    if len(body) < 2 * FEWEST_VALUES or len(widths) > 1 or not 3 <= len(body[0]) <= MOST_COLUMNS:
        return sheet
    at = _columns(header, body)
    if at is None:
        return sheet
    names, time, value, unit = at
    qualities = [i for i, text in enumerate(header) if quality.is_quality(text) and i not in (*names, time, value)]
    each = [quality.bad([row[i] for row in body], header[i]) for i in qualities]
    wrong = np.any(each, axis=0) if each else None
    counts: dict[str, int] = {}
    stamps: dict[str, list[Cell]] = {}
    table: dict[str, dict[str, Cell]] = {}
    for k, row in enumerate(body):
        signal = " ".join(filter(None, (_NODE.sub("", label(row[i])) for i in names))) + (
            f" [{label(row[unit])}]" if unit is not None and row[unit] else ""
        )
        counts[signal] = counts.get(signal, 0) + 1
        stamps.setdefault(signal, []).append(row[time])
        table.setdefault(label(row[time]), {}).setdefault(
            signal, None if wrong is not None and wrong[k] else row[value]
        )
    few = [s for s, n in counts.items() if n < FEWEST_VALUES]
    if len(counts) > MOST_SIGNALS or len(counts) - len(few) < 2:
        return sheet
    counts = {s: n for s, n in counts.items() if s not in few}
    for signal in counts:  # before values of one hour are merged with those of the next one of the same name
        column = RawColumn(
            header[time] if header else "time", None, stamps[signal], np.full(len(stamps[signal]), np.nan)
        )
        if (since := seconds(column)) is not None:
            refuse_clock_set_back(column, since[0])
    again = sum(counts.values()) - sum(sum(s in counts for s in values) for values in table.values())
    if again:
        sheet.notes.append(f"{again} duplicate values of a signal at one time were excluded")
    if wrong is not None and wrong.any():
        sheet.notes.append(f"{int(wrong.sum())} values of bad quality were excluded")
    left = [f"signals with fewer than {FEWEST_VALUES} values were excluded: {', '.join(few)}"[:160]] if few else []
    note = f"one row per value: {len(counts)} signals became columns"
    out: Rows = [[when, *(values.get(s) for s in counts)] for when, values in table.items()]
    return Sheet(sheet.name, _by_time(out), ["time", *_bare([*counts])], [*sheet.notes, note, *left])


def _bare(signals: list[str]) -> list[str]:
    """The signals without the labels in braces that a monitor adds, where they are distinct without them."""
    names = [match[1] if (match := _LABELLED.fullmatch(s)) else s for s in signals]
    return names if len({*names}) == len(names) else [_LABELLED.sub(r"\2 \1", s) for s in signals]


def _by_time(rows: Rows) -> Rows:
    """Rows sorted by date: an export may list one signal after the other."""
    since = seconds(RawColumn("time", None, [row[0] for row in rows], np.full(len(rows), np.nan)))
    return rows if since is None else [rows[i] for i in np.argsort(since[0], kind="stable")]


def _is_header(rows: Rows) -> bool:
    figures = re.compile(r"[\d.,]|(?<!:):(?!:)")  # `measure_value::double` is a name
    return len(rows) > 1 and not any(figures.search(label(c)) for c in rows[0]) and not all(map(is_word, rows[1]))


def _columns(header: list[str], body: Rows) -> tuple[list[int], int, int, int | None] | None:
    """Indices of signal, time, value and unit (or None) columns; None if the sheet has another form."""
    comma = decimal_comma(body)
    columns = range(len(body[0]))
    sample = body[:200]
    moments = [i for i in columns if all(is_moment(row[i]) for row in sample)]
    moments = moments or [i for i in columns if not header and all(_TICKS.fullmatch(label(row[i])) for row in sample)]
    numbers = [i for i in columns if i not in moments and all(number(row[i], comma) is not None for row in sample)]
    others = [i for i in columns if i not in moments and i not in numbers]
    words = [i for i in others if len({row[i] for row in sample}) > 1]
    units = next((i for i, text in enumerate(header) if _UNIT.fullmatch(text)), None)
    named = [i for i in words if header and _SIGNAL.fullmatch(header[i])]
    some = [i for i in columns if sum(number(row[i], comma) is not None for row in sample) > 0.5 * len(sample)]
    value = next((i for i in some if header and _VALUE.fullmatch(header[i])), None)
    times = [i for i in (moments or numbers) if i != value and len({row[i] for row in sample}) > 1]
    times = [i for i in times if not re.search("server|received", header[i] if header else "")] or times
    named = [i for i in named if not _DATA_ITEM.fullmatch(header[i])] or named
    if named and value is not None and len(times) == 1:
        return named, times[0], value, units
    signals = [i for i in words if i != units]
    if header or len(moments) != 1 or len(numbers) != 1 or not signals:
        return None
    return signals[:1], moments[0], numbers[0], units
