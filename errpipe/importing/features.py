"""Inspection reports: nominal and actual positions of features, from CMMs and probing cycles, as a recording.

A row states one coordinate of a feature: below a header (`AX NOMINAL MEAS DEV`), or with words between the numbers
(`POSN X50.0000 ACTUAL 50.0031 DEV 0.0031`); or a table has columns for each axis. A part that the machine made shows
the machine's deviations, an artefact that it measured minus its deviations: only the user knows which it is.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from errpipe.errors import DataError
from errpipe.importing import order, resolve, signs
from errpipe.importing.header import is_moment
from errpipe.importing.layout import Layout
from errpipe.importing.proposed import ImportOptions, Proposal
from errpipe.importing.sheet import Cell, Sheet, decimal_comma, filled_cells, label, number
from errpipe.importing.units import split_header
from errpipe.importing.words import kind_by_name, plain

NOMINAL, ACTUAL, DEVIATION = "command", "actual", "error"
WHO = "was a part or an artefact measured"
FEWEST = 3  # features
MOST_ROWS = 20_000  # of a sheet: a thousand features have ten rows each; longer ones are logs
FARTHEST = 5.0  # mm: as the largest deviation elsewhere; beyond it a wrong number was read
ROUNDING = 2.1e-4  # mm: of three numbers printed with four decimals (0.002 mm with three)
_COORDINATE = re.compile(r"(?<![a-z\d])([xyz])(?![a-z\d])")
_OF_A_COORDINATE = re.compile(r"\b(value|wert|coord\w*|koord\w*|val)\b|[^\w]|_")
_NAME_OF_FEATURE = re.compile(
    r"\b(feature|element\w*|merkmal|hole|bohrung|circle|kreis|ball|kugel|sphere|foro|trou|ident|characteristic)\b"
)
_GLUED = re.compile(r"([A-Za-z]{1,8})[=:]?([+-]?\d+[.,]\d+)")  # `X50.0000`, `XNOM50.000`
_TOLERANCE = re.compile(r"((upper|lower|ob|unt|o|u|out)\w*[. ]*|[+-] ?)tol\w*\.?", re.IGNORECASE)
_LIMIT = re.compile(r"limit|grenz|maxim|minim|mass?\b|toler|height|hoehe")
_IDENTIFIES = re.compile(r"(?<![\d.,])\d+(?![\d.,])")  # `FEATURE NO 2`, `DIM LOC2=`, not `ERROR TP 0.1311`
_VERDICT = re.compile(r"\bfail|\bok\b|^$")  # `Pass/Fail` is not a run
_DIFFERENCE = re.compile(r"\b(diff\w*|delta)\b")


@dataclass(frozen=True)
class _Reading:
    """One coordinate of a feature: the numbers by kind.

    breaks: a preceding line starts another feature; apart: likewise, or the row contains the words as well.
    """

    row: int
    axis: str
    name: str
    numbers: dict[str, float]
    breaks: bool
    apart: bool


def proposal(sheet: Sheet, options: ImportOptions) -> Proposal | None:
    """The recording of a report; None for any other sheet.

    Raises DataError if numbers contradict each other, and if the user does not state what was measured.
    """
    rows: list[list[Cell]] = [[*sheet.header], *sheet.rows] if sheet.header else sheet.rows
    if len(rows) > MOST_ROWS:
        return None
    units, of_deviation = _units(rows)
    features = _features(list(_readings(rows)))
    headed = len(features) < FEWEST
    features = _features(list(_below_headings(rows))) if headed else features
    if len(features) < FEWEST:
        return None
    axes = Counter(tuple(sorted(f)) for f in features).most_common(1)[0][0]
    kept = [f for f in features if tuple(sorted(f)) == axes]
    apart = all(r.apart for f in kept for r in f.values())  # else one coordinate may be the axis of a plain table
    if len(kept) < max(FEWEST, 0.5 * len(features)) or (len(axes) < 2 and not apart):
        return None
    if len(units) > 1:
        raise DataError(f"an inspection report in {' and '.join(sorted(units))}: write it in one unit")
    unit = options.unit if options.unit in ("mm", "inch") else next(iter(units), "mm")
    scale = 25.4 if unit == "inch" else 1.0
    place = {a: scale * np.array([f[a].numbers[NOMINAL] for f in kept]) for a in axes}
    read = {a: _deviations([f[a] for f in kept], of_deviation, scale, options) for a in axes}
    moved = [a for a in axes if np.unique(place[a]).size > 1]
    measured = [a for a in (moved if len(moved) == 1 else axes) if np.any(read[a])]
    if not moved or not measured:
        raise DataError("an inspection report without positions or deviations that vary: nothing to compensate")
    _ask_for_sign(len(kept), moved, options)
    p = Proposal(notes=[*sheet.notes], headers={label(c) for row in rows[:1] for c in row})
    p.put("run", order.visits(*(np.round(place[a], 3) for a in axes)), "repetition number of the position", role="run")
    why = "nominal position of the feature" + ("" if units else "; no unit is stated, taken as mm")
    for a in moved:
        p.put(a, np.round(place[a], 4), why, role="position", axis=a, unit="mm")
    for a in measured:
        component = f"E{a}{a}" if len(moved) == 1 else f"E_{a}"
        p.put(component, np.round(read[a], 7), "actual minus nominal", role="error", component=component, unit="mm")
    signs.convert_errors(p, Layout([], []), options)
    made = options.sign == "actual-minus-commanded"
    if len(moved) > 1:
        p.facts["protocol"] = "hole_pattern" if made else "ball_plate"
    if headed:
        p.notes.append("reference axis, minor axis, tool axis: taken as X, Y and Z, as where Z is the axis of the tool")
    p.notes.append(f"a print of {len(kept)} features: {'a part that the machine made' if made else 'an artefact'}")
    if any(f[a].numbers.get(DEVIATION, 0.0) * d < 0 for a in measured for f, d in zip(kept, read[a], strict=True)):
        p.notes.append("its column of deviations is nominal minus actual: deviations computed from these two")
    if left := {r.name or f"line {r.row + 1}" for f in features if f not in kept for r in f.values()}:
        p.notes.append(f"features without {' and '.join(axes)} were excluded: {', '.join(sorted(left))}"[:160])
    for a in {*axes} - {*measured}:
        p.notes.append(f"{a} was excluded: " + ("it does not vary" if len(moved) == 1 else "every deviation is 0"))
    return p


def _ask_for_sign(count: int, moved: list[str], options: ImportOptions) -> None:
    if options.sign is None:
        raise DataError(
            f"an inspection report of {count} features in {', '.join(moved)}: {WHO}? A part that this machine "
            "made and a CMM measured: --sign actual-minus-commanded; a calibrated artefact (ball plate, step gauge) "
            "that this machine measured with its own probe: --sign commanded-minus-actual"
        )


def _units(rows: list[list[Cell]]) -> tuple[set[str], str | None]:
    """Units of length that the report names, and that of a column of deviations if its header states another."""
    found, of_deviation = set(), None
    for row in rows:
        texts = [c for c in row if isinstance(c, str) and _has_letters(c)]
        stated = [split_header(text)[1] for text in texts if _kind(text) == DEVIATION]
        of_deviation = next((u for u in stated if u in ("um", "mm", "inch")), of_deviation)
        unit = re.findall(r"(?<![a-z\d])(mm|inch(?:es)?|in)(?![a-z])", " ".join(texts).lower()) if texts else []
        found |= {"mm" if u == "mm" else "inch" for u in unit if u != "in" or re.search(r"unit", " ".join(texts), re.I)}
    return found, of_deviation


def _has_letters(cell: Cell) -> bool:
    return isinstance(cell, str) and any(map(str.isalpha, cell)) and not is_moment(cell)


@lru_cache(maxsize=1024)
def _kind(cell: Cell) -> str | None:
    """command, actual or error for a word; None for any other cell."""
    if not _has_letters(cell) or _TOLERANCE.search(str(cell)):
        return None
    text = _COORDINATE.sub(" ", plain(split_header(str(cell))[0])).strip()
    kind = kind_by_name(text) if text else None
    return DEVIATION if _DIFFERENCE.fullmatch(text) else kind if kind in (NOMINAL, ACTUAL, DEVIATION) else None


@lru_cache(maxsize=1024)
def _axis(cell: Cell) -> str | None:
    found = {*_COORDINATE.findall(plain(cell))} if _has_letters(cell) else set()
    return found.pop().upper() if len(found) == 1 else None


def _readings(rows: list[list[Cell]]) -> Iterator[_Reading]:
    """Every row, or cell of a table with columns for each axis, that states a coordinate with nominal and result."""
    comma, header, last, breaks, per_axis = decimal_comma(rows), list[str](), "", True, False
    of_features = False
    for r, row in enumerate(rows):
        if not per_axis and not any(map(_has_letters, row)):
            continue
        if len(alone := filled_cells(row)) == 1:  # a line among columns with blanked cells
            row = [*label(alone[0]).split()]
        texts = [label(c) for c in row]
        kinds, cells = [_kind(c) for c in row], [part for c in row for part in _split(c)]
        if NOMINAL in kinds and {ACTUAL, DEVIATION} & {*kinds} and not any(number(c, comma) is not None for c in cells):
            texts = _with_groups(rows[r - 1] if r else [], texts)
            named = any(kind_by_name(t) in ("run", "direction") for t in texts if not _VERDICT.search(plain(t)))
            header, last, breaks = [] if named else texts, "", True
            of_features = any(_NAME_OF_FEATURE.search(plain(t)) and not _kind(t) for t in header)
            per_axis = len({a for t in header if _kind(t) and (a := _axis(t))}) > 1
            continue
        beside = not header or any(k in (ACTUAL, DEVIATION) for k in map(_kind, cells))
        if beside:
            found = [(axis, "", numbers) for axis, numbers in _numbers_after_words(cells, comma)]
        elif per_axis:
            found = _columns_per_axis(header, row, r, comma)
        else:
            found = _below(header, row, comma)
        whole = [one for one in found if NOMINAL in one[2] and {ACTUAL, DEVIATION} & {*one[2]}]
        for axis, name, numbers in whole:
            last = name or last  # a cell merged over the coordinates of a feature
            yield _Reading(r, axis, last, numbers, breaks, breaks or beside or of_features)
            breaks = False
        breaks |= not whole and not found and _IDENTIFIES.search(" ".join(texts)) is not None


# Names of the axes of the working plane in the logs of probing cycles (HEIDENHAIN, Touch Probe Cycles: TCHPR421.TXT).
_OF_A_PLANE = (
    (r"(reference|main|principal) axis|hauptachse|axe principal|asse principale|eje principal", "X"),
    (r"(minor|secondary) axis|nebenachse|axe (secondaire|auxiliaire)|asse secondario|eje (secundario|auxiliar)", "Y"),
    (r"(tool|probe|measuring) axis|(werkzeug|tastsystem)achse|axe (d'|de l')?outil", "Z"),
)
_NAMED_VALUE = re.compile(r"([^\d:=]*[^\W\d][^:=]*?)\s*[:=]\s*([+-]?\d+[.,]?\d*)\s*(mm|inch|in)?")


def _below_headings(rows: list[list[Cell]]) -> Iterator[_Reading]:
    """Coordinates of features with nominal and actual values below headings: `ACTUAL VALUES:`, `CENTER IN X: 5`.

    A heading of nominal values after others starts another feature.
    """
    kind, feature = None, dict[str, tuple[int, dict[str, float]]]()
    last: list[Cell] = ["nominal values:"]
    for r, row in enumerate([*rows, last]):
        line = plain(" ".join(map(label, filled_cells(row))))
        match = _NAMED_VALUE.fullmatch(line)
        if match is None:
            heading = line.strip(" :*-=") if line.rstrip().endswith(":") or len(line.split()) < 3 else ""
            if not heading:
                continue
            kind = _kind(re.sub(r"(werte|wert|values?)$", r" \1", heading)) if not _TOLERANCE.search(heading) else None
            if kind == NOMINAL and any({ACTUAL, DEVIATION} & {*numbers} for _, numbers in feature.values()):
                whole = [(axis, *of) for axis, of in feature.items() if NOMINAL in of[1] and len(of[1]) > 1]
                for k, (letter, at, numbers) in enumerate(whole):
                    yield _Reading(at, letter, "", numbers, k == 0, True)
                feature = {}
            continue
        text, value = match[1], number(match[2], "," in match[2])
        axis = next((a for words, a in _OF_A_PLANE if re.search(words, text)), None) or _axis(text)
        if kind is not None and axis is not None and value is not None and not _LIMIT.search(text):
            feature.setdefault(axis, (r, {}))[1].setdefault(kind, value)


def _with_groups(above: list[Cell], texts: list[str]) -> list[str]:
    """Names below merged cells of axes: `X` above Nominal, Actual, Deviation, and `Y` above the same."""
    if sum(_axis(c) is not None for c in above) < 2 or any(map(_axis, texts)):
        return texts
    groups, last = list[str](), ""
    for cell in [*above, *[None] * (len(texts) - len(above))]:
        last = label(cell) or last
        groups.append(last)
    return [f"{group} {text}".strip() for group, text in zip(groups, texts, strict=False)]


def _split(cell: Cell) -> list[Cell]:
    """`X50.0000` as a word and a number; any other cell unchanged."""
    match = _GLUED.fullmatch(cell) if isinstance(cell, str) else None
    return [match[1], match[2]] if match else [cell]


def _numbers_after_words(cells: list[Cell], comma: bool) -> list[tuple[str, dict[str, float]]]:
    """The coordinates of a row and their numbers, each after the word that identifies it.

    If such a word starts the row, it precedes all coordinates: `NOM X50.0 Y40.0 ACT X50.1 Y40.0`; otherwise
    a row has one coordinate.
    """
    axis, kind, pending, found = None, None, None, dict[str, dict[str, float]]()
    for cell in filled_cells(cells):
        value = number(cell, comma)
        if value is None:
            named, kind = _axis(cell), _kind(cell)
            pending = kind if kind is not None and (axis is None or pending is not None) and named is None else pending
            if named is not None and (pending is not None or axis in (None, named)):
                axis, kind = named, kind or pending or NOMINAL
        elif axis is not None and kind is not None:
            found.setdefault(axis, {}).setdefault(kind, value)
            kind = None
    return [(a, numbers) for a, numbers in found.items() if len(numbers) > 1]


def _below(header: list[str], row: list[Cell], comma: bool) -> list[tuple[str, str, dict[str, float]]]:
    """The coordinate that a row names, the name of its feature, and its numbers by the header."""
    at = [i for i, c in enumerate(row) if _axis(c) is not None]
    if not at or len({_axis(row[i]) for i in at}) > 1:
        return []
    first = next((i for i in range(at[-1], len(row)) if number(row[i], comma) is not None), len(row))
    if len(row) == len(header):
        named = list(zip(header, row, strict=True))
    else:  # separated by blanks: the numbers after the words, below the names from the first kind on
        joined = _TOLERANCE.sub("tol", " ".join(header)).split()
        begin = next(i for i, text in enumerate(joined) if _kind(text))
        begin = min(begin, next((i for i, text in enumerate(joined) if text == "tol"), begin))
        named = list(zip(joined[begin:], [c for c in row[first:] if number(c, comma) is not None], strict=False))
    numbers = {k: v for text, c in named if (k := _kind(text)) and (v := number(c, comma)) is not None}
    words = [_OF_A_COORDINATE.sub("", _COORDINATE.sub(" ", plain(label(c)))) for c in row[: at[-1] + 1]]
    return [(str(_axis(row[at[-1]])), " ".join(filter(None, words)), numbers)]


def _columns_per_axis(
    header: list[str], row: list[Cell], r: int, comma: bool
) -> list[tuple[str, str, dict[str, float]]]:
    """Coordinates of a row of a table of features: `Feature;Nominal X;Actual X;Nominal Y;...`."""
    names = [i for i, text in enumerate(header) if _NAME_OF_FEATURE.search(plain(text)) and not _kind(text)]
    if not names or len(row) != len(header) or not row[names[0]]:
        return []
    found: dict[str, dict[str, float]] = {}
    for text, cell in zip(header, row, strict=True):
        axis, kind, value = _axis(text), _kind(text), number(cell, comma)
        if axis and kind and value is not None:
            found.setdefault(axis, {}).setdefault(kind, value)
    return [(axis, f"{label(row[names[0]])} (line {r + 1})", numbers) for axis, numbers in found.items()]


def _features(readings: list[_Reading]) -> list[dict[str, _Reading]]:
    """Readings by feature: of one name, until a coordinate repeats or, without names, a line starts another."""
    features: list[dict[str, _Reading]] = []
    current: dict[str, int] = {}
    several = len({r.name for r in readings}) > 1
    for r in readings:
        at = current.get(r.name)
        if at is None or r.axis in features[at] or (r.breaks and not several):
            at = current[r.name] = len(features)
            features.append({})
        features[at][r.axis] = r
    return features


def _deviations(readings: list[_Reading], unit: str | None, scale: float, options: ImportOptions) -> np.ndarray:
    """Actual minus nominal in mm. Raises DataError if a printed deviation differs."""
    stated = np.array([r.numbers.get(DEVIATION, np.nan) for r in readings])
    both = np.array([r.numbers.get(ACTUAL, np.nan) - r.numbers[NOMINAL] for r in readings]) * scale
    if np.isnan(both).any():
        unit = options.unit if options.unit in ("um", "mm", "inch") else unit or resolve.unit_by_size(stated)
        both = np.where(np.isnan(both), stated * {"um": 1e-3, "inch": 25.4}.get(unit, 1.0), both)
    else:
        stated = stated * {"um": 1e-3, "inch": 25.4}.get(unit or "", scale)
        off = np.minimum(np.abs(stated - both), np.abs(stated + both)) > scale * ROUNDING + 0.002 * (
            np.abs(both) < 10 * ROUNDING
        )
        off &= np.isfinite(stated)
        if off.any():
            r = readings[int(np.argmax(off))]
            raise DataError(
                f"line {r.row + 1}: {r.axis}: the deviation {r.numbers[DEVIATION]:g} is not actual "
                f"{r.numbers[ACTUAL]:g} minus nominal {r.numbers[NOMINAL]:g}: which column is which?"
            )
    if np.abs(both).max() > FARTHEST:
        r = readings[int(np.argmax(np.abs(both)))]
        raise DataError(
            f"line {r.row + 1}: {r.axis}: actual minus nominal is {np.abs(both).max():.4g} mm (at most "
            f"{FARTHEST:g} mm): does the header belong to these numbers?"
        )
    return both
