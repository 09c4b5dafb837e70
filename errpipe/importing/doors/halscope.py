"""Traces of LinuxCNC's `halscope`: the sampling period, then a line a sample, the name before each value.

`Sampling period is 1000000 nSec`, then `joint.0.motor-pos-cmd +1.50 joint.0.motor-pos-fb +1.49`
(src/hal/utils/scope_files.c); where the locale has one, with a decimal comma.
"""

from __future__ import annotations

import re
from pathlib import Path

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, DoorOptions, Sheet, affordable, number

name = "LinuxCNC halscope"
suffixes = (".log", ".txt")
_PERIOD = re.compile(r"\s*Sampling period is (\d+) nSec\s*$", re.MULTILINE)
NANO = 1e-9  # s


def sniff(path: Path, head: bytes) -> bool:
    """Whether the first line states the sampling period."""
    return _PERIOD.match(head.decode("latin-1")) is not None


def read(path: Path, options: DoorOptions) -> list[Sheet]:
    """A column of times and one per signal, a row per sample. Raises DataError where no line holds names and values."""
    text = path.read_text(encoding="latin-1")
    found = _PERIOD.match(text)
    period = NANO * int(found.group(1)) if found else 0.0
    signals: dict[str, list[Cell]] = {}
    for line in text.splitlines()[1:]:
        words = line.split()
        of_line = dict(zip(words[0::2], words[1::2], strict=False))  # a signal on two channels stands there twice
        for signal, word in of_line.items():
            value = number(word, comma="," in word)
            if value is not None:
                signals.setdefault(signal, []).append(value)
    rows = min(map(len, signals.values()), default=0)  # the last line may be torn
    if not rows:
        raise DataError(f"{path}: no line of names and values below the sampling period")
    affordable(rows * (len(signals) + 1), path)
    cells: list[list[Cell]] = [[period * i, *(v[i] for v in signals.values())] for i in range(rows)]
    return [Sheet(path.stem, cells, ["t [s]", *signals], [f"a sample each {period:g} s, as the file states"]).limited()]
