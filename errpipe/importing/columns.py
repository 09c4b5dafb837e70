"""The probable role of a column, from its header, unit and values: a guess with its reason, for the user to confirm."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from errpipe.domain import components
from errpipe.errors import DataError
from errpipe.importing import values
from errpipe.importing.dates import seconds
from errpipe.importing.layout import NUMERIC_SHARE, Layout, RawColumn
from errpipe.importing.units import in_brackets
from errpipe.importing.words import AXIS_LETTER, CORRECTION, DISPLACEMENT, DISTANCE, GROUPS, kind_by_name, plain, way_of

KIND_OF_UNIT = {
    **dict.fromkeys(("degC", "degF", "K"), "temperature"),
    "counts": "counts",
    **dict.fromkeys(("A", "mA"), "current"),
    "N m": "torque",
    "rpm": "spindle_speed",
    "mm/min": "feed",
    **dict.fromkeys(("mm/s", "m/s"), "velocity"),
    **dict.fromkeys(("mm/s2", "m/s2"), "acceleration"),
    **dict.fromkeys(("N", "kN"), "force"),
    "hPa": "pressure",
    "%": "humidity",
    "kg": "load",
    **dict.fromkeys(("s", "ms", "h"), "time"),
    **dict.fromkeys(("um", "urad", "arcsec", "mrad", "um/m", "mm/m", "nm", "mdeg", "arcmin"), "error"),
    **dict.fromkeys(("0.001 inch", "0.0001 inch", "microinch"), "error"),
}
SMALL_ANGLES = ("arcsec", "arcmin", "urad", "mrad", "mdeg", "um/m", "mm/m")  # of a rotary or tilting axis
# Units that an angle may be written in; " and ' are read as inch and min.
_ANY_ANGLE = (*SMALL_ANGLES, "deg", "rad", "inch", "s", "min")
OF_SMALL_LENGTHS = ("um", "urad", "arcsec", "nm", "0.001 inch", "0.0001 inch", "microinch")
OF_DEVIATIONS = ("um", "urad", "nm", "arcsec", "mrad")
UNKNOWN = "neither its name, its unit nor its values identify it"
_SHARES = r"load|last|torque|moment|override|duty|power|leistung|utili"  # in %, not a humidity
PLACE = ("command", "position", "actual", "counts")
TOO_SMALL = ": too small for a position)"  # of a column that its name calls one
PLACES = ("error", "counts")  # kinds of units in which a position may also be logged: um, arcsec, counts
# Physical symbols that are also axis letters: `v [mm/s]` is not the velocity of axis V.
SYMBOLS = {"velocity": "V", "feed": "V", "acceleration": "A", "temperature": "C", "pressure": "B"}
_BEFORE = (
    r"(?:[dΔδ]|[ef](?=[XYZ]\b)|pos|err(?:or)?|dev|cmd|act|nom|target|soll|ist|ref)(?=[XYZ](?![a-z]))"  # posX, errY, dZ
)
_BEHIND = r"axis|achse|pos|cmd|act|soll|ist|abw|fehler|(?:err(?:or)?|dev|drift|target|nom)(?![a-z])"  # Xerr
_AXIS = re.compile(
    rf"(?:^|[\s_.\-(/<:]|(?<=i[bmw])\[|(?<=pos)\[)(?:{_BEFORE})?{AXIS_LETTER}(?:\d|[\s_.\-)/\[\]]|$|{_BEHIND})",
    re.IGNORECASE,
)
_WORDS = re.compile(
    r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|(?<=[\u3040-\ud7af])(?=[A-Za-z])|(?<=[A-Za-z])(?=[\u3040-\ud7af])"
)
_FILLER = re.compile(r"(from|von|approach(ed)?|direction|richtung|dir|the|side|to|towards?)?")
_FROM = ("from", "von", "de", "da", "desde")  # a sign after it states where the axis came from: `from -` is from below
_SIGNS_IN_WORDS = ("plus", "minus", "positive", "negative", "positiv", "negativ")
_SIGN = re.compile(r"\+|-|plus|minus|p|n|pos(itive?)?|neg(ative?)?")
EVEN_STEPS = "its even steps"
NO_SIDES = "named as a direction, but its values are not two signs"


@dataclass(frozen=True)
class ColumnGuess:
    """kind: a role, `actual` or `counts`; axis: letter or None; why: the reason, for the user."""

    kind: str
    axis: str | None
    why: str


Guesses = dict[str, ColumnGuess]  # by header


def guess(column: RawColumn) -> ColumnGuess:
    """The probable role of a column. A column that fits no role is `ignore`."""
    found = _guess(column, axis_in(column.header))
    return replace(found, axis=None) if found.axis is not None and found.axis == SYMBOLS.get(found.kind) else found


def _guess(column: RawColumn, axis: str | None) -> ColumnGuess:
    if column.numeric and component_in(column.header.strip()) == column.header.strip().upper():
        return ColumnGuess("error", axis, f"its name ({column.header}, a component of ISO 230-1)")
    if (kind := kind_by_name(column.header)) is not None:
        kind, why = _settled(kind, column)
        return ColumnGuess(kind, axis, why or f"its name ({column.header!r})")
    if column.numeric and column.unit in _ANY_ANGLE and names_a_turn(column.header):
        return ColumnGuess("error", axis, f"its name ({column.header!r}) and unit ({column.unit})")
    if KIND_OF_UNIT.get(column.unit or "") == "error" and values.is_scatter(column):
        return ColumnGuess("ignore", axis, values.SCATTER)
    if column.unit == "%" and re.search(_SHARES, plain(column.header)):
        return ColumnGuess("ignore", axis, "a percentage, and not a humidity by its name")
    if column.unit in KIND_OF_UNIT and column.numeric:
        return ColumnGuess(KIND_OF_UNIT[column.unit], axis, f"its unit ({column.unit})")
    if _side(column) is not None and column.values.size > 3:
        return ColumnGuess("direction", axis, "its values (two signs)")
    if seconds(column) is not None and not column.numeric:
        return ColumnGuess("time", axis, "its values (dates)")
    return ColumnGuess("ignore", axis, UNKNOWN)


def with_period(layout: Layout, period: float | None) -> Layout:
    """The layout with a time column if the user states the time between rows and no column is a time."""
    if period is None or not layout.columns or any(guess(c).kind == "time" for c in layout.columns):
        return layout
    times = period * np.arange(len(layout.columns[0].cells))
    layout.columns.insert(0, RawColumn("t", "s", times.tolist(), times))
    layout.notes.append(f"one row every {period:g} s, from --period")
    return layout


def with_one_clock(guesses: Guesses) -> Guesses:
    """The guesses; if there is a clock, `T_nut` is a temperature, however evenly it rises."""
    even = {h: ColumnGuess("temperature", None, g.why) for h, g in guesses.items() if g.why.endswith(EVEN_STEPS)}
    return guesses | even if len(even) < sum(g.kind == "time" for g in guesses.values()) else guesses


def with_position_column(columns: list[RawColumn], guesses: Guesses, stated: str | None) -> Guesses:
    """The guesses; if no column is a position, the only column that names an axis and has the size of a travel is one.

    A distance beside a position and a reading is none.
    stated: an axis declared by the user; for a rotary one the only column of angles is the position: `q1 [rad]`.
    """
    places = {h: g for h, g in guesses.items() if g.kind in PLACE}
    apart = [h for h, g in places.items() if g.why and re.search(DISTANCE, plain(h))]
    if apart and len(apart) < len(places) and any(g.kind == "error" for g in guesses.values()):
        return guesses | dict.fromkeys(apart, ColumnGuess("ignore", None, "a distance beside a position"))
    if places:
        return guesses
    small = [c for c in columns if guesses[c.header].why.endswith(TOO_SMALL)]
    read = [c for c in columns if guesses[c.header].kind == "error" and c not in small]
    if len(small) == len(read) == 1 and values.is_nano_travel(small[0], read[0]):
        why = f"its name ({small[0].header!r}): the small travel beside {read[0].header!r}"
        return {**guesses, small[0].header: ColumnGuess("position", guesses[small[0].header].axis, why)}
    turns = stated is not None and components.is_rotary(stated)
    units = ("deg", "rad") if turns else ("mm", "m", "inch")
    ignored = [c for c in columns if guesses[c.header].kind == "ignore" and c.unit in units and c.numeric]
    long = [c for c in ignored if turns or axis_in(c.header)]
    if len(long) != 1 or not (turns or values.as_long_as_a_travel(long[0])):
        return guesses
    axis = stated if turns else axis_in(long[0].header)
    why = (
        f"its unit ({long[0].unit}): the only angle"
        if turns
        else f"its axis ({axis}), unit and size: the range of a travel"
    )
    return {**guesses, long[0].header: ColumnGuess("position", axis, why)}


def _settled(kind: str, column: RawColumn) -> tuple[str, str]:
    """The kind, corrected if the column's unit and values contradict it."""
    unit = column.unit
    if kind not in ("time", "run", "group", "direction") and not column.numeric:
        return "ignore", "its values are not numbers"
    if kind == "time" and KIND_OF_UNIT.get(unit or "", "time") != "time":
        return KIND_OF_UNIT[unit or ""], f"its unit ({unit})"
    if kind == "time" and plain(column.header) in ("min", "h") and not values.rises_evenly(column):
        return "ignore", UNKNOWN  # the smallest of the runs
    if kind == "position" and unit in OF_SMALL_LENGTHS and not values.too_large_for_a_deviation(column):
        return "error", f"its unit ({unit}{TOO_SMALL}"
    if kind == "actual" and unit in SMALL_ANGLES:
        return "error", f"its unit ({unit})"
    if kind == "command" and unit in ("um", "nm") and not values.too_large_for_a_deviation(column):
        return "error", f"its unit ({unit}{TOO_SMALL}"
    if kind == "actual" and unit in OF_DEVIATIONS and component_in(column.header):
        return "error", f"its name ({component_in(column.header)}, a component of ISO 230-1)"
    if kind in ("temperature",) and unit is not None and KIND_OF_UNIT.get(unit) not in ("temperature", None):
        return KIND_OF_UNIT[unit], f"its unit ({unit})"
    if kind == "temperature" and unit is None and values.is_even_time(column):
        return "time", f"its name ({column.header!r}) and {EVEN_STEPS}"
    if kind == "temperature" and unit is None and column.numeric and not values.plausible_in_celsius(column):
        return "ignore", "named like a temperature, but its values are not plausible in degC"
    if kind == "group" and unit in ("mm", "m", "inch", "deg"):
        return ("position" if group_of(column.header) == "machine" else "ignore"), f"its unit ({unit})"
    if kind == "group" and not 1 < len({*column.texts}) <= 0.5 * len(column.cells):
        return "ignore", "named like a group label, but its values do not group rows"
    if kind == "error" and values.is_scatter(column):
        return "ignore", values.SCATTER
    if kind == "error" and re.search(DISPLACEMENT, plain(column.header)) and values.as_long_as_a_travel(column):
        return "actual", "its size: a displacement with the range of a travel is a position"
    if kind == "coolant" and KIND_OF_UNIT.get(unit or "") is not None:
        return KIND_OF_UNIT[unit or ""], f"its unit ({unit})"
    stated = unit or in_brackets(column.header)
    if kind == "coolant" and stated is None and not set(np.unique(values.known(column))) <= {0.0, 1.0}:
        return "ignore", "named as coolant, but its values are not 0 and 1 (off and on)"
    if kind == "direction" and not _states_sides(column):
        return "ignore", NO_SIDES
    if kind == "run" and _side(column) is not None:
        return "direction", "its values (two signs)"  # `Pass`: forward, return
    if kind == "error" and re.search(CORRECTION, plain(column.header)) and np.unique(values.known(column)).size <= 2:
        return "ignore", "named as a compensation, but with two values: it states whether one is active"
    if kind in ("position", "command") and unit is None and values.numbers_targets(column):
        return "ignore", "the number of a target, not its position"
    if kind in ("position", "command", "actual") and KIND_OF_UNIT.get(unit or "", "error") not in PLACES:
        return KIND_OF_UNIT[unit or ""], f"its unit ({unit})"
    if kind in ("position", "command", "actual") and unit == "counts":
        return "counts", "its unit (counts)"
    if kind == "counts" and (unit in OF_SMALL_LENGTHS or unit in OF_DEVIATIONS):
        return "error", f"its unit ({unit})"  # divisions of a dial, with their size
    if kind in ("velocity", "feed") and unit in ("rpm",):
        return "spindle_speed", f"its unit ({unit})"
    return kind, ""


