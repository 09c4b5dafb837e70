"""Renishaw laser data (`.rtl`, linear, static): targets in mm, deviations in um, measured minus target.

Plain text in sections `NAME::`. Read by section name and white space only, because header words vary with
the version and the language of the program. TARGET DATA:: lists the targets over several lines; DEVIATIONS::
has one line a reading: run, target number, deviation. A run that visits its targets upwards is an approach from
below. Air and material readings stand in ENVIRONMENT:: in a form that differs from version to version: not read.

Layout after six public readers and writers of the format that agree with each other (V20.02.02 and before);
not tried on a file from the instrument itself.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from pydantic import Field

from errpipe import files
from errpipe.domain.recording import Manifest, Recording
from errpipe.errors import DataError
from errpipe.formats._positioning import columns_of, finite
from errpipe.yamlfile import Options as YamlOptions

name = "renishaw_rtl"
MAX_BYTES = 64 << 20  # a test of 10,000 targets and 100 runs
# Terms in the first lines for data of another kind, which are not positioning deviations in um.
_OTHER_KINDS = re.compile(
    r"angul|winkel|straight|gerad|rectitud|square|rechtw|perpend|flat|ebenh|rotar|dreh|dynam", re.IGNORECASE
)
_AXIS = re.compile(r"^(AXIS|ACHSE|AXE|EJE|ASSE)[ -]|[ -]?(AXIS|ACHSE)$")  # as programs write it next to the letter
_SECTION = re.compile(r"^([A-Z][A-Z _-]*)::\s*$", re.IGNORECASE)
_Line = tuple[int, str]


class Options(YamlOptions):
    """How to read a laser file."""

    format: Literal["renishaw_rtl"] = "renishaw_rtl"
    axis: str | None = Field(
        None, pattern=r"^[XYZUVWPQR]\d?$", description="The linear axis; where none is given, the file's own Axis line."
    )


def sniff(path: Path) -> bool:
    """True for a text file that begins with HEADER:: and names a file type such as rtl, or ends in .rtl.

    Those of other kinds (rta: angular, rts: straightness) too: `read` refuses them by name.
    """
    path = Path(path)
    if not path.is_file():
        return False
    with open(path, "rb") as stream:
        head = stream.read(4096)
    text = _text(head).lstrip()
    begins = text.upper().startswith("HEADER::")
    return begins and (path.suffix.lower() == ".rtl" or re.search(r"File type\s*:\s*rt\w\b", text, re.I) is not None)


def read(path: Path, options: Options | None = None) -> Recording:
    """One row a reading, in file order; deviation = measured - target, um. Raises DataError naming file and line."""
    path, options = Path(path), options or Options()
    sections = _sections(path)
    _refuse_other_kinds(path, sections.get("HEADER", []))
    targets = _targets(path, sections.get("TARGET DATA", []))
    facts = dict(_facts(sections.get("USER-TEXT", [])))
    axis = options.axis or _AXIS.sub("", facts.get("axis", "").upper())
    if not re.fullmatch(r"[XYZUVWPQR]\d?", axis):
        raise DataError(f"{path}: the file's axis is {axis!r}, not a linear ISO 841 axis (declare it: `axis: X`)")
    runs, numbers, deviation = _deviations(path, sections.get("DEVIATIONS", []), len(targets))
    position = targets[numbers - 1]
    columns = columns_of(axis)
    labels = np.array([str(r) for r in runs], dtype=object)
    data = (labels, position, _directions(path, runs, position), deviation)
    frame = pd.DataFrame(dict(zip(columns, data, strict=True)))
    manifest = Manifest(
        recording=1,
        title=facts.get("title", ""),
        machine=facts.get("machine", ""),
        tables=(path.name,),
        columns=columns,
    )
    return Recording(manifest, frame)


def _sections(path: Path) -> dict[str, list[_Line]]:
    out: dict[str, list[_Line]] = {}
    current: list[_Line] = []
    for number, line in enumerate(_text(files.read(path, MAX_BYTES, DataError)).splitlines(), 1):
        if match := _SECTION.match(line.strip()):
            name = match[1].upper()
            if name in out and name in ("TARGET DATA", "DEVIATIONS"):
                raise DataError(f"{path}:{number}  section {name}:: occurs twice in the file")
            current = out.setdefault(name, [])
        elif line.strip():
            current.append((number, line.strip()))
    for wanted in ("TARGET DATA", "DEVIATIONS"):
        if wanted not in out:
            raise DataError(f"{path}: no section {wanted}:: (found: {', '.join(out) or 'none'})")
    if "EOF" not in out:
        raise DataError(f"{path}: the file does not end with EOF:: (it is cut short)")
    return _with_points(out)


def _text(data: bytes) -> str:
    """The text of a file that begins with HEADER:: in UTF-8, UTF-16, or the code page of older versions."""
    wide = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    guess = {b"\0": "utf-16-be"}.get(data[:1]) or {b"\0": "utf-16-le"}.get(data[1:2])
    try:
        return data.decode("utf-16" if wide else guess or "utf-8-sig", errors="replace" if wide or guess else "strict")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _with_points(sections: dict[str, list[_Line]]) -> dict[str, list[_Line]]:
    """Targets and deviations with decimal points: a comma is one if no number of the file has a point."""
    numbers = [text for name in ("TARGET DATA", "DEVIATIONS") for _, text in sections[name] if ":" not in text]
    if any("." in text for text in numbers) or not any("," in text for text in numbers):
        return sections
    pointed = {
        name: [(n, text if ":" in text else text.replace(",", ".")) for n, text in sections[name]]
        for name in ("TARGET DATA", "DEVIATIONS")
    }
    return {**sections, **pointed}


def _refuse_other_kinds(path: Path, lines: list[_Line]) -> None:
    """Raise DataError for angular, straightness or dynamic data, which would be read as um of positioning."""
    for number, text in lines:
        key, _, value = (part.strip() for part in text.partition(":"))
        kind = key.lower() in ("file type", "owner") and value
        if kind and (_OTHER_KINDS.search(kind) or (key.lower() == "file type" and kind.lower() != "rtl")):
            raise DataError(
                f"{path}:{number}  {text[:60]!r}: not linear positioning, which alone is read here (allowed: File type "
                "rtl of an owner such as Linear); export the deviations as CSV and use --component, such as EBX"
            )


def _facts(lines: list[_Line]) -> list[tuple[str, str]]:
    parts = (text.partition(":") for _, text in lines)
    return [(key.strip().lower(), value.strip()) for key, colon, value in parts if colon]


def _targets(path: Path, lines: list[_Line]) -> np.ndarray:
    """Target positions in mm, shape (targets,)."""
    count, listing = None, False
    values: list[float] = []
    for number, text in lines:
        key, colon, rest = text.partition(":")
        if colon and key.strip().lower() == "target-count":
            count = int(finite(rest.strip(), f"{path}:{number}  Target-count"))
        elif colon:
            listing = key.strip().lower() == "targets"
        elif listing:
            values += [finite(word, f"{path}:{number}  target {len(values) + 1}") for word in text.split()]
    if not values or (count is not None and count != len(values)):
        raise DataError(f"{path}: Target-count is {count}, but {len(values)} targets are listed")
    return np.array(values)


def _deviations(path: Path, lines: list[_Line], targets: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Run, target number and deviation (um) of each reading."""
    out = []
    for number, text in lines:
        words = text.split()
        if ":" in text:
            continue
        if len(words) != 3 or not words[0].isdecimal() or not words[1].isdecimal():
            raise DataError(f"{path}:{number}  {text[:60]!r} is not a reading (allowed: run, target number, deviation)")
        if not 1 <= int(words[1]) <= targets:
            raise DataError(f"{path}:{number}  target {words[1]} does not exist (the file lists {targets})")
        out.append((int(words[0]), int(words[1]), finite(words[2], f"{path}:{number}  deviation")))
    if not out:
        raise DataError(f"{path}: section DEVIATIONS:: holds no readings")
    runs, numbers, values = zip(*out, strict=True)
    return np.array(runs), np.array(numbers), np.array(values)


def _directions(path: Path, runs: np.ndarray, position: np.ndarray) -> np.ndarray:
    """+1 where a run visits its targets upwards, -1 downwards. Raises DataError if it does neither."""
    out = np.empty(runs.size)
    for run in dict.fromkeys(runs.tolist()):
        rows = np.flatnonzero(runs == run)
        steps = np.diff(position[rows])
        if steps.size == 0 or not (np.all(steps >= 0) or np.all(steps <= 0)) or not steps.any():
            raise DataError(f"{path}: run {run} visits its targets neither upwards nor downwards")
        out[rows] = 1.0 if steps.sum() > 0 else -1.0
    return out
