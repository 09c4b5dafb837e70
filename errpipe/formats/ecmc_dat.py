"""ISO 230-2 acceptance data (`*_ISO230.dat`) as the ecmc motion system's test tools write them.

A text of `KEY=value` lines: TGT_DATA[i] are the targets, REF_DATA_FWD[i,j] and REF_DATA_BWD[i,j] what a
reference sensor read at target i in cycle j, coming from below and from above. Samples seen: 2021 and 2023.

Direction. The report that the same tools print with the file calls the file's FWD numbers
"backward" and vice versa. The file is right, for three reasons:
  1. The tool that moves the axis gives test numbers 1cii to approaches from below and 2cii to approaches
     from above; the tool that writes the file puts 1cii under FWD and 2cii under BWD. Only the report's
     reader stores FWD lines in its backward array: a slip, and it flips the sign of every B_i.
  2. The first approach of the first cycle comes from below. In the 2021 sample cycle 1 departs from the mean
     of the other cycles by 114, 48, 3, -5, -6 um at FWD targets 1 to 5, and by at most 8 um in BWD: a start-up
     transient that dies away in the order in which FWD visits the targets.
  3. Lost motion lets the table lag, so its mean should be lower coming from below. In the file's naming
     FWD - BWD is negative on average in both samples (-14 um and -5 nm). Weak alone: the sign varies by target.
`directions: swapped` is for a file whose labels someone has turned round.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from errpipe import files
from errpipe.domain.recording import Manifest, Recording
from errpipe.errors import DataError
from errpipe.formats._positioning import columns_of, finite
from errpipe.yamlfile import Options as YamlOptions

name = "ecmc_dat"
UNITS = {"mm": 1.0, "um": 1e-3, "m": 1e3, "inch": 25.4}  # of UNIT, in mm
MAX_BYTES = 64 << 20  # a test of 10,000 targets and 100 cycles
DEFAULT_UNIT = "mm"  # the tool's own
WAYS = {"REF_DATA_FWD": 1, "REF_DATA_BWD": -1}  # direction of approach
_ENTRY = re.compile(r"(?P<key>[A-Z_]+)(?:\[(?P<index>[\d, ]+)\])?=(?P<value>.*)")
_SHAPE = {"TGT_DATA": 1, "REF_DATA_FWD": 2, "REF_DATA_BWD": 2}  # indices of each key


class Options(YamlOptions):
    """How to read an ecmc acceptance file."""

    format: Literal["ecmc_dat"] = "ecmc_dat"
    axis: str = Field(
        "X", pattern=r"^[XYZUVWPQR]\d?$", description="The linear axis that was tested; the file has no name."
    )
    directions: Literal["as_labelled", "swapped"] = Field(
        "as_labelled", description="as_labelled: FWD is the approach from below; swapped: FWD is from above."
    )


def sniff(path: Path) -> bool:
    """True for a text file whose beginning contains TGT_DATA and REF_DATA lines."""
    path = Path(path)
    if not path.is_file():
        return False
    with open(path, "rb") as stream:
        head = stream.read(1 << 16)
    return b"TGT_DATA[" in head and b"REF_DATA_" in head


def read(path: Path, options: Options | None = None) -> Recording:
    """Rows in the order of measuring: each cycle up, then down. Deviation = reference - target, um.

    A cycle is a run. Raises DataError naming file and line.
    """
    options = options or Options()
    targets, readings, factor = _parse(Path(path))
    turned = -1 if options.directions == "swapped" else 1
    rows = []
    for cycle in sorted({c for _, _, c in readings}):
        for way in (1, -1):
            for i in sorted(targets, reverse=way < 0):
                if (way, i, cycle) in readings:
                    value = readings[way, i, cycle]
                    rows.append((str(cycle), targets[i] * factor, way * turned, (value - targets[i]) * factor * 1e3))
    runs, position, ways, deviation = zip(*rows, strict=True)
    axis = options.axis
    columns = columns_of(axis)
    title = f"ISO 230-2 acceptance of {axis}: {len(targets)} targets, {len(set(runs))} cycles"
    data = (np.array(runs, dtype=object), np.array(position), np.array(ways, dtype=float), np.array(deviation))
    frame = pd.DataFrame(dict(zip(columns, data, strict=True)))
    return Recording(Manifest(recording=1, title=title, tables=(Path(path).name,), columns=columns), frame)


def _parse(path: Path) -> tuple[dict[int, float], dict[tuple[int, int, int], float], float]:
    """Targets by index, readings by (direction, target, cycle), and the factor into mm."""
    targets: dict[int, float] = {}
    readings: dict[tuple[int, int, int], float] = {}
    settings: dict[str, tuple[int, str]] = {}
    for line, text in _lines(path):
        match = _ENTRY.fullmatch(text)
        if match is None:
            raise DataError(
                f"{path}:{line}  {text[:60]!r} is not KEY=value (allowed: TGT_DATA[i]=..., REF_DATA_FWD[i,j]=...)"
            )
        key, value = match["key"], match["value"].strip()
        if key not in _SHAPE:
            settings[key] = line, value
            continue
        index = tuple(int(i) for i in (match["index"] or "").split(",") if i.strip())
        if len(index) != _SHAPE[key]:
            wanted = "[target]" if _SHAPE[key] == 1 else "[target,cycle]"
            raise DataError(f"{path}:{line}  {text.partition('=')[0]}: {key} is counted by {wanted}")
        where: dict[Any, float] = targets if key == "TGT_DATA" else readings
        entry = index[0] if key == "TGT_DATA" else (WAYS[key], *index)
        if entry in where:
            raise DataError(f"{path}:{line}  {text.partition('=')[0]} occurs twice in the file")
        where[entry] = finite(value, f"{path}:{line}  {text.partition('=')[0]}")
    _complete(path, targets, readings, settings)
    line, unit = settings.get("UNIT", (0, DEFAULT_UNIT))
    if unit not in UNITS:
        raise DataError(
            f"{path}:{line}  UNIT: {unit!r} is not a unit this format is read in (allowed: {', '.join(UNITS)})"
        )
    return targets, readings, UNITS[unit]


def _lines(path: Path) -> list[tuple[int, str]]:
    try:
        text = files.read(path, MAX_BYTES, DataError).decode()
    except UnicodeDecodeError as err:
        raise DataError(f"{path}: not UTF-8 text at byte {err.start}") from None
    stripped = ((n, raw.strip().removeprefix("TEST_DATA=")) for n, raw in enumerate(text.splitlines(), 1))
    return [(n, line) for n, line in stripped if line and not line.startswith("#")]


def _complete(
    path: Path, targets: dict[Any, Any], readings: dict[Any, Any], settings: dict[str, tuple[int, str]]
) -> None:
    """Raises DataError unless every announced target and cycle is there, in both directions."""
    if not targets or not readings:
        raise DataError(f"{path}: no {'targets (TGT_DATA)' if not targets else 'readings (REF_DATA_FWD)'} in the file")
    cycles = _announced(path, settings, "CYCLES", max(c for _, _, c in readings))
    positions = _announced(path, settings, "POSITIONS", max(targets))
    wanted = {(w, i, c) for w in WAYS.values() for i in range(1, positions + 1) for c in range(1, cycles + 1)}
    names = {way: key for key, way in WAYS.items()}
    for i in range(1, positions + 1):
        if i not in targets:
            raise DataError(f"{path}: TGT_DATA[{i}] is missing (POSITIONS={positions})")
    for way, i, c in sorted(wanted - set(readings), key=lambda e: (-e[0], e[2], e[1])):
        raise DataError(f"{path}: {names[way]}[{i},{c}] is missing (POSITIONS={positions}, CYCLES={cycles})")
    for way, i, c in sorted(set(readings) - wanted):
        raise DataError(f"{path}: {names[way]}[{i},{c}] is beyond POSITIONS={positions}, CYCLES={cycles}")


def _announced(path: Path, settings: dict[str, tuple[int, str]], key: str, default: int) -> int:
    line, text = settings.get(key, (0, str(default)))
    if not text.isdecimal():
        raise DataError(f"{path}:{line}  {key}: {text!r} is not a whole number")
    return int(text)