def group_of(header: str) -> str:
    """What the labels of a column denote: season, month, ... by its header, else the header itself."""
    text = plain(header)
    return next((name for name, words in GROUPS.items() if re.match(words, text)), text.replace(" ", "_"))


def axis_in(text: str) -> str | None:
    """The axis letter that a text names, or None: `ErrorY`, `posz`, `Y軸位置`; for EYX the moving axis."""
    if (name := component_in(text)) is not None and (moved := components.parse(name).axis) is not None:
        return moved
    match = _AXIS.search(text) or _AXIS.search(_WORDS.sub(" ", text))
    return match.group(1).upper() if match else None


def component_in(text: str) -> str | None:
    """The ISO 230-1 component that a header names, or None."""
    if lower := re.match(r"(e[xyzabc][xyzabc])(?![^\W_])", text):  # `exx_um`
        return components.parse(lower[1].upper()).name
    for word in re.findall(r"[A-Z][A-Z0-9_]{2,4}", text):
        try:
            return components.parse(word).name
        except ValueError:
            continue
    return None


# Angular errors of a horizontal axis by their usual names (ISO 230-1): the axis of rotation.
ANGLES = {
    "X": {"roll": "A", "pitch": "B", "yaw": "C"},
    "Y": {"roll": "B", "pitch": "A", "yaw": "C"},
    "Z": {"roll": "C"},  # pitch and yaw of a vertical axis have no usual assignment
}


