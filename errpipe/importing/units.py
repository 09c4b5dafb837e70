"""Units as files write them: in headers, in brackets, after numbers; including those unknown to a manifest."""

from __future__ import annotations

import re

import numpy as np

from errpipe.domain.recording import ROLE_UNITS
from errpipe.importing.words import kind_by_name

# Spellings of units -> spelling in the manifest. Lower case, blanks removed.
_SPELLINGS = {
    "um": "µm μm um micron microns mikron mikrometer micrometer micrometers мкм 微米 µ âµm æm",
    "mm": "mm millimeter millimeters millimetre мм 毫米",
    "m": "m meter metre meters metres",
    "nm": "nm nanometer",
    "inch": 'in inch inches zoll "',
    "0.001 inch": "mil mils thou thous",
    "0.0001 inch": "tenth tenths",
    "0.01 mm": "hundredths hundertstel hundertstelmm",
    "0.001 mm": "tausendstel",
    "degC": "°c degc c celsius ℃ gradc â°c",
    "degF": "°f degf fahrenheit ℉",
    "K": "k kelvin",
    "s": "s sec sek seconds sekunden secondes secondi segundos",
    "ms": "ms msec",
    "us": "us µs μs",
    "min": "min minutes minuten minuti minutos",
    "h": "h hours std stunden heures horas",
    "microinch": "µin μin uin microinch microinches millionths",
    "deg": "° deg degree degrees grad 度",
    "mdeg": "mdeg m°",
    "arcmin": "arcmin arc-min arcminutes",
    "urad": "µrad μrad urad",
    "um/m": "µm/m μm/m um/m",
    "arcsec": "arcsec ″ '' asec arc-sec arc-seconds arcseconds arcsecs secofarc secondsofarc winkelsekunden winkelsek"
    " bogensekunden угл.сек",
    "A": "a amp amps ampere",
    "mA": "ma",
    "N m": "nm. n·m n.m n*m newtonmeter",
    "N": "n newton",
    "kN": "kn",
    "rpm": "rpm 1/min u/min rev/min min-1",
    "mm/s2": "mm/s2 mm/s² mm/s^2",
    "m/s2": "m/s2 m/s²",
    "%": "% %rh percent",
    "hPa": "hpa mbar",
    "counts": "counts count cnt cts inc ink inkremente pulses steps impulse",
}
_AS_THEY_ARE = "cm mrad rad mm/min m/min mm/s m/s kg ns mm/m"
UNITS = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
UNITS |= {unit: unit for unit in _AS_THEY_ARE.split()}

# A tenth, hundredth, ... of a unit: `0.1 um`, `1/1000 mm`, `x 0.0001"`, `10^-4 mm`.
_PART = re.compile(r"[x×*]?(?:1/(10+)|(?:10\^?|1e)[-−]([1-6])|(0?[.,]0*1))[x×*·]?([a-zµμ°\"]+)")
_OVER = re.compile(r"([a-zµμ\"]+)/(10+)")  # `in/10000`
_TENS = re.compile(r"(10{1,2})(nm|[uµμ]m)")  # `10 µm` is 0.01 mm, `100 nm` is 0.1 um
_BRACKET = re.compile(r"\s*(?:[\[(]\s*([^\[\]()]{1,14})\s*[\])]|\"([^\W\d]{1,4})\")\s*")
# A last letter is a unit only for a quantity that has it: `time h`, `T1_K`; not in `current A`, perhaps of axis A.
LETTERS = {
    **{"s": ("time", "s"), "h": ("time", "h"), "N": ("force", "N")},
    **{"K": ("temperature", "K"), "C": ("temperature", "degC"), "F": ("temperature", "degF")},
}
_LAST_LETTER = re.compile(r"^(.*[^\s_/,.(\[])[\s_/,(\[]+([shKCFN])[)\]]?$")
_INLET = re.compile(r"((coolant|oil|water|air|chiller)[\s_]+|\b[^\W\dxyz]_)in$", re.IGNORECASE)  # not inches; `u_in`
_SIGNS = '"°″'
_AFTER = re.compile(r"^(.*\S)[\s_/,]+(?:in\s+)?([^\s_/,]{1,11})$")

