"""What a column probably is, from its header, unit and values: a guess with its reason, for a person to judge."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.layout import RawColumn
from errpipe.importing.words import CORRECTION, DOWN, UP, WORDS, plain

KIND_OF_UNIT = {
    "degC": "temperature",
    "degF": "temperature",
    "K": "temperature",
    "counts": "counts",
    "A": "current",
    "mA": "current",
    "N m": "torque",
    "rpm": "spindle_speed",
    "mm/min": "feed",
    "hPa": "pressure",
    "%": "humidity",
    "s": "time",
    "ms": "time",
    "um": "error",
    "urad": "error",
    "arcsec": "error",
}
_AXIS = re.compile(r"(?:^|[\s_.\-(/])([XYZABCUVW])(?:\d|[\s_.\-)/\[]|$|axis|achse|pos|cmd|act|soll|ist)", re.IGNORECASE)
_AXIS_ABOVE = re.compile(
    r"\b(?:axis|achse)\b\s*[:=;]?\s*([XYZABCUVW])\b|\b([XYZABCUVW])[- ]?(?:axis|achse)\b", re.IGNORECASE
)
_FILLERS = ("from", "von", "approach", "approached", "direction", "richtung", "dir", "the", "side")
FARTHEST_UM = 1e4  # um: threshold: no deviation of an axis reaches a centimetre
DATES = (
    "%d.%m.%Y %H:%M:%S.%f",
    "%d.%m.%Y %H:%M:%S",
    "%d.%m.%Y %H:%M",
    "%d.%m.%y %H:%M:%S",
    "%d.%m.%y %H:%M",
    "%m/%d/%Y %H:%M:%S",
    "%m/%d/%Y %I:%M:%S %p",
    "%H:%M:%S.%f",
    "%H:%M:%S",
)


@dataclass(frozen=True)
class ColumnGuess:
    """kind: a role, `actual` or `counts`; axis: letter or None; why: the reason, in words."""

    kind: str
    axis: str | None
    why: str


def guess(column: RawColumn) -> ColumnGuess:
    """What a column probably is. A column that fits nothing is `ignore`."""
    text = plain(column.header)
    axis = axis_in(column.header)
    for pattern, kind in WORDS:
        if re.search(pattern, text):
            kind, why = _settled(kind, column)
            return ColumnGuess(kind, axis, why or f"its name ({column.header!r})")
    if column.unit in KIND_OF_UNIT:
        return ColumnGuess(KIND_OF_UNIT[column.unit], axis, f"its unit ({column.unit})")
    if _side(column) is not None and column.values.size > 3:
        return ColumnGuess("direction", axis, "its values (two signs)")
    if seconds(column) is not None and not column.numeric:
        return ColumnGuess("time", axis, "its values (dates)")
    return ColumnGuess("ignore", axis, "nothing in its name, unit or values says what it is")


def _settled(kind: str, column: RawColumn) -> tuple[str, str]:
    """The kind corrected where the column's unit and values contradict it."""
    unit = column.unit
    if kind == "position" and unit in ("um", "urad", "arcsec", "nm") and not _too_large_for_a_deviation(column):
        return "error", f"its unit ({unit}: too small for a position)"
    if kind == "command" and unit in ("um", "nm") and not _too_large_for_a_deviation(column):
        return "error", f"its unit ({unit}: too small for a position)"
    if kind in ("temperature",) and unit is not None and KIND_OF_UNIT.get(unit) not in ("temperature", None):
        return KIND_OF_UNIT[unit], f"its unit ({unit})"
    if kind == "direction" and _side(column) is None:
        return "ignore", "called a direction, but its values are no two signs"
    if kind == "error" and re.search(CORRECTION, plain(column.header)) and np.unique(_known(column)).size <= 2:
        return "ignore", "called a compensation, but of two values: it says whether one is on"
    if kind not in ("time", "run", "direction") and not column.numeric:
        return "ignore", "its values are no numbers"
    if kind in ("position", "command", "actual") and unit == "counts":
        return "counts", "its unit (counts)"
    if kind in ("velocity", "feed") and unit in ("rpm",):
        return "spindle_speed", f"its unit ({unit})"
    return kind, ""


def _too_large_for_a_deviation(column: RawColumn) -> bool:
    """Whether values in um span more than any deviation does: positions that were logged in um."""
    known = _known(column)
    return column.unit == "um" and known.size > 0 and float(np.ptp(known)) > FARTHEST_UM