def is_straightness(text: str) -> bool:
    """Whether a header names a straightness: its letter is the axis perpendicular to the moving one."""
    return re.search(_STRAIGHT, plain(text)) is not None


def is_radius(text: str) -> bool:
    """Whether a header names the radius of a circular test."""
    return re.search(_RADIUS, plain(text)) is not None


# Quantities that are not the positioning deviation of the axis along which they were measured.
_DIAMETER = (
    r"\b(diamet(er|re|ro)|durchmesser)|^(dia|diam)\b(?! ?\d)|直[径徑]|(?i:^ø)"  # `dia 3`: the third day in Spanish
)
_OF_A_LATHE = r"\b(dia|diam|diamet\w*|durchm\w*)\b|[øØ⌀]|直[径徑]"  # of a position
_RADIUS = r"\b(radi(us|al\w*)|d ?r|ball ?bar)\b|半径"  # of a circular test


def is_diameter(text: str) -> bool:
    """Whether a header states that its values are diameters: `X (dia)`, `X Ø`."""
    return re.search(_OF_A_LATHE, plain(text)) is not None


_SHAPES = (
    r"flatness|ebenheit|planeit|squareness|perpendicular|rechtwinkl|parallel(ism|itaet)|roundness|rundheit|run-?out|rundlauf"
    r"|planlauf|cylindric|zylinderform|平面度|垂直度|直角度|平行度|圆度|真円度"
)


