"""Saved answers of an MTConnect agent (`/sample`, `/current`): one column per data item, one row per time stamp.

UNAVAILABLE is an empty cell; a value holds until the next one of its item. Units are not in a stream: columns are named
by the item's name and type, and a person says the unit where the name does not.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, DoorOptions, Sheet, affordable, number

name = "MTConnect"
suffixes = (".xml",)
UNITS = {"Position": "mm", "Temperature": "degC", "SpindleSpeed": "rpm", "RotaryVelocity": "rpm"}  # MTConnect Part 2


def sniff(path: Path, head: bytes) -> bool:
    """XML whose first element is MTConnectStreams."""
    return b"MTConnectStreams" in head[:4096]


def read(path: Path, options: DoorOptions) -> list[Sheet]:
    """All numeric samples in order of time. Raises DataError."""
    data = path.read_bytes()
    if re.search(rb"<!(DOCTYPE|ENTITY)", data):
        raise DataError(f"{path}: an XML file with its own entities is not read")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as err:
        raise DataError(f"{path}:{err.position[0]}  not XML that can be read") from None
    samples: list[tuple[str, str, float | None]] = []
    for element in root.iter():
        stamp, text = element.get("timestamp"), (element.text or "").strip()
        kind = element.tag.rpartition("}")[2]
        value = number(text, comma=False)
        if stamp and element.get("dataItemId") and (value is not None or text == "UNAVAILABLE"):
            label = element.get("name") or element.get("dataItemId") or kind
            unit = UNITS.get(kind)
            part = f" {element.get('subType', '').lower()}" if kind == "Position" and element.get("subType") else ""
            samples.append((stamp, f"{label}{part} [{unit}]" if unit else f"{label}{part}", value))
    if not samples:
        raise DataError(f"{path}: no numeric sample with a time stamp")
    names = list(dict.fromkeys(label for _, label, _ in samples))
    affordable(len({stamp for stamp, _, _ in samples}) * len(names), path)
    held: dict[str, float | None] = dict.fromkeys(names)
    rows: dict[str, list[Cell]] = {}
    for stamp, label, value in sorted(samples, key=lambda s: s[0]):
        held[label] = value
        rows[stamp] = [stamp, *held.values()]
    return [Sheet(path.stem, list(rows.values()), ["time", *names]).limited()]
