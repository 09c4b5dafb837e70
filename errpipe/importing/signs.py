"""The sign of readings: actual minus commanded, from an option, both positions, a header or a line of the file.

A header that states a difference, an offset or a gap of unknown sign causes a question: a wrong sign doubles
the error of the machine.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import filterfalse

import numpy as np

from errpipe.domain import components
from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing import order, words
from errpipe.importing.layout import Layout
from errpipe.importing.proposed import ImportOptions, Proposal
from errpipe.importing.units import split_header

SHOWN = 0.9  # correlation with actual - commanded: as `reversed-sign` of the plausibility checks
ASSUMED = "the file does not state its sign: taken as actual minus commanded (to change it: --sign)"
# A line above a table whose readings are corrections: `Korrekturwerte in um`, not `Compensation: off`.
_TITLE_OF_CORRECTIONS = re.compile(
    r"(korrekturwerte|korrekturtabelle|(correction|compensation|comp\.?) (values?|table|data))\b[^:=;]*$"
)
_OF_CORRECTIONS = re.compile(
    r"(?:values?|werte?|table|data|to (?:apply|enter|be \w+)|valore|valeur|valor|d[aei]|del?|of|in|[値值量表数]|\W|\d)+"
)
# Quantities that may have either sign: a value entered in a control, the gap between a sensor and its target, or
# the error of indication of the machine (indicated minus true).
_EITHER_WAY = re.compile(
    r"\b(offset|trim|gap|spalt|luftspalt|abstand|distance|stellwert|einstellwert|nachstellwert|eingabewert|to enter"
    r"|undershoot|short|zu kurz|trop court|anzeige(fehler|abweichung)|(indication|readout|display|dro|encoder|scale)s?"
    r"[ -]?(err(or)?s?|dev\w*|fehler|abw\w*)"
    r"|(err(or)?|dev|fehler) (of (the )?)?(indication|readout|display|dro|encoder|scale))\b"
    r"|[x×*·] ?\(?-1|-1\)? ?[x×*·]|(?<![\w-])[a-z]-[a-z](?![\w-])"
)
_DIFFERENCE = re.compile(
    r"\b([^\W\d_]\w*)\.?(?: - | (?:minus|less|moins|meno|menos) )(?:the )?([^\W\d_]\w*)|\b([a-z])[a-z]-\3[a-z]\b"
)
_OPPOSITE = re.compile(
    r"^-\s*[^\W\d]|\b(neg(ative|ated|iert\w*)?|minus|invers\w*|invert\w*|revers(ed|iert\w*)|umgekehrt\w*)\b"
)
_ON_THE_SIGN = re.compile(
    r"\bvorzeichen|\bpositive? (error|deviation|value|reading)s?\b|\bpositive[rs]? (fehler|abweichung|wert)|符号"
    r"|\bsigns?\b(?![ -]?off)|\b(?:signe|segno|znak|isareti?)\b"
    r"|^[^\W\d]+ ?= ?[^\W\d]+ - [^\W\d]+$"
    r"|\b(?:corrections?|compensations?) (?:to be|to) \w+|\bare (?:the )?(?:corrections?|compensation)\b"
    r"|\b(?:invers\w*|invert\w*|negated|flipped|umgekehrt\w*) (?:error|dev|value|reading|fehler|abw|wert)"
    r"|\b(?:anzeige|messuhr|dial|gauge|laser|readings?|display)\b[^|]*\b(?:invers\w*|invert\w*|revers\w*|negativ\w*|umgekehrt\w*)"
    r"|\b(?:against|opposite(?: to)?|gegen|entgegen|contre|contro)\b[^|]*\b(?:axis|motion|travel|achs\w*|bewegung\w*"
    r"|verfahr\w*|axe|asse|moto)\b"
    r"|\b(?:multiplied by|times|mal) ?\(?-"
    r"|\b(too|zu|trop|troppo|demasiado) (far|long|short|weit|kurz|lang|loin|court|corto|lungo|largo)\b"
    r"|\b(stops?|falls?|stays?|bleibt) (short|zurueck)\b"
)
_READINGS = re.compile(
    r"\b(?:values?|readings?|(?:mess)?werte|valeurs|valor[ei]s?|wartosci|degerler|hodnoty|значения)\b|[数數][値值]"
)
_DEFINITION = re.compile(  # of what stands before it: `= A - B`, `: A minus B`, `: difference between A and B`
    rf"=[^=:]*\w ?(?:-(?!dire[ck]|axis|achse)|{words.MINUS_WORD}) ?[^\W\d]"
    rf"|[=:][^=:]*(?: {words.MINUS_WORD} [^\W\d]|\bsubtracted from\b"
    r"|\bdif+eren\w* (?:between|zwischen|entre|tra|fra)\b)"
)
# Settings of a control or a laser: `Compensation: none`, `Correction = 0`.
_A_SETTING = re.compile(
    r"\b(not?(?!:)|none|keine?r?|yes|ja|nein|(?:in|de|un)?a[ck]ti(?:v|ef)\w*|(?:en|dis)abled|applied)\b"
    r"|[:=] ?[+-]?\d"
)
# Means as an API laser prints them for a control (`.pos`). A public reader takes minus them as the deviation, while
# it takes Renishaw's as they are; no maker's page on their sign was found.
_MEANS_FOR_A_CONTROL = re.compile(r"\b(?:uni|bi|forward |reverse )directional avg error\b")
_SIGN_MEANS = re.compile(  # `+ = the axis stops early`, `Pluswerte bedeuten ...`, not `+ = from below`
    r"(?:^|[\s(*;,:])(?:[+-]|plus\w*|minus\w*|positiv\w*|negativ\w*)"
    r"(?: (?:values?|werte?|sign|numbers?|readings?|errors?))?"
    r" ?(?:=|:|means?\b|bedeute[tn]\b|heisst\b|indicates?\b|signifie\b|significa\b) ?(.*)"
)
_A_WAY = re.compile(
    r"approach|anfahr|direction|richtung|\b(from|von) (below|above|unten|oben)|forward|reverse|backward|vorwaerts"
    r"|rueckwaerts|\b(up|down|auf|ab|cw|ccw)\b"
)


def ignore_corrections(p: Proposal) -> None:
    """Ignore a column of corrections if there is one of deviations, and a following error if both positions exist."""
    errors = [n for n, e in p.entries.items() if e["role"] == "error"]
    for name in [n for n in errors if any(map(words.is_following_error, p.entries[n].get("_headers", (n,))))]:
        letter = p.entries[name].get("_axis")
        if p.first("command", letter) and (p.first("actual", letter) or p.first("position", letter)):
            p.entries[name] = {"role": "ignore"}
            p.guesses[name] = "a following error with both positions: the error is derived from them"
            errors.remove(name)
    corrections = [n for n in errors if any(map(words.is_correction, p.entries[n].get("_headers", (n,))))]
    for name in corrections if len(corrections) < len(errors) else []:
        p.entries[name] = {"role": "ignore"}
        p.guesses[name] = "corrections in addition to deviations: only the deviations are used"


_INSTRUMENT = re.compile(r"laser|interferom|gauge|dial|probe|dev|abw|measured|gemessen")
_SWITCHED_ON = re.compile(
    r"\b(?:comp\w*|korrektur\w*|kompensation\w*|correction\w*)\W+(?:was |is |ist |war )?"
    r"(?:on|active|aktiv|enabled|ein|an)\b|\b(?:with|mit|after|nach) (?:\w+ )?(?:comp\w*|korrektur|kompensation)\b"
)
_OF_THE_AIR = re.compile(
    r"temp|air|luft|environment|umgebung|material|wavelength|wellenlaenge|dead ?path|20 ?°|expan|ausdehn"
    r"|therm|refract|ppm|factor|faktor"
)


def compensated(above: list[str]) -> list[str]:
    """A note if a line above states that the control's compensation was active; not that of a laser for air."""
    lines = [x for x in above if _SWITCHED_ON.search(words.plain(x)) and not _OF_THE_AIR.search(words.plain(x))]
    return [
        f"a line states {x[:60]!r}: these are residual deviations with compensation, and a new table is added to it"
        for x in lines[:1]
    ]