# Units in words, with their plurals: `micrometres`, `Mikrometern`, `micromètres`, `micras`; and their fractions.
_METRES = re.compile(
    r"\b(micro|mikro|micró|milli|milí|mili|nano|nanó|миллим|микром|наном)(?:-?m[eè]t(?:er|re?|ro?|ri)(?:s|n|i|y|ów|ach|u)?|етр\w{0,2})\b"
    r"|\b(micras|micra)\b",
    re.IGNORECASE,
)
_SECONDS = re.compile(
    r"\b(?:seconds? of arc|sec\.? of arc|arc seconds?|secondes? d'arc|secondi d'arco|segundos? de arco"
    r"|(?:winkel|bogen)sekunden)\b",
    re.IGNORECASE,
)
_METRE = {"mi": "mm", "на": "nm", "na": "nm", "ми": "mm"}
_PARTS = (
    (r"ten[ -]?thousandths?|zehntausendstel", 4),
    (r"hundred[ -]?thousandths?|hunderttausendstel", 5),
    (r"tenths?|zehntel|dixiemes?|dixièmes?|decimi|décimas?", 1),
    (r"hundredths?|hundertstel|centiemes?|centièmes?|centesimi|centésimas?", 2),
    (r"thousandths?|tausendstel|milliemes?|millièmes?|millesimi|milésimas?", 3),
    (r"millionths?|millionstel", 6),
)
_PART_IN_WORDS = re.compile(
    r"\b(?:" + "|".join(f"({words})" for words, _ in _PARTS) + r")[ -]?"
    r"(?:(?:of|d[eiu]|d')\s?(?:an?\s|one\s|un[ae]?\s)?|eines\s)?\s?"
    r"(mm|um|µm|inch|inches|in|\"|thou|mil|zoll|metre|meter|m)(?![^\W_])",
    re.IGNORECASE,
)
_PART_OF = re.compile(  # `0.001 mm`, `1/100mm`, `10^-4 mm` outside brackets
    r"(?<![\[(\d.,/])([x×*]?(?:1/10+|(?:10\^?|1e)[-−][1-6]|0?[.,]0*1)\s?(?:mm|um|µm|inch|in|\"|°C|degC))(?![^\W_])(?!\s?[\])])",
    re.IGNORECASE,
)


def in_words(text: str) -> str:
    """A text with `[0.01 mm]` for units or fractions written in words: `hundredths of a millimetre`."""

    def symbol(match: re.Match[str]) -> str:
        word = match.group(0).lower()
        return "um" if word.startswith(("mic", "mik", "мик")) else _METRE[word[:2]]

    def part(match: re.Match[str]) -> str:
        zeros = next(n for group, (_, n) in zip(match.groups(), _PARTS, strict=False) if group)
        base = match.groups()[-1].lower()
        zeros, base = (zeros + 3, "inch") if base in ("thou", "mil") else (zeros, base)
        return f"[1e-{zeros} {base}]"

    text = _SECONDS.sub("arcsec", text)
    plain = _METRES.sub(symbol, text.replace("μ", "µ"))
    marked = _PART_OF.sub(r"[\1]", _PART_IN_WORDS.sub(part, plain))
    return re.sub(r"[\[(]\s*(\[[^\[\]]+\])\s*[\])]", r"\1", re.sub(r"\b(in|en|w|em) (?=\[)", "", marked))


_RESOLUTION = re.compile(r"resol|aufl[oö]|schritt|\bstep|least|count", re.IGNORECASE)


def units_in(line: str) -> list[str]:
    """The units in a line of text, in order, without those of amounts.

    `in` counts only at the end, or alone in brackets.
    """
    line = in_words(line)
    found: dict[int, str] = {}
    for bracket in _BRACKET.finditer(line):
        unit = unit_of(bracket.group(1) or bracket.group(2))
        if unit is not None and not (unit.startswith("0.") and _RESOLUTION.search(line[: bracket.start()])):
            found[bracket.start()] = unit
    rest = _BRACKET.sub(lambda b: " " * len(b.group(0)) if b.start() in found else b.group(0), line)
    for word in re.finditer(r"[^\s\[\]():;,=]+", rest):
        unit = unit_of(word.group(0))
        amount = re.search(r"\d\s?$", line[: word.start()]) is not None  # `Limit 20 um`
        if unit and not amount and (word.group(0).lower() != "in" or not line[word.end() :].strip(" .:;,")):
            found[word.start()] = unit
    return [found[at] for at in sorted(found)]


