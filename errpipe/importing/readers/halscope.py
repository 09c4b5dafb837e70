"""Traces of LinuxCNC's `halscope`: the sampling period, then one line per sample, with the name before each value.

`Sampling period is 1000000 nSec`, then `joint.0.motor-pos-cmd +1.50 joint.0.motor-pos-fb +1.49`
(src/hal/utils/scope_files.c); with a decimal comma in some locales.
"""

from __future__ import annotations

import re
from pathlib import Path

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, ReaderOptions, Sheet, affordable, number

name = "LinuxCNC halscope"
suffixes = (".log", ".txt")
_PERIOD = re.compile(r"\s*Sampling period is (\d+) nSec\s*$", re.MULTILINE)
NANO = 1e-9  # s


def sniff(path: Path, head: bytes) -> bool:
    """Whether the first line states the sampling period."""
    return _PERIOD.match(head.decode("latin-1")) is not None


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """A column of times and one per signal, a row per sample. Raises DataError if a line has other names."""
    text = path.read_text(encoding="latin-1")
    found = _PERIOD.match(text)
    period = NANO * int(found.group(1)) if found else 0.0
    samples = [line.split() for line in text.splitlines()[1:] if line.strip()]
    names = samples[0][0::2] if samples else []
    if not names or len(samples[0]) % 2:
        raise DataError(f"{path}: no line of names and values below the sampling period")
    signals = [*dict.fromkeys(names)]  # a signal on two channels occurs twice
    if samples[-1][0::2] != names or len(samples[-1]) % 2:
        samples.pop()  # incomplete
    affordable(len(samples) * (len(signals) + 1), path)
    cells: list[list[Cell]] = []
    for i, words in enumerate(samples):
        if words[0::2] != names or len(words) % 2:
            raise DataError(f"{path}: sample {i + 1} has different names from the first one: {' '.join(words)[:60]!r}")
        value = dict(zip(names, words[1::2], strict=True))
        cells.append([period * i, *(number(value[signal], comma="," in value[signal]) for signal in signals)])
    return [Sheet(path.stem, cells, ["t [s]", *signals], [f"one sample every {period:g} s, from the file"]).limited()]
