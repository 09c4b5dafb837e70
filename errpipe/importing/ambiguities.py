"""Ambiguities that only the user can resolve: the import is refused with a question, nothing is assumed."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import ROLE_UNITS
from errpipe.domain.units import conversion
from errpipe.errors import DataError
from errpipe.importing import columns, words
from errpipe.importing.layout import COMPONENT, Layout, RawColumn
from errpipe.importing.proposed import ImportOptions, Proposal, slug

FEWEST_ROWS = 3  # rows with readings: a straight line fits any two
PLACES = ("command", "position", "actual")
# Other inputs that a deviation may depend on, if no position is recorded.
INPUTS = [
    "time",
    "temperature",
    "spindle_speed",
    "feed",
    "load",
    "force",
    "torque",
    "current",
    "pressure",
    "cut_length",
]
# Lengths that are known better than the machine: if its own probe measured them, its reading replaces the command.
_ARTEFACT = re.compile(
    r"\b(step ?gauges?|step ?bar|gau?ge ?blocks?|(stufen|parallel)?endmass\w*|(kugel|loch)(balken|platte|leiste)"
    r"|(ball|hole) ?(plate|beam|bar)|length bars?|calibrated( (length|value|position)s?|$)"
    r"|kalibrierte?[rs]?( (laenge|wert|position)\w*|$)"
    r"|posn|dprnt|inspection (report|print)|cal\.? ?[xyz]|cale etalon|blocco campione)\b|ブロックゲージ|量块|步距规"
)
_SIGNS = re.compile(r"\b(signs?|vorzeichen|vz|signe|segno|signo)\b|符号|^\W*\+ ?/ ?-\W*$|^\W*±\W*$")
_SHORT_OR_LONG = re.compile(
    r"[ls]|long|short|(zu )?(lang|kurz|weit)|too (long|short|far)|over|under|far|near|\+|-|plus|minus"
)


def refuse(p: Proposal, layout: Layout, options: ImportOptions) -> None:
    """Raise DataError for the first ambiguity of a complete proposal."""
    _too_few(p)
    _signs_in_a_column(p, layout, options)
    _unnamed_axis(p)
    _states_of_compensation(p, layout, options)
    _artefact(p, layout, options)
    _twice(p)


def _signs_in_a_column(p: Proposal, layout: Layout, options: ImportOptions) -> None:
    """Signs of readings in a separate column, as `+` and `-`, or `L` and `S`."""
    errors = [n for n, e in p.entries.items() if e["role"] == "error" and n in p.data]
    if not errors or any(np.nanmin(p.data[n], initial=0.0) < 0 for n in errors):
        return
    for c in (c for c in layout.columns if not {c.header, slug(c.header)} & {*options.sets}):
        labels = {words.plain(cell).removesuffix(".0").strip(".") for cell in c.cells if cell not in (None, "")}
        ignored = p.entries.get(p.names.get(c.header, ""), {}).get("role") == "ignore"
        of_signs = _SIGNS.search(words.plain(c.header)) and (not c.numeric or labels <= {"1", "-1"})
        if of_signs or (ignored and len(labels) == 2 and all(map(_SHORT_OR_LONG.fullmatch, labels))):
            raise DataError(
                f"column {c.header!r} contains {' and '.join(sorted(labels))}: are they signs of readings? Write each "
                f"reading with its sign (if not: --set '{c.header}.role=ignore')"
            )


MOST_STATES = 4  # labels of a column of states; with more, it is one of remarks
_OF_ANOTHER = re.compile(r"air|luft|material|wavelength|wellenlaenge|dead ?path|refract|tool|radius|cutter|werkzeug")
_A_STATE = re.compile(
    r"o(?:n|ff)|ein|aus|none|keine?|n(?:o|ein)|without|ohne|before|vor(?:her)?|raw|un[ck]omp\w*|original"
)


def _states_of_compensation(p: Proposal, layout: Layout, options: ImportOptions) -> None:
    """Readings with and without compensation, by a column of few labels: `Comp` with off and on, or `before comp`."""
    for c in (c for c in layout.columns if not {c.header, slug(c.header)} & {*options.sets}):
        role = p.entries.get(p.names.get(c.header, ""), {}).get("role")
        texts = {*c.texts} if role in ("ignore", "run", "group") else {""}
        if not 2 <= len(texts) <= (2 if c.numeric else MOST_STATES):
            continue
        labels, header = sorted(map(words.plain, texts)), words.plain(c.header)
        named = re.search(words.CORRECTION, header) and not _OF_ANOTHER.search(header)
        states = [re.search(words.CORRECTION, text) is not None for text in labels]
        if named or (any(states) and all(s or _A_STATE.fullmatch(x) for s, x in zip(states, labels, strict=True))):
            raise DataError(
                f"column {c.header!r} contains {' and '.join(labels)}: states of the machine, and only readings "
                f"without compensation are fitted. Keep their rows (if all are: --set '{c.header}.role=ignore')"
            )


def _artefact(p: Proposal, layout: Layout, options: ImportOptions) -> None:
    """Lengths of a gauge measured by the machine's own probe: reading minus gauge length is minus the deviation."""
    texts = [*layout.above, *(c.header for c in layout.columns)]
    stated = next((x for x in texts if _ARTEFACT.search(words.plain(x))), None)
    if stated is None or options.sign is not None or any("role" in keys for keys in options.sets.values()):
        return
    error = next((n for n, e in p.entries.items() if e["role"] == "error"), "")
    pair = p.entries.get(error, {}).get("derived", {}).get("minus")
    if pair:
        raise DataError(
            f"{stated[:60]!r}: who read {pair[0]!r}? The machine's own probe on a gauge: --set {pair[0]}.role=command "
            f"--set {pair[1]}.role=actual; a laser or gauge at the machine: --set {pair[0]}.role=actual "
            f"--set {pair[1]}.role=command"
        )
    raise DataError(
        f"{stated[:60]!r}: is {error!r} the reading of the machine minus the length of the gauge? Then use --sign "
        "commanded-minus-actual; if it is positive when the axis moves too far, use --sign actual-minus-commanded"
    )