_PER_LENGTH = re.compile(
    r"\bpp[mb]\b|[uµμ]m ?(/|per) ?m(m|etre|eter)?\b|\bof (range|travel|full scale)\b", re.IGNORECASE
)

PER_LENGTH = ("um/m", "mm/m")  # urad and mrad for an angle


def per_length(header: str) -> bool:
    """Whether a header states readings per length of travel: `error ppm`, `um/m`, `ppm of range`."""
    return _PER_LENGTH.search(header.replace("_", " ")) is not None


def unit_of(text: str) -> str | None:
    """The unit that a text is, or None. Nm is a torque, nm a length; a fraction of a length is `0.1 um`."""
    plain = text.strip().lstrip(":").rstrip(".:")  # `.0001"` starts with its point
    if plain in ("Nm", "N m", "my"):  # not `My`, a moment
        return "um" if plain == "my" else "N m"
    word = plain.lower().replace(" ", "")
    word = _OVER.sub(r"1/\2\1", word) if _OVER.fullmatch(word) else word
    if tens := _TENS.fullmatch(word):
        return f"0.{'1':0>{4 - len(tens[1])}} {'um' if tens[2] == 'nm' else 'mm'}"
    part = _PART.fullmatch(word)
    of_part, _, base = ((UNITS.get(part[4]) if part else "") or "").rpartition(" ")
    if part is None or base not in ("um", "mm", "inch", "m", "degC"):
        return UNITS.get(word)
    zeros = part[1].count("0") if part[1] else int(part[2] or 0) or len(re.split("[.,]", part[3])[1])
    zeros += len(of_part[2:])  # a mil is 0.001 inch
    return f"0.{'1':0>{zeros}} {base}"


def split_header(text: str) -> tuple[str, str | None]:
    """'Abw. [µm]' -> ('Abw.', 'um'); 'pos_mm' -> ('pos', 'mm'); a header without a unit unchanged."""
    text = in_words(" ".join(str(text).split()))
    for bracket in reversed(list(_BRACKET.finditer(text))):
        if (unit := unit_of(bracket.group(1) or bracket.group(2))) is not None:
            rest = " ".join((text[: bracket.start()] + " " + text[bracket.end() :]).split()).rstrip(" /") or text
            return rest, _of_a_temperature(unit, rest)
    after = None if _INLET.search(text) else _AFTER.match(text)
    word = after.group(2) if after else ""
    if after and (unit := unit_of(word)) is not None and (len(word) > 1 or word in _SIGNS):
        rest = after.group(1).rstrip(" _/,")
        return rest, _of_a_temperature(unit, rest)
    metres = re.fullmatch(r"(.*\S)(?:\s*/\s*|,\s+|\s+in\s+)m", text)
    if metres and kind_by_name(metres[1]) in ("command", "position", "actual"):
        return metres[1], "m"  # a quantity over its unit; `Error/m` may be an error per metre
    remark = re.fullmatch(r"(.*[^\s(])\s*(\([^()]*\))", text)
    if remark and (before := split_header(remark[1]))[1] is not None:  # `Temp, °F (LBL: spindle)`
        return f"{before[0]} {remark[2]}", before[1]
    letter = _LAST_LETTER.match(text)
    kinds = {kind_by_name(text), kind_by_name(letter.group(1))} if letter else set()
    if letter and LETTERS[letter.group(2)][0] in kinds:
        return letter.group(1), LETTERS[letter.group(2)][1]
    return text, None


def _of_a_temperature(unit: str, header: str) -> str:
    """degC for degrees of a temperature: `Temp °`; any other unit unchanged."""
    return "degC" if unit == "deg" and kind_by_name(header) == "temperature" else unit


# Units of readings unknown to the manifest -> its unit, and the factor.
PLAIN_UNITS = {
    **{"inch": ("mm", 25.4), "m": ("mm", 1000.0), "cm": ("mm", 10.0), "microinch": ("um", 0.0254)},
    **{"deg": ("arcsec", 3600.0), "mdeg": ("arcsec", 3.6), "arcmin": ("arcsec", 60.0), "rad": ("mrad", 1000.0)},
}

