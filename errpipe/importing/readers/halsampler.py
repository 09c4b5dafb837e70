"""Logs of LinuxCNC's `halsampler`: numbers separated by blanks, no header, columns in the order of the pins.

With `-t` the first column counts the samples. The file contains neither pin names nor period: `--names`, `--period`.
"""

from __future__ import annotations

import re
from pathlib import Path

from errpipe.errors import DataError
from errpipe.importing.sheet import ReaderOptions, Sheet, affordable, number
from errpipe.importing.words import kind_by_name

name = "LinuxCNC halsampler"
suffixes = (".log", ".sampler", ".txt")
_LINE = re.compile(rb"\s*([+-]?[0-9.]+([eE][+-]?\d+)?[ \t]+)+[+-]?[0-9.]+([eE][+-]?\d+)?\s*")
FEWEST_SAMPLES = 500  # with fewer rows and without a counter, overrun or --period, a file is a table, not a log
PERIOD = 0.001  # s: the servo period of most LinuxCNC machines


def sniff(path: Path, head: bytes) -> bool:
    """Lines of numbers and blanks only (or `overrun`), from the first line on."""
    lines = [line for line in head.splitlines()[:-1] if line.strip()][:50]
    return len(lines) > 2 and all(_LINE.fullmatch(line) or line.strip() == b"overrun" for line in lines)


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """The samples with a time column. Raises DataError naming the line that does not fit."""
    rows: list[list[float]] = []
    notes = []
    width = overruns = 0
    for n, line in enumerate(path.read_text(encoding="latin-1").splitlines(), 1):
        words = line.split()
        if not words:
            continue
        if words == ["overrun"]:
            overruns += 1
            continue
        values = [number(word, comma=False) for word in words]
        width = width or len(values)
        numbers = [v for v in values if v is not None]
        if len(numbers) != width or len(values) != width:
            raise DataError(f"{path}:{n}  {line[:60]!r} is not {width} numbers")
        rows.append(numbers)
        affordable(len(rows) * width, path)
    if overruns:
        notes.append(f"{overruns} overruns: samples were lost")
    counted = len(rows) > 2 and all(rows[i + 1][0] == rows[i][0] + 1 for i in range(min(len(rows) - 1, 200)))
    period, names = options.period or PERIOD, [*options.names]
    named = len(names) == width
    guess = "" if options.period else " (a guess; to change it: --period)"
    if counted:
        notes.append(f"the first column counts samples, {period:g} s apart{guess}")
        rows = [[period * (r[0] - rows[0][0]), *r[1:]] for r in rows]
        names = names if named else ["t [s]", *names]
    elif len(rows) < FEWEST_SAMPLES and not overruns and options.period is None:
        says = f"the file has no column names: give them with --names, {width}, such as target,error"
        header = names if named else [f"column {i}" for i in range(1, width + 1)]
        return [Sheet(path.stem, [[*row] for row in rows], header, [] if named else [says]).limited()]
    elif named and kind_by_name(names[0]) == "time":
        notes.append(f"the first column is the time, from its name {names[0]!r}")
    else:
        rows = [[period * i, *r] for i, r in enumerate(rows)]
        names, width = ["t [s]", *names], width + 1
        notes.append(f"rows are {period:g} s apart{guess}")
    if len(names) != width:
        names = ["t [s]", *(f"pin.{i}" for i in range(width - 1))]
        notes.append(f"the file has no column names: give them with --names, {width - 1} of them, such as x_cmd,x_fb")
    return [Sheet(path.stem, [[*row] for row in rows], names, notes).limited()]