def _twice(p: Proposal) -> None:
    """Two columns of deviations of one component, for example before and after compensation."""
    seen: dict[str, str] = {}
    for name, entry in p.entries.items():
        if entry["role"] != "error":
            continue
        first = seen.setdefault(entry["component"], name)
        if first != name:
            raise DataError(
                f"{first!r} and {name!r} are both deviations of {entry['component']}: which one is meant? Use "
                f"--set {name}.role=ignore (or {first}); if they are runs, name them run 1, run 2"
            )


def refuse_without_position(p: Proposal, asked: bool) -> None:
    """Raise DataError for readings without a position, a time or any other input that they could depend on.

    asked: whether to ask about a column that may be the position of a linear axis in any case.
    """
    roles = {e["role"] for e in p.entries.values()}
    left_out = next((n for n, e in p.entries.items() if e["role"] == "ignore"), None)
    for name, entry in p.entries.items():
        letter = entry.get("_axis") or (components.parse(entry["component"]).axis if entry["role"] == "error" else None)
        if entry["role"] != "error" or letter is None or entry["component"] != components.positioning(letter):
            continue
        places = [n for n, e in p.entries.items() if e["role"] in PLACES and e.get("axis") == letter]
        recorded, place = bool(places), next((n for n in places if p.entries[n]["role"] != "actual"), "")
        if place in p.data and np.unique(p.data[place]).size < 2 and not roles & {*INPUTS}:
            raise DataError(
                f"every reading of {name!r} is at {place} = {p.data[place][0]:g}: at which positions of "
                f"{letter} was it read? (declare their column with --set COLUMN.role=position)"
            )
        if not recorded and (components.is_rotary(letter) or not (asked or roles & {*PLACES, *INPUTS})):
            hint = f" (is it {left_out!r}? {p.guesses.get(left_out, '')})" if left_out else ""
            raise DataError(f"no position of {letter} is recorded with {name!r}: at which targets was it read?{hint}")


def _too_few(p: Proposal) -> None:
    """Raise DataError for a table of one or two rows: a remark or a test result, not a test."""
    read = [int(np.isfinite(p.data[n]).sum()) for n, e in p.entries.items() if e["role"] == "error" and n in p.data]
    rows = min(p.rows, max(read, default=p.rows))
    if rows < FEWEST_ROWS:
        raise DataError(
            f"{rows} row{'s' if rows > 1 else ''} with a reading (at least {FEWEST_ROWS}; ISO 230-2 requires five "
            "targets per metre, each approached five times from both directions)"
        )


