"""Saved responses of an MTConnect agent (`/sample`, `/current`): one column per data item, one row per time stamp.

UNAVAILABLE is an empty cell; a value is valid until the next one of its item. A stream has no units: columns are named
by the item's name and type, and the user declares the unit if the name does not contain it.
"""

from __future__ import annotations

import re
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

from errpipe.errors import DataError
from errpipe.importing.readers._xml import root_of
from errpipe.importing.sheet import Cell, ReaderOptions, Sheet, affordable, number

name = "MTConnect"
suffixes = (".xml",)
UNITS = {"Position": "mm", "Temperature": "degC", "SpindleSpeed": "rpm", "RotaryVelocity": "rpm"}  # MTConnect Part 2


def sniff(path: Path, head: bytes) -> bool:
    """XML whose first element is MTConnectStreams."""
    return b"MTConnectStreams" in head[:4096]


def _moment(path: Path, stamp: str) -> datetime:
    try:
        moment = datetime.fromisoformat(re.sub(r"(\.\d{6})\d+", r"\1", stamp).replace("Z", "+00:00"))
    except ValueError:
        raise DataError(f"{path}: {stamp!r} is not a time stamp of ISO 8601") from None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """All numeric samples sorted by time. Raises DataError."""
    root = root_of(path, path.read_bytes())
    samples: list[tuple[str, str, float | None]] = []
    labels: dict[str, tuple[str, str]] = {}  # by data item: component and label
    component = ""
    for element in root.iter():
        stamp, text, item = element.get("timestamp"), (element.text or "").strip(), element.get("dataItemId")
        kind = element.tag.rpartition("}")[2]
        component = element.get("name", "") if kind == "ComponentStream" else component
        value = None if " " in text else number(text, comma=False)
        if stamp and item and (value is not None or text == "UNAVAILABLE"):
            unit = UNITS.get(kind)
            part = f" {element.get('subType', '').lower()}" if kind == "Position" and element.get("subType") else ""
            labels[item] = component, f"{element.get('name') or item}{part}" + (f" [{unit}]" if unit else "")
            samples.append((stamp, item, value))
    if not samples:
        raise DataError(f"{path}: no numeric sample with a time stamp (time series are not read: request samples)")
    names = list(dict.fromkeys(item for _, item, _ in samples))
    affordable(len({stamp for stamp, _, _ in samples}) * len(names), path)
    held: dict[str, float | None] = dict.fromkeys(names)
    rows: dict[str, list[Cell]] = {}
    for stamp, item, value in sorted(samples, key=lambda s: _moment(path, s[0])):
        held[item] = value
        rows[stamp] = [stamp, *held.values()]
    several = Counter(label for _, label in labels.values())
    header = [f"{labels[n][0]} {labels[n][1]}" if several[labels[n][1]] > 1 else labels[n][1] for n in names]
    return [Sheet(path.stem, list(rows.values()), ["time", *header]).limited()]