def other_component(text: str, moved: str) -> str | None:
    """EYX for 'straightness Y' along X, ECX for 'yaw', E_D for 'diameter', E_R for 'radius'; None for other headers.

    Raises DataError if incomplete, and for a shape (flatness, squareness), which is not a component of the axis alone.
    """
    word = plain(text)
    if re.search(_DIAMETER, word):
        return "E_D"
    if is_radius(text):
        return "E_R"
    if re.search(_SHAPES, word):
        raise DataError(f"column {text!r}: which component is this? Declare it with --component, such as EZX or C0Y")
    if is_straightness(text):
        across = axis_in(text)
        if across is None or across == moved or across[0] not in "XYZ":
            raise DataError(
                f"column {text!r}: a straightness in which direction? Declare it with --component, such as "
                f"EYX (next to other readings: --set '{text}.component=EYX')"
            )
        return f"E{across}{moved}"
    for pattern, name in TURNS:
        if re.search(pattern, word):
            about = ANGLES.get(moved[0], {}).get(name)
            if about is None:
                raise DataError(f"column {text!r}: about which axis? Declare it with --component, such as EBZ")
            return f"E{about}{moved}"
    return None


TURNS = (
    (r"\b(roll\w*|rollen)\b", "roll"),
    (r"\b(pitch(?! ?(error)? ?comp)|nick\w*)\b", "pitch"),  # of a screw: pitch error compensation
    (r"\b(yaw|gier\w*)\b", "yaw"),
)


def names_a_turn(header: str) -> bool:
    """Whether a header names roll, pitch or yaw."""
    return any(re.search(pattern, plain(header)) for pattern, _ in TURNS)


_STRAIGHT = r"straight|gerad(?!e)|rectitud|rettilin|直线度|真直度"


def titles_other_component(line: str) -> bool:
    """Whether a line above a table names a straightness, a rotation or a shape as measured: not `Squareness: off`."""
    parts = [part for part in re.split("[:=：]", plain(line)) if part.strip()]
    return bool(parts) and re.search(rf"{_STRAIGHT}|\b(yaw|roll)\b|{_SHAPES}", parts[-1]) is not None