def _unnamed_axis(p: Proposal) -> None:
    """Raise DataError if neither the file nor the user names the axis of the positions."""
    place = p.first("command") or p.first("position")
    if p.assumed_axis and place is not None and any(e["role"] == "error" for e in p.entries.values()):
        raise DataError(
            f"no axis is named in the file, its sheet or its name: along which axis is {place!r}? Declare it: --axis X "
            "(or Y, Z, ...)"
        )


def refuse_second_probe(p: Proposal, name: str, letter: str | None, options: ImportOptions) -> None:
    """Raise DataError for readings named X2 without a position of an axis X2: a second probe of a spindle test."""
    own = letter is not None and len(letter) > 1 and options.component is None
    if own and not any(e.get("axis") == letter for n, e in p.entries.items() if n != name):
        assert letter is not None
        raise DataError(
            f"{name!r} names {letter}, but no position of an axis {letter} is recorded: a second probe along "
            f"{letter[0]}? Use --set {name}.role=ignore, or import it separately with --component E_{letter[0]}"
        )


def refuse_another_title(p: Proposal, layout: Layout, options: ImportOptions) -> None:
    """Raise DataError if a line above names a straightness or a shape, and the readings would become positioning."""
    title = next((line for line in layout.above if columns.titles_other_component(line)), None)
    place = p.first("position") or p.first("command")
    if title is None or place is None or options.component is not None:
        return
    own = components.positioning(p.entries[place]["axis"])
    if any(e["role"] == "error" and e["component"] == own and "derived" not in e for e in p.entries.values()):
        raise DataError(
            f"a line above states {title[:60]!r}, but no column does: declare it with --component, such as "
            f"EYX (or {own}, the positioning)"
        )


_DIAMETERS = re.compile(
    r"\bprogram\w* (?:in|as|im) (?:diam|durchm)"
    r"|\b(diam\w*|durchmesser)[ -]?(program\w*|mode|on\b|values?|werte?|display|anzeige)|\bdurchmesser\w+|\bdiamon\b"
)


def refuse_diameters(layout: Layout, guesses: columns.Guesses, options: ImportOptions) -> None:
    """Raise DataError if positions of an axis are diameters, as for X of a lathe: readings may be halved or not."""
    places = [c for c in layout.columns if guesses[c.header].kind in PLACES and c.numeric]
    above = words.axis_above(layout.above)
    place = next((c for c in places if (columns.axis_in(c.header) or above) and columns.is_diameter(c.header)), None)
    line = next((x for x in layout.above if _DIAMETERS.search(words.plain(x)) and places), None)
    place = place or (places[0] if line is not None else None)
    stated = {} if place is None else options.sets.get(place.header) or options.sets.get(slug(place.header)) or {}
    if place is None or "role" in stated:
        return
    read = any(guesses[c.header].kind == "actual" for c in layout.columns)
    role = guesses[place.header].kind if read else "position"
    raise DataError(
        f"{'a line above' if line else 'a header'} says diameters ({line or place.header!r}): write positions and "
        f"readings as radii (half of a diameter), or, if they are radii, use --set '{place.header}.role={role}'"
    )


_OF_THE_MACHINE = re.compile(r"\b(machine|maschinen?\w*|macchina|maquina|mcs|mks|g53)\b")
SAME_PLACE, LEAST_SHIFT = 0.05, 0.5  # mm, deg: spread of the distance of two columns of one position; less is no zero
SHORTEST = 5.0  # mm, deg: of a travel


