"""Temperatures without a unit: identified by the name of the sensor or place, and by slowly changing values.

A name alone is not enough (`spindle` may be a speed or a load), nor are values alone. If one of the two is missing,
the column is not used, and a note states it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence

import numpy as np

from errpipe.importing.columns import ColumnGuess, Guesses
from errpipe.importing.layout import RawColumn
from errpipe.importing.proposed import Proposal
from errpipe.importing.words import plain

_SENSOR = re.compile(
    r"^(?:t|ts|tc|thc) ?[.:#-]?\d{1,2}(?=[^a-z0-9]|$)|^t(?=[ .:-]+[a-z])"
    r"|(?<![a-z])(?:tc|rtd|ntc|ptc|pt ?1000?|thermistor)(?![a-z])"
)
OF_A_SHOP = (-10.0, 50.0)  # degC of the air in a workshop, by judgement
_IN_A_NAME = re.compile(r"(?<![\w.,])T?(-?\d{1,2}(?:[.,]\d)?)(?:C| ?(?:°C|deg ?C|grad))(?![^\W_])")  # `18C`, `T20 degC`
_PLACES = (
    # spindle and its bearings
    "spindles?|spindel|broches?|mandrino|husillo|nose|nase|nez|quill|pinole|bearings?|brgs?|lager|paliers?|roulements?"
    "|cuscinett[io]|rodamientos?|cojinetes?|headstock|spindelstock|poupee|motors?|motoren|moteurs?|motore|drives?"
    "|antrieb|flanges?|flansch|housings?|gehaeuse|carter|gear ?box|getriebe|chuck|futter"
    # frame
    "|columns?|staender|saeule|colonne|colonna|columna|montant|bed|bett|bancada|banc|bati|basamento|base|frame|gestell"
    "|rahmen|portal|gantry|beam|traverse|querbalken|table|tisch|mesa|tavola|saddle|schlitten|ram|slides?|carriage"
    "|foundation|fundament|floor|boden|wall|wand"
    # media
    "|coolant|kuehl(?:mittel|wasser|schmierstoff)|kss|emulsion|refrigerante?|liquide|coupe|oil|oel|huile|olio|aceite"
    "|water|wasser|eau|acqua|agua|air|luft|aria|aire|tanks?|behaelter|cuve|reservoir|hydraulics?|hydraulik|chiller"
    "|ambient|ambiance|ambiante?|ambiente|room|raum|hall|halle|hallen|atelier|shop|umgebung|indoor|outdoor|enclosure|kabine"
    "|主[轴軸]|轴承|軸受|室温|冷却液|床身|立柱|丝杠|螺母|环境|前|后|後"
)
_OF_AN_AXIS = (  # with its letter: `nut X`; `spindle X` is the displacement of a spindle
    "ball ?screws?|screws?|kugelgewinde(?:trieb)?|vis|vite|husillo|nuts?|mutter|ecrou|chiocciola|tuerca|scales?"
    "|mass?stab|glas|regle|riga|regla|guides?|ways?|fuehrung|rails?|rack|motors?|moteur|motore|bearings?|brgs?|lager|palier|drive"
    "|antrieb"
)
_SIDES = (
    "front|rear|back|top|bottom|left|right|upper|lower|middle|mid|centre|center|inner|outer|inside|outside|in|out|inlet"
    "|outlet|return|supply|near|far|end|side|body|vorn|vorne|vorderes?|hinten|hinteres?|oben|unten|links|rechts|mitte|innen"
    "|aussen|vor|ruecklauf|vorlauf|zulauf|avant|arriere|haut|bas|gauche|droite|milieu|entree|sortie|retour|anteriore"
    "|posteriore|delantero|trasero|superior|inferior|l|r|v|h|o|u|de|du|la|le|der|des|of|the|am|an|im|at"
    "|sensor|fuehler|sonde|messstelle|ch|channel|kanal|voie|k|t|\\d{1,2}"
)
_PLACES = rf"(?:{_PLACES}|{_OF_AN_AXIS})"
_PLACE = re.compile(rf"{_PLACES}(?:(?:s|n|en)?{_PLACES})*")
_AXIS = re.compile(r"[xyz]\d?")
_SIDE = re.compile(_SIDES)
_OTHER_QUANTITY = re.compile(
    r"load|last\b|charge|power|leistung|puissance|speed|rpm|override|vibr|status|state|alarm|mode|posit|level|niveau|stand\b"
    r"|flow|fluss|debit|growth|displace|deviat|error|tilt|count|number|hours|stunden|volt|freq|veloc|accel|\bmass\b|weight"
    r"|length|ratio|percent|offset|setpoint|soll|strain|dehnung|gap|valve|pump"
)
_SET_POINT = re.compile(
    r"(.*[^\W\d_]{2}.*?)[\W_]*(?:temp[a-z]*[\W_]*)?(?:target|set ?point|set|soll[a-z]*)"
)  # `bed_target`
LONGEST_WORD = 40  # characters: compounds are not longer, and the cost of a pattern grows with the length
COLDEST, HOTTEST = 0.0, 120.0  # degC: range of a machine running in a shop
START = (5.0, 45.0)  # degC: a machine starts near the temperature of its shop; readings in degF start above
FEWEST = 5  # readings needed to detect a slow change
JUMP = 0.15  # of the span, in one row: a step of a speed or a load, if the neighbouring rows are constant
STILL = 0.25  # of the jump: largest change in the neighbouring rows
UNEVEN = 0.25  # of the value for independent readings (2 variances): the mean squared step of slowly changing values
CALM = 1.0  # K: within this span a room shows only noise


def with_temperatures(columns: Sequence[RawColumn], guesses: Guesses) -> tuple[Guesses, list[str]]:
    """The guesses with the columns that are clearly temperatures, and notes on possible ones."""
    out, notes = dict(guesses), []
    starts = _starts(columns, guesses)
    for c in columns:
        guess = guesses[c.header]
        if guess.kind != "ignore" or not guess.why or not c.numeric or c.unit is not None:
            continue  # without a reason: excluded by the user
        if _letter_of_a_unit(c, starts):
            out[c.header] = ColumnGuess("temperature", None, f"its location and the unit {c.unit}")
            continue
        text, known = plain(c.header), c.values[np.isfinite(c.values)]
        if known.size < FEWEST or _OTHER_QUANTITY.search(text):
            continue
        named, slow, usual = _named(text), _is_slow(c.values, starts), _in_range(c.values, starts)
        between = f"{known.min():.4g} to {known.max():.4g}"
        if named and slow and usual:
            why = f"its name and values ({between}, slow)"
            out[c.header] = ColumnGuess("temperature", None, why)
        elif named + slow + usual > 1 or (_SENSOR.search(text) and np.unique(known).size > 2):
            doubt = "its values are not plausible in degC" if named else "its name does not state it"
            notes.append(
                f"column {c.header!r} ({between}) is not used: it may be a temperature, but {doubt}; if it is one, use "
                f"--set '{c.header}.role=temperature', and its unit if it is not degC"
            )
    warm = [plain(h) for h, g in out.items() if g.kind == "temperature"]
    for c in columns:
        of = _SET_POINT.fullmatch(plain(c.header)) if out[c.header].kind == "command" else None
        if of and c.unit in (None, "degC", "degF") and any(re.match(rf"{re.escape(of[1])}[\W_]", w) for w in warm):
            out[c.header] = ColumnGuess("ignore", None, "the set point of a temperature")
    return out, notes


def _letter_of_a_unit(c: RawColumn, starts: np.ndarray) -> bool:
    """Give a column such as `bed_K` or `Bed (F)` the unit of its last letter, if its values are plausible in it."""
    letter = re.fullmatch(r"(.*[^\s_(\[])[\s_(\[]+([KCF])[)\]]?", c.header)
    if letter is None or not _named(plain(letter[1])) or not np.isfinite(c.values).any():
        return False
    unit, degrees = {"K": ("K", c.values - 273.15), "C": ("degC", c.values), "F": ("degF", (c.values - 32.0) / 1.8)}[
        letter[2]
    ]
    c.unit = unit if _in_range(degrees, starts) else None
    return c.unit is not None


def _named(text: str) -> bool:
    """Whether a header (`plain`) names a temperature sensor, or a machine part and nothing else."""
    if _SENSOR.search(text):
        return True
    words = [w for w in re.split(r"[^\w]+|(?<=[^\W\d])(?=\d)", text) if w]
    letters = any(re.fullmatch(_OF_AN_AXIS, w) for w in words)
    places = [w for w in words if len(w) <= LONGEST_WORD and _PLACE.fullmatch(w)]
    return bool(places) and all(w in places or _SIDE.fullmatch(w) or (letters and _AXIS.fullmatch(w)) for w in words)


def _starts(columns: Sequence[RawColumn], guesses: Guesses) -> np.ndarray:
    """Rows at which a run starts, by its label, or by times that go back or pause; (rows,), the first one True."""
    rows = len(columns[0].cells)
    begins = np.zeros(rows, dtype=bool)
    begins[:1] = True
    for c in columns:
        if guesses[c.header].kind in ("run", "group"):
            begins[1:] |= np.array([a != b for a, b in zip(c.cells, c.cells[1:], strict=False)], dtype=bool)
        elif guesses[c.header].kind == "time" and c.numeric and np.isfinite(step := np.diff(c.values)).any():
            begins[1:] |= (step < 0) | (step > 5.0 * np.nanmedian(step))
    return begins


def _in_range(values: np.ndarray, starts: np.ndarray) -> bool:
    """Whether the values are plausible for a machine, and their start for its shop."""
    if not (np.nanmin(values) > COLDEST and np.nanmax(values) < HOTTEST):
        return False
    first = np.median([v[0] for v in _stretches(values, starts)])
    return bool(START[0] <= first <= START[1])


def _is_slow(values: np.ndarray, starts: np.ndarray) -> bool:
    """Whether values change by less than their span per row, without a single step and not at a constant rate."""
    stretches = [v for v in _stretches(values, starts) if v.size > 1]
    known = np.concatenate(stretches) if stretches else np.zeros(0)
    if np.unique(known).size < FEWEST:
        return False
    span, steps = np.ptp(known), [np.diff(v) for v in stretches]
    moved = np.concatenate(steps)
    if np.ptp(moved) <= 1e-6 * span:
        return False
    for step in steps:
        size = np.abs(np.r_[0.0, step, 0.0])
        beside = np.maximum(size[:-2], size[2:])
        if span > CALM and np.any((size[1:-1] > JUMP * span) & (beside < STILL * size[1:-1])):
            return False
    variance = sum(np.sum((v - v.mean()) ** 2) for v in stretches) / known.size
    return bool(span <= CALM or np.mean(moved**2) <= UNEVEN * 2.0 * variance)


def _stretches(values: np.ndarray, starts: np.ndarray) -> list[np.ndarray]:
    """The readings of every run, without missing ones."""
    parts = np.split(values, np.flatnonzero(starts)[1:])
    return [known for part in parts if (known := part[np.isfinite(part)]).size]


def of_names(parts: Collection[Proposal], names: Sequence[str]) -> None:
    """A column of the temperature that the name of each file states, in place, if they differ and no file holds one."""
    found = [_IN_A_NAME.findall(name.replace("_", " ")) for name in names]
    stated = {of[0] for of in found if len(of) == 1}
    if len(stated) < 2 or any(len(of) != 1 for of in found) or any(part.first("temperature") for part in parts):
        return
    if any(not OF_A_SHOP[0] <= float(text.replace(",", ".")) <= OF_A_SHOP[1] for text in stated):
        return  # `DMU 60C` is a machine
    for part, (text,) in zip(parts, found, strict=True):
        values = np.full(part.rows, float(text.replace(",", ".")))
        part.put("temperature", values, "from the names of the files or folders", role="temperature", unit="degC")