def _known(column: RawColumn) -> np.ndarray:
    return column.values[np.isfinite(column.values)]


def axis_in(text: str) -> str | None:
    """The axis letter that a text names, or None."""
    match = _AXIS.search(text)
    return match.group(1).upper() if match else None


# Angular errors of a horizontal axis by their usual names (ISO 230-1): the axis they turn about.
ANGLES = {
    "X": {"roll": "A", "pitch": "B", "yaw": "C"},
    "Y": {"roll": "B", "pitch": "A", "yaw": "C"},
    "Z": {"roll": "C"},  # pitch and yaw of a vertical axis have no usual assignment
}


def other_component(text: str, moved: str) -> str | None:
    """EYX of 'straightness Y' along X, ECX of 'yaw'; None where a header names neither. Raises DataError for half."""
    word = plain(text)
    if re.search(r"straight|gerad", word):
        across = axis_in(text)
        if across is None or across == moved:
            raise DataError(f"column {text!r}: a straightness across which axis? Say it with --component, such as EYX")
        return f"E{across}{moved}"
    for pattern, name in (
        (r"\b(roll\w*|rollen)\b", "roll"),
        (r"\b(pitch|nick\w*)\b", "pitch"),
        (r"\b(yaw|gier\w*)\b", "yaw"),
    ):
        if re.search(pattern, word):
            about = ANGLES.get(moved[0], {}).get(name)
            if about is None:
                raise DataError(f"column {text!r}: about which axis? Say it with --component, such as EBZ")
            return f"E{about}{moved}"
    return None


def axis_above(lines: list[str]) -> str | None:
    """The axis that the lines above the table name."""
    for line in lines:
        match = _AXIS_ABOVE.search(line)
        if match:
            return (match.group(1) or match.group(2)).upper()
    return None


def side(text: object) -> float | None:
    """+1 or -1 of a word for a direction (`fwd`, `from above`, `zurück`), or None."""
    word = re.sub(r"^([+-])ve$", r"\1", plain(text).removesuffix(".0").rstrip(".:"))
    words = [w for w in re.split(r"[\s_.]+", word) if w not in ("", *_FILLERS)]
    word = words[0] if len(words) == 1 else word
    return 1.0 if UP.fullmatch(word) else -1.0 if DOWN.fullmatch(word) else None


def _side(column: RawColumn) -> np.ndarray | None:
    """The column as +1 and -1, where every filled cell is a direction and both occur."""
    filled = [c for c in column.cells if c not in (None, "")]
    signs = [side(c) for c in filled]
    return np.array(signs, dtype=float) if filled and None not in signs and len(set(signs)) == 2 else None


def sides(column: RawColumn) -> np.ndarray:
    """The column as +1 and -1; empty cells are NaN."""
    signs = [side(c) if c not in (None, "") else None for c in column.cells]
    return np.array([np.nan if s is None else s for s in signs])


def seconds(column: RawColumn) -> tuple[np.ndarray, str | None] | None:
    """A column of dates or clock times as s since its first, and that date by ISO 8601; None where it is none."""
    texts = [str(c).strip() for c in column.cells if c not in (None, "")]
    if not texts:
        return None
    parse = _parser(texts[0])
    if parse is None:
        return None
    out = np.full(len(column.cells), np.nan)
    first: datetime | None = None
    for i, cell in enumerate(column.cells):
        if cell in (None, ""):
            continue
        try:
            when = parse(str(cell).strip())
        except ValueError:
            return None
        first = first or when
        try:
            out[i] = (when - first).total_seconds()
        except TypeError:  # some stamps with a time zone, some without
            return None
    steps = np.flatnonzero(np.diff(out[np.isfinite(out)]) < -43200)  # s: a clock without a date passed midnight
    dated = first is not None and first.year > 1901
    if not dated and steps.size:
        rows = np.flatnonzero(np.isfinite(out))
        for step in steps:
            out[rows[step + 1 :]] += 86400.0
    return out, first.isoformat() if dated and first is not None else None


def _parser(text: str):
    """The function that reads stamps like this one, or None."""

    def iso(t: str) -> datetime:
        return datetime.fromisoformat(t.replace(",", ".").replace("Z", "+00:00"))

    try:
        if re.match(r"\d{4}-\d\d", text):
            iso(text)
            return iso
    except ValueError:
        return None
    for form in DATES:
        try:
            datetime.strptime(text.replace(",", "."), form)
        except ValueError:
            continue
        return lambda t, form=form: datetime.strptime(t.replace(",", "."), form)
    return None