def convert_errors(p: Proposal, layout: Layout, options: ImportOptions) -> None:
    """Convert every error column to actual minus commanded. Raises DataError if a stated sign is unknown.

    Priority: option, both positions, the column's header, the lines around the table.
    """
    for name in [n for n, e in p.entries.items() if e["role"] == "error" and "derived" not in e]:
        turned, reason = _stated(p, name, options) or _stated_in_file(p, name, layout)
        if reason:
            p.guesses[name] = f"{p.guesses.get(name, '')}; {reason}".strip("; ")
        if turned:
            entry = p.entries[name]
            raw = p.put(f"{name}_as_written", p.data.pop(name), role="ignore")
            p.entries[name] = {**entry, "derived": {"of": raw, "factor": -1.0}}


def _titles_corrections(line: str) -> bool:
    """Whether a line above a table states that its readings are corrections: `Korrekturwerte`, `Correction [mm]`.

    Without a unit it may refer to a compensation: `Compensation`.
    """
    if _TITLE_OF_CORRECTIONS.match(words.plain(line)) is not None:
        return True
    text, unit = split_header(line)
    rest = re.sub(words.CORRECTION, " ", words.plain(text))
    return unit is not None and words.is_correction(text) and _OF_CORRECTIONS.fullmatch(f" {rest} ") is not None