def side(text: object) -> float | None:
    """+1 or -1 for a word of direction (`fwd`, `from above`, `zurück`), or None."""
    word = re.sub(r"^([+-])ve$", r"\1", plain(text).removesuffix(".0").strip(".:()"))
    word = re.sub(r"^[xyzabcuvw]\d? ?([+-])$|^([+-])[xyzabcuvw]\d?$", r"\1\2", word)
    words = [w for w in re.split(r"[\s_.]+", word) if not _FILLER.fullmatch(w)]
    came_from = len(words) == 1 and _SIGN.fullmatch(words[0]) and set(_FROM) & set(re.split(r"[\s_.]+", word))
    word = words[0] if len(words) == 1 else word
    way = way_of(word)
    return -way if came_from and way is not None else way


_SIDE_ABOVE = re.compile(
    r"(?:approach|anfahr|measur|mess)?\w* ?(?:direction|richtung|approach\w*|senso?|sentido|direzione|方向)\W+(\w.*)"
)

_OF_AN_APPROACH = re.compile(
    r"\bapproach(?:ed|es|ing)?\b|\banfahr(?:t|richtung)?\b|\bangefahren\b|\bunidirectional\b|\beinseitig\b"
    r"|^only (?=\w+ (?:runs?|passes|direction)$)|^nur "
)
_CAME_FROM = re.compile(rf"\b({'|'.join(_FROM)})(?: (?:the|der))? ?([+-](?!\w)|plus|minus|positiven?|negativen?)")
_SINGLE_SIGN = re.compile(r"\(([+-])\)|[:=] ?([+-])$")


def side_above(lines: list[str]) -> str | None:
    """The side of all readings as stated in a line above a table: `backward` from `Direction: backward`; or None.

    A sign alone may be that of a beam or a drive: it states a side only in a line on the approach.
    """
    found = [m[1].strip() for line in lines if (m := _SIDE_ABOVE.fullmatch(plain(line)))]
    stated = [text for text in found if re.search(r"[^\W\d_]{2}", text) and side(text) is not None]
    stated += [text for line in lines if (text := _approach(plain(line))) is not None and not stated]
    return stated[0] if len({side(text) for text in stated}) == 1 else None


def _approach(line: str) -> str | None:
    """The side stated in a line on the approach: `-` in `Approach from above (-)`, `from above` for `from +`."""
    if not _OF_AN_APPROACH.search(line) or re.search(r"\d", line):
        return None
    if came := _CAME_FROM.search(line):
        return "from below" if came[2].startswith(("-", "minus", "neg")) else "from above"
    found = [a or b for a, b in _SINGLE_SIGN.findall(line)]
    found += [w for w in re.findall(r"[^\W\d_]{2,}", line) if not _SIGN.fullmatch(w) or w in _SIGNS_IN_WORDS]
    stated = [w for w in found if side(w) is not None]
    return stated[-1] if len({side(w) for w in stated}) == 1 else None


def side_in(header: str) -> str | None:
    """The word in a header that states the side of its readings: `bwd` in `Error bwd [um]`; or None."""
    found = [w for w in re.findall(r"[^\W\d_]{2,}", plain(header)) if not _SIGN.fullmatch(w) and side(w) is not None]
    return found[0] if len(found) == 1 else None


_CAME_FROM_HEADER = re.compile(r"\b(from|von|aus|desde|depuis|da)$|\b(approach|anfahr)[ -]?(side|seite)$")


def _came_or_went(header: str, cell: object) -> float | None:
    """The side of a cell; below `Approach from` a sign states the origin of the motion: + is from above."""
    way, came = side(cell), _CAME_FROM_HEADER.search(plain(header).strip(" :.()"))
    return -way if came and way is not None and _SIGN.fullmatch(plain(cell)) else way


def _side(column: RawColumn) -> np.ndarray | None:
    """The column as +1 and -1, if every filled cell is a direction and both occur."""
    filled, ways = [c for c in column.cells if c not in (None, "")], dict[object, float | None]()
    for cell in filled:  # a long column of numbers is none at its first cell
        if cell not in ways and ways.setdefault(cell, _came_or_went(column.header, cell)) is None:
            return None
    return np.array([ways[c] for c in filled], dtype=float) if len(set(ways.values())) == 2 else None


def _states_sides(column: RawColumn) -> bool:
    """Whether most filled cells are sides: the others may be remarks below the table."""
    known = [side(c) is not None for c in column.cells if c not in (None, "")]
    return sum(known) >= NUMERIC_SHARE * len(known)


def sides(column: RawColumn) -> np.ndarray:
    """The column as +1 and -1; empty cells are NaN."""
    signs = [_came_or_went(column.header, c) if c not in (None, "") else None for c in column.cells]
    return np.array([np.nan if s is None else s for s in signs])