# Units unknown to the manifest -> its unit, and the factor (exact by definition,
# NIST SP 811; pressures to 7 digits).
_OTHER_BY_UNIT = {
    "N": {"dan": 10.0, "kgf": 9.80665, "kp": 9.80665, "lbf": 4.4482216152605, "ozf": 0.27801385095378125},
    "kg": {"lbs": 0.45359237, "lb": 0.45359237},
    "N m": {"mnm": 1e-3, **dict.fromkeys(("lbfft", "ftlbf"), 1.3558179483314004)}
    | dict.fromkeys(("lbfin", "inlbf"), 0.1129848290276167),
    "hPa": {"mmhg": 1.333224, "torr": 1.333224, "inhg": 33.86389, "psi": 68.94757, "atm": 1013.25},
    "1/s": {"hz": 1.0, "rps": 1.0, "u/s": 1.0, "rev/s": 1.0},
    "rpm": {"krpm": 1000.0, "rad/s spindle": 30.0 / np.pi},
    "deg/s": {"rad/s": 180.0 / np.pi},
    "mm/s": {"cm/s": 10.0, "in/s": 25.4, "inch/s": 25.4, "um/s": 1e-3},
    "mm/min": {"in/min": 25.4, "inch/min": 25.4, "ipm": 25.4, "cm/min": 10.0},
    "m/s2": {"g": 9.80665, "cm/s2": 1e-2, "in/s2": 0.0254},
    "deg/s2": {"rad/s2": 180.0 / np.pi},
    "mm": {"cm": 10.0, "inch": 25.4, "in": 25.4},
    "m": {"ft": 0.3048},
}
OTHER_UNITS = {name: (of, factor) for of, names in _OTHER_BY_UNIT.items() for name, factor in names.items()}
_UNIT_IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]{1,14}?)\s*[\])]")

_OF_A_SENSOR = ("v", "mv", "volt", "volts")  # before scaling


def in_brackets(header: str) -> str | None:
    """The text in brackets in a header, unit or not."""
    bracket = _UNIT_IN_BRACKETS.search(header)
    return bracket.group(1) if bracket and not bracket.group(1).isdigit() else None  # `speed (5)`: of channel 5


def in_role(
    values: np.ndarray, header: str, unit: str | None, role: str, why: str
) -> tuple[np.ndarray, str | None, str] | None:
    """Values in a unit of a role, that unit (None: the file states none), and the reason with the conversion.

    None if the file states a unit of another quantity, such as a torque in %.
    """
    allowed, spelling = ROLE_UNITS[role], unit or in_brackets(header)
    if spelling is None or not allowed:
        return values, None, why
    word = _one_spelling(spelling)
    own = next((u for u in allowed if _one_spelling(u) == word), None)
    if own is not None:
        return values, own, why
    for key in (f"{word} {role.partition('_')[0]}", word):
        of, factor = OTHER_UNITS.get(key, ("", 1.0))
        if of in allowed:
            return values * factor, of, f"{why}; {spelling} converted to {of}".strip("; ")
        if of == "m" and "mm" in allowed:
            return values * factor * 1e3, "mm", f"{why}; {spelling} converted to mm"
        if of == "mm" and "m" in allowed:
            return values * factor * 1e-3, "m", f"{why}; {spelling} converted to m"
    if unit is None and word not in (*OTHER_UNITS, *_OF_A_SENSOR) and not re.search(r"[/%°\d]", spelling):
        return values, None, why  # a word in brackets: `force (filtered)`
    return None


def _one_spelling(unit: str) -> str:
    """A unit without blanks, dots, power signs and case: `N·cm` and `Ncm` are equal, `mm/s²` is mm/s2."""
    return re.sub(
        r"[\s·*.^-]", "", unit.lower().replace("µ", "u").replace("μ", "u").replace("²", "2").replace('"', "in")
    )


def plain_unit(
    values: np.ndarray, unit: str | None, why: str, allowed: tuple[str, ...] = ()
) -> tuple[np.ndarray, str | None, str]:
    """Values in a unit of the manifest, that unit, and the reason with the conversion."""
    part, _, of = (unit or "").partition(" ")
    if unit in allowed or not (unit in PLAIN_UNITS or (part.startswith("0.") and of)):
        return values, unit, why
    plain, factor = PLAIN_UNITS.get(of or unit or "", (of, 1.0))
    factor *= float(part) if of else 1.0
    return values * factor, plain, f"{why}; {unit} converted to {plain}"