def _may_title_corrections(line: str) -> bool:
    """Whether a line above readings with uninformative headers may do so: `Correction`, `Type: following error`."""
    stated = re.split("[:=：]", line)[-1]
    of_a_control = words.is_correction(stated) or words.is_following_error(stated)
    text = words.plain(line)
    return of_a_control and not _A_SETTING.search(text) and not _OF_THE_AIR.search(text)


def _stated(p: Proposal, name: str, options: ImportOptions) -> tuple[bool, str] | None:
    """Whether the option or the recorded positions reverse a sign, with the reason; None: neither states it."""
    if options.sign is not None:
        return options.sign == "commanded-minus-actual", ""
    component = p.entries[name]["component"]
    for axis in {e["axis"] for e in p.entries.values() if e.get("axis")}:
        command, actual = p.first("command", axis), p.first("actual", axis) or p.first("position", axis)
        if component != components.positioning(axis) or command not in p.data or actual not in p.data:
            continue
        x, y = p.canonical(actual) - p.canonical(command), p.data[name]
        good = np.isfinite(x) & np.isfinite(y)
        if good.sum() < 4 or min(np.ptp(x[good]), np.ptp(y[good])) == 0:
            continue
        r = float(np.corrcoef(x[good], y[good])[0, 1])
        if abs(r) > SHOWN:
            says = f"{actual} - {command} (correlation {r:.2f})"
            return r < 0, f"it is minus {says}: the sign is changed" if r < 0 else f"its sign is that of {says}"
    return None


def _stated_in_file(p: Proposal, name: str, layout: Layout) -> tuple[bool, str]:
    """Whether the file's statements reverse a sign, with the reason."""
    headers = p.entries[name].get("_headers", (name,))
    if any(map(words.is_correction, headers)) or any(map(_titles_corrections, layout.above)):
        return True, "a correction is minus the deviation: the sign is changed"
    if any(map(words.is_following_error, headers)):
        return True, "a following error is commanded minus actual: the sign is changed"
    lines = [*layout.above, *layout.below]
    stated = words.difference(" | ".join(headers)) or words.difference(
        " | ".join([name, *(c.header for c in layout.columns), *filterfalse(_only_names_both, lines)])
    )
    if stated is not None and stated[0] == 0:
        raise DataError(
            f"{stated[1]!r}: is the reference the set point, or an instrument that shows where the axis is? Say --sign "
            "actual-minus-commanded (the readings rise where the axis goes too far), or --sign commanded-minus-actual"
        )
    if stated is not None:
        return stated[0] < 0, f"the file states {stated[1]!r}" + (": the sign is changed" if stated[0] < 0 else "")
    if components.parse(p.entries[name]["component"]).kind == "force":
        return False, "a load of the drive: its sign is taken as recorded"
    _ask(headers, layout, p.guesses.get(name, ""))
    if order.is_log(p) and not any(map(_INSTRUMENT.search, map(words.plain, headers))):
        raise DataError(
            f"{headers[0]!r} is logged with a moving axis: controls then show commanded minus actual, instruments "
            "actual minus commanded. Declare it: --sign commanded-minus-actual, or --sign actual-minus-commanded"
        )
    return False, ASSUMED


def _only_names_both(line: str) -> bool:
    """Whether a line reads `commanded - measured` beside other words, without `=`, `:` or brackets: `Nominal - laser`.

    The dash may then separate two parts of a title.
    """
    text, _ = split_header(line)
    stated = words.difference(text)
    if stated is None or stated[0] >= 0 or re.search(words.MINUS_WORD, stated[1]):
        return False
    before, _, behind = words.plain(text).partition(stated[1])
    return not re.search(r"[=:(\[]", before) and re.search(r"\w", re.sub(r"\bin$", "", before + behind)) is not None