def machine_positions(
    layout: Layout, guesses: columns.Guesses, options: ImportOptions, in_columns: bool
) -> columns.Guesses:
    """The guesses, with the machine's own positions instead of those that count from the zero of a part (G54).

    A table acts over the former. in_columns: whether runs are in columns; without a deviation one of the positions may
    be the reading. Raises DataError if two columns are a constant apart and neither names the machine.
    """
    read = in_columns or any(g.kind == "error" for g in guesses.values())
    if not read:
        return guesses
    stated = {name for name, keys in options.sets.items() if "role" in keys}
    many = [c for c in layout.columns if c.numeric and (c.unit is None or c.unit in ROLE_UNITS["position"])]
    free = [c for c in many if not {c.header, slug(c.header)} & stated]
    own = [c for c in free if _OF_THE_MACHINE.search(words.plain(c.header))]
    places = [c for c in many if guesses[c.header].kind in PLACES[:2] and c not in own]
    if not places and len(own) == 1 and own[0].unit and guesses[own[0].header].kind == "ignore":
        axis = columns.axis_in(own[0].header) or options.axis
        return {**guesses, own[0].header: columns.ColumnGuess("position", axis, f"its name ({own[0].header!r})")}
    for place, c in ((place, c) for place in places for c in free if place in free and c is not place):
        letters = {columns.axis_in(x.header) for x in (place, c)} - {None}
        usable = ("group", *PLACES, "ignore") if c in own else (*PLACES[:2], "ignore") if c.unit else ()
        readings = [name for name, g in guesses.items() if g.kind == "error" and name != c.header]
        in_um = ("error", "actual") if c in own and readings else ()
        shift = _shift(place, c) if len(letters) < 2 and guesses[c.header].kind in (*usable, *in_um) else None
        if shift is None:
            continue
        if c not in own:
            raise DataError(
                f"{c.header!r} is {place.header!r} {shift:+.6g} in every row: which counts from the machine's zero (a "
                f"table acts there), which from that of a part (G54)? Use --set '{c.header}.role=command' --set "
                f"'{place.header}.role=ignore', or --set '{c.header}.role=ignore'"
            )
        why = f"its name ({c.header!r}): {place.header!r} counts from another zero, {-shift:+.6g} off"
        guesses = guesses | {
            c.header: columns.ColumnGuess("command", next(iter(letters), None), why),
            place.header: columns.ColumnGuess("ignore", None, f"not used: {c.header!r} has the machine's positions"),
        }
    return guesses


def _shift(place: RawColumn, other: RawColumn) -> float | None:
    """What a column has more than another in every row, mm or deg; None if that is nothing, or not the same."""
    x, y = (np.asarray(conversion("position", c.unit or "mm")(c.values)) for c in (place, other))  # type: ignore[misc]
    apart = (y - x)[np.isfinite(y - x)]
    if apart.size and "deg" in (place.unit, other.unit):  # one of them may count from 0 to 360 deg
        apart = apart[0] + (apart - apart[0] + 180.0) % 360.0 - 180.0
    short = apart.size < 3 or np.ptp(x[np.isfinite(y - x)]) < SHORTEST
    if short or np.ptp(apart) > SAME_PLACE or abs(apart.mean()) < LEAST_SHIFT:
        return None
    counted = np.unique(other.values)
    return None if np.array_equal(counted, np.arange(1, counted.size + 1)) else float(np.median(apart))


def component_above(layout: Layout, guesses: columns.Guesses, options: ImportOptions, p: Proposal) -> ImportOptions:
    """The options with the component, and its axis, named in lines above or in the file name, if no column names it.

    Raises DataError if several are named.
    """
    axis = options.axis or words.axis_above(layout.above)  # `EAC` next to axis X is a certification mark
    found = {name for line in layout.above for name in re.findall(COMPONENT, line)}
    named = sorted(name for name in found if axis in (None, name[2]))
    if axis and not named and not any(map(columns.names_a_turn, (c.header for c in layout.columns))):
        turned = _turn_above(layout, axis)
        named = [turned] if turned else []
        for c in layout.columns if turned else []:
            if c.unit == "inch" and guesses[c.header].kind in ("actual", "error"):  # `"` of an angle
                c.unit, guesses[c.header] = "arcsec", replace(guesses[c.header], kind="error")
    stated = options.component or any(columns.component_in(c.header) for c in layout.columns) or options.sets
    if not named or stated or sum(g.kind in ("error", "actual") for g in guesses.values()) == 0:
        return options
    if len(named) > 1:
        raise DataError(
            f"lines above the table, its sheet or file name {', '.join(named)}: what was measured? Declare it with "
            f"--component {named[0]} (or {', '.join(named[1:])})"
        )
    p.notes.append(f"the component is {named[0]}, from a line above the table, its sheet or file (--component)")
    return replace(options, component=named[0], axis=options.axis or named[0][2])


def _turn_above(layout: Layout, moved: str) -> str | None:
    """EBX from a line `Pitch` above angles along X, if lines name one of roll, pitch and yaw; or None."""
    found = {name for line in layout.above for pattern, name in columns.TURNS if re.search(pattern, words.plain(line))}
    about = columns.ANGLES.get(moved[0], {}).get(next(iter(found), ""))
    units = {c.unit for c in layout.columns}
    angles = units & {*columns.SMALL_ANGLES} or {"mm", "inch"} <= units  # `"` is used for inch and for arcsec
    return f"E{about}{moved}" if about and angles and len(found) == 1 else None
