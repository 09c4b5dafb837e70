"""Logs of EPICS `camonitor`: one line per change of a process variable (name, date, time, value).

A value is valid until the next one of its variable (EPICS Channel Access Reference Manual, monitors), so a constant
variable has no lines. Changes within one cycle of the controller become one row.
"""

from __future__ import annotations

import re
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, ReaderOptions, Sheet, affordable, number

name = "EPICS camonitor"
suffixes = (".log", ".txt")
_LINE = re.compile(r"(\S*[^\W\d]\S*)\s+(\d{4}-\d{2}-\d{2})\s+(\d{2}:\d{2}:\d{2}\.\d+)\s+(\S+)(?:\s+[A-Z_ ]+)?\s*")
OF_A_CYCLE = 0.4  # of the shortest usual time between two values of one variable


def sniff(path: Path, head: bytes) -> bool:
    """Whether the first lines name a variable, a date, a time and a value."""
    lines = [line for line in head[:4096].decode("utf-8", errors="replace").splitlines()[:6] if line.strip()]
    return len(lines) > 2 and all(_LINE.fullmatch(line) for line in lines[:-1])


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """One sheet, a column per variable, a row per cycle. Raises DataError if no value is a number."""
    events: list[tuple[float, str, float]] = []
    epoch: datetime | None = None
    for line in path.read_text("utf-8", errors="replace").splitlines():
        match = _LINE.fullmatch(line)
        value = number(match[4], comma=False) if match else None
        if match is None or value is None:
            continue
        moment = datetime.fromisoformat(f"{match[2]}T{match[3][:15]}")
        epoch = epoch or moment
        events.append(((moment - epoch).total_seconds(), match[1], value))
    names = list(dict.fromkeys(variable for _, variable, _ in events))
    if epoch is None or not names:
        raise DataError(f"{path}: no value of a variable is a number")
    affordable(len(events) * (len(names) + 1), path)
    rows = _cycles(sorted(events, key=lambda e: e[0]), names)
    note = f"a value is valid until the next one of its variable; first line at {epoch.isoformat()}"
    return [Sheet(path.stem, rows, ["time [s]", *names], [note]).limited()]


def _cycles(events: list[tuple[float, str, float]], names: list[str]) -> list[list[Cell]]:
    """A row for the changes within one cycle, with the current value of every variable; none before all are known."""
    steps = [float(np.median(np.diff(t))) for n in names if len(t := [e[0] for e in events if e[1] == n]) > 2]
    cycle = OF_A_CYCLE * min((s for s in steps if s > 0), default=0.0)
    held: dict[str, Cell] = dict.fromkeys(names)
    rows: list[list[Cell]] = []
    begin, seen = events[0][0], set[str]()
    for (_, variable, value), (later, following, _) in pairwise([*events, (np.inf, "", 0.0)]):
        held[variable] = value
        seen.add(variable)
        if later - begin > cycle or following in seen:
            if None not in held.values():
                rows.append([begin, *held.values()])
            begin, seen = later, set()
    return rows
