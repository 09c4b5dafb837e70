"""Readings of a ball bar over the angle of a circle (ISO 230-4) as a recording of protocol `ballbar_circle`.

Radius and plane are stated in lines above the table. An angle is a point on the circle: 0 on the first axis of the
plane, 90 deg on the second. A run is one pass; its rows are in the order of motion, positions count from the centre.
"""

from __future__ import annotations

import re

import numpy as np

from errpipe.errors import DataError
from errpipe.importing import resolve, signs
from errpipe.importing.layout import Layout, RawColumn
from errpipe.importing.proposed import ImportOptions, Proposal
from errpipe.importing.sheet import label, number
from errpipe.importing.units import in_brackets
from errpipe.importing.units_above import unit_above
from errpipe.importing.words import kind_by_name, plain

_NAMED = re.compile(
    r"\bball ?bar\b|kreisform|\bqc ?[12]0\b|\bcircular(ity)? (test|deviation)|iso ?230-4|\bdouble ?ball\b"
)
_ANGLE = re.compile(r"^(rotation |position )?(angle|angolo|angulo|phi|theta|(dreh|polar|kreis)?winkel)\b|^角度")
_READING = re.compile(r"\b(radius|radial\w*|d ?r|dev\w*|abw\w*|error|fehler|bar|scostamento|ecart)\b|偏差|半径")
_CCW = re.compile(r"\bccw\b|counter ?-?clock|anti ?-?clock|gegen|\bg0?3\b|\blinks\b|antihor|antior|anti-hor|逆")
_CW = re.compile(r"\bcw\b|clockwise|uhrzeiger|\bg0?2\b|\brechts\b|horaire|horari|orari|顺|時計")
_FACT = r"\D{0,12}?[:=;, ]\s*([+-]?\d+(?:[.,]\d+)?)\s*(mm|inch|in)?\b"
_RADIUS = re.compile(r"(?:radius|radio|raggio|rayon|bar length|stangenlaenge|nominal length|半径)\b" + _FACT)
_FEED = re.compile(r"\b(?:feed(?: ?rate)?|vorschub|avance|avanzamento)\b" + _FACT)
_PLANE = re.compile(
    r"\b([xyz])[ /-]?([xyz])[ -]?(?:plane|ebene|plan\b|piano)|\b(?:plane|ebene|plan|piano)\W+([xyz])\W?([xyz])\b"
)
_G_PLANE = {"g17": "XY", "g18": "ZX", "g19": "YZ"}
FEWEST = 12  # readings of a run, and half a turn: less is not a circle
WIDEST = 0.2  # of the radius: readings near it are bar lengths, not their deviations


def proposal(layout: Layout, options: ImportOptions) -> Proposal | None:
    """The recording of a ball-bar table; None if nothing identifies a ball bar with a column of angles.

    Raises DataError if radius or plane are missing, or if the order of the rows contradicts the stated direction.
    """
    texts = [plain(text) for text in [*layout.above, *(c.header for c in layout.columns)]]
    angle = next((c for c in layout.columns if c.numeric and _ANGLE.search(plain(c.header))), None)
    if angle is None or angle.unit not in (None, "deg", "rad") or not any(map(_NAMED.search, texts)):
        return None
    if angle.unit is None and (unknown_unit := in_brackets(angle.header)) is not None:
        raise DataError(f"column {angle.header!r}: {unknown_unit!r} is not a unit of angle (allowed: deg, rad)")
    radius, first, second = _radius(texts), *_plane(texts)
    runs = _runs(layout, angle, first + second)
    if not runs:
        return None
    p = Proposal(notes=[*layout.notes], headers={c.header for c in layout.columns})
    turn = np.concatenate([angles for _, angles, _ in runs])
    values = np.concatenate([read for _, _, read in runs])
    of, unit = _unit(layout, options, values)
    values, unit, why = resolve.unit_of_readings(values, unit, "E_R", f"{of}: deviation along the bar")
    if unit == "mm" and np.all(np.abs(values - radius) < WIDEST * radius):
        values, why = values - radius, f"{why}; bar length minus radius {radius:g} mm"
    labels = [name for name, angles, _ in runs for _ in angles]
    p.put("run", labels, "plane and direction of rotation", role="run")
    for axis, share in ((first, np.cos(turn)), (second, np.sin(turn))):
        place = np.round(radius * share, 6)
        p.put(axis, place, "from the centre of the circle", role="position", axis=axis, unit="mm")
    if (feed := _fact(_FEED, texts)) is not None:
        p.put("feed", np.full(turn.size, feed), "from a line above the table", role="feed", unit="mm/min")
    p.put("E_R", values, why, role="error", component="E_R", unit=unit, _headers=(of,))
    signs.convert_errors(p, layout, options)
    for entry in p.entries.values():
        entry.pop("_headers", None)
    p.facts["protocol"] = "ballbar_circle"
    p.notes.append(
        f"a ball bar: circle of radius {radius:g} mm in {first}{second}, angle 0 at +{first}, 90 deg at +{second}; "
        f"its centre is not in the table: write centre_{first}, centre_{second} into the constants of recording.yaml"
    )
    return p