def _doubtful(header: str, why: str) -> bool:
    """Whether a header may mean that its readings have the opposite sign. why: the reason for its role `error`."""
    text = words.plain(header)
    less = _DIFFERENCE.search(text)
    names = [w for w in less.groups()[:2] if w] if less else []
    plain = any(words.kind_by_name(w) in ("error", "run") or guessing.side(w) is not None for w in names)
    either = (
        _EITHER_WAY.search(text) or words.names_command_and_actual(header) or words.is_error_of_a_correction(header)
    )
    if either or (less and not plain):
        return True
    if why.startswith("error by its unit") and (words.kind_by_name(header) == "command" or words.unknown_word(header)):
        return True
    return why.startswith("error by its") and _OPPOSITE.search(text) is not None  # a run among others may have a side


def _is_on_the_sign(text: str) -> bool:
    """Whether a line around the table states the sign of readings; one on the approach states a side."""
    means = _SIGN_MEANS.search(text)
    stated = means is not None and bool(re.search(r"[^\W\d]{3}", means[1])) and not _A_WAY.search(means[1])
    defined = _DEFINITION.search(text)
    what = text[: defined.start()].rpartition(":")[2].strip() if defined else ""
    corrections = _READINGS.search(text) and words.is_correction(text) and not _A_SETTING.search(text)
    if corrections and not _OF_THE_AIR.search(text):
        return True
    return stated or what == "e" or words.kind_by_name(what) == "error" or _ON_THE_SIGN.search(text) is not None


def _is_sign_statement(line: str) -> bool:
    return _only_names_both(line) or _is_on_the_sign(words.plain(line))


def _ask(headers: tuple[str, ...], layout: Layout, why: str) -> None:
    """Raise DataError for a header, or a line on the sign, with an unknown statement of the sign."""
    for header in headers:
        if _doubtful(header, why):
            raise DataError(
                f"column {header!r}: does it rise if the axis (the tool) moves too far, or fall? Declare it: --sign "
                "actual-minus-commanded, or --sign commanded-minus-actual"
            )
    around = [*headers, *(c.header for c in layout.columns), *layout.above, *layout.below]
    means = next((x for x in around if _MEANS_FOR_A_CONTROL.search(words.plain(x))), None)
    if means is not None:
        raise DataError(
            f"{means[:60]!r}: means of a laser for a control, which may be deviations or what the control is to add. "
            "Say --sign actual-minus-commanded (positive: the axis moves too far), or --sign commanded-minus-actual"
        )
    line = next((x for x in layout.below if _titles_corrections(x)), None)
    line = line or next(filter(_is_sign_statement, [*layout.above, *layout.below]), None)
    if line is not None:
        raise DataError(
            f"a line states the sign as {line[:60]!r}, which is unknown: declare it with --sign "
            "actual-minus-commanded (positive: the axis moves too far), or --sign commanded-minus-actual"
        )
    title = next(filter(_may_title_corrections, layout.above), None)
    if title is not None and not any(words.kind_by_name(header) == "error" for header in headers):
        raise DataError(
            f"a line, sheet or file states {title[:60]!r}: are the readings deviations, positive if the axis moves too "
            "far (--sign actual-minus-commanded), or the opposite (--sign commanded-minus-actual)?"
        )


_SIGNED = re.compile(r"\bsigns?\b", re.IGNORECASE)
_READINGS_OR_SIGNS = re.compile(
    r"\b(?:err(?:or)?s?|dev\w*|readings?|values?|convention|positive|negative|plus|minus|correct\w*|opposite|revers\w*)\b"
    r"|\bsigns?\b ?[:=]|(?<!\w)[+-](?!\w)"
)


def states_a_sign(line: str) -> bool:
    """Whether a text beside a table, a README or a comment of a cell, states the sign of its readings."""
    if _SIGNED.search(line) and not _READINGS_OR_SIGNS.search(words.plain(line)):
        return False  # `please sign in`
    return words.difference(line) is not None or _titles_corrections(line) or _is_sign_statement(line)


def refuse_beside(p: Proposal, lines: Iterable[str], of: object) -> None:
    """Raise DataError if a text beside the table states a sign that the table does not: a README, a sheet of notes."""
    for line in lines if any(ASSUMED in why for why in p.guesses.values()) else ():
        stated = words.difference(line)
        if states_a_sign(line) and (stated is None or stated[0] <= 0):
            raise DataError(
                f"{of} states {line.strip()[:60]!r}, and the table no sign: declare it with --sign "
                "actual-minus-commanded (positive: the axis moves too far), or --sign commanded-minus-actual"
            )