def _fact(pattern: re.Pattern[str], texts: list[str]) -> float | None:
    """The number that a line states, in mm."""
    match = next(filter(None, map(pattern.search, texts)), None)
    value = number(match[1], comma="," in match[1]) if match else None
    return value * 25.4 if value is not None and match and match[2] in ("inch", "in") else value


def _radius(texts: list[str]) -> float:
    radius = _fact(_RADIUS, texts)
    if radius is None or radius <= 0:
        raise DataError("a ball bar's table, but no line above it states the radius: add one, such as `Radius: 100 mm`")
    return radius


def _plane(texts: list[str]) -> tuple[str, str]:
    """The axis at angle 0, and the one at 90 deg."""
    named = next((_G_PLANE[g] for t in texts for g in re.findall(r"\bg1[789]\b", t)), None)
    for match in filter(None, map(_PLANE.search, texts)):
        named = "".join(filter(None, match.groups())).upper()
    if named is None or named[0] == named[1]:
        raise DataError("a ball bar's table, but no line above it states the plane: add one, such as `Plane: XY`")
    return named[0], named[1]


def _unit(layout: Layout, options: ImportOptions, values: np.ndarray) -> tuple[str, str | None]:
    """The header of the first column of readings, and the unit of all of them."""
    read = [c for c in layout.columns if _is_reading(c)]
    units = {c.unit for c in read}
    if len(units) > 1:
        raise DataError(f"the readings have several units ({', '.join(sorted(map(str, units)))})")
    written = units.pop() or unit_above(layout.above, values)
    return read[0].header, resolve.stated_unit(options, written, read[0].header)


def _is_reading(c: RawColumn) -> bool:
    text = plain(c.header)
    named = _rotation_sense(text) or (_READING.search(text) and kind_by_name(c.header) not in ("feed", "run", "time"))
    return c.numeric and bool(named) and not _ANGLE.search(text)


def _rotation_sense(text: str) -> str | None:
    word = plain(text)
    return "ccw" if _CCW.search(word) else "cw" if _CW.search(word) else None


def _runs(layout: Layout, angle: RawColumn, plane: str) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Label, angles in rad in the order of motion, and readings of every run. Raises DataError if unclear."""
    turn = angle.values * (1.0 if angle.unit == "rad" else np.pi / 180.0)
    read = [c for c in layout.columns if _is_reading(c)]
    ways = next((c for c in layout.columns if not c.numeric and any(_rotation_sense(label(x)) for x in c.cells)), None)
    passes = next((c for c in layout.columns if kind_by_name(c.header) == "run" and c is not ways), None)
    groups = [label(x) for x in passes.cells] if passes is not None else [""] * turn.size
    found: list[tuple[str, np.ndarray, np.ndarray]] = []
    for k, c in enumerate(read):
        way = _rotation_sense(c.header)
        if len(read) > 1 and way is None:
            raise DataError(f"column {c.header!r}: clockwise or counterclockwise? Write CW or CCW into its header")
        of_rows = (
            [_rotation_sense(label(x)) for x in ways.cells] if ways is not None and way is None else [way] * turn.size
        )
        for group, stated in dict.fromkeys(zip(groups, of_rows, strict=True)):
            rows = np.array([pair == (group, stated) for pair in zip(groups, of_rows, strict=True)])
            rows &= np.isfinite(turn) & np.isfinite(c.values)
            if rows.sum() < FEWEST or np.ptp(turn[rows]) < np.pi:
                continue
            way_round, angles, values = _in_order(stated, turn[rows], c.values[rows], way is not None and len(read) > 1)
            text = " ".join(filter(None, (plane, way_round, group, str(k // 2 + 1) if len(read) > 2 else "")))
            found.append((text, angles, values))
    return found


def _in_order(
    stated: str | None, angles: np.ndarray, values: np.ndarray, beside_another: bool
) -> tuple[str, np.ndarray, np.ndarray]:
    """Direction of rotation, and angles and readings in the order of motion; derived from the rows if not stated.

    beside_another: whether readings of both directions share one column of angles. Raises DataError if rows in the
    order of motion run in the other direction.
    """
    rises = bool(np.sum(np.diff(np.unwrap(angles))) > 0)
    way = stated or ("ccw" if rises else "cw")
    if rises == (way == "ccw"):
        return way, angles, values
    if not beside_another:
        raise DataError(
            f"rows labelled {way} have angles that {'increase' if rises else 'decrease'}: write the rows in the "
            "order of motion, angles counterclockwise (both directions may share one column of angles)"
        )
    return way, angles[::-1], values[::-1]
