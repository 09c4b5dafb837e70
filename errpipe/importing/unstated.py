"""Units missing in a file that only the user can state: inches, metres, degF, ms, rad."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from errpipe.errors import DataError
from errpipe.importing import order, readings
from errpipe.importing.layout import Layout
from errpipe.importing.proposed import ImportOptions, Proposal, slug
from errpipe.importing.temperatures import START
from errpipe.importing.units import split_header
from errpipe.importing.words import plain

FEWEST_APART = 2  # temperatures of a file: a single one may be of a part that was warm in one run alone
COLDEST_K = 200.0  # K: below any machine
LONGEST_STEP = 0.5  # s, by judgement: longer steps are rare in a log of a moving axis; in ms they are usual
PLACES = ("command", "position", "actual")


_SCALE = re.compile(  # of a gauge: `1 div = 0.001 mm`
    r"\b(?:1 ?|one |ein )?(?:div(?:isions?)?|teilstrich\w*|teilung|skt|graduations?|counts?|inkremente?|digits?|lsb)\b"
    r"\.? ?[=:] ?(\d*[.,]?\d+ ?(?:mm|um|µm|μm|nm|inch|in)\b)",
    re.IGNORECASE,
)


def refuse_a_scale(p: Proposal, above: Iterable[str]) -> None:
    """Raise DataError if a line states the scale of a gauge, and readings are in divisions, or state no unit."""
    scale = next((m[1].replace(",", ".") for line in above if (m := _SCALE.search(line))), None)
    if scale is None:
        return
    errors = [n for n, e in p.entries.items() if e["role"] == "error"]
    guessed = next((n for n in errors if "no unit is stated" in p.guesses.get(n, "")), None)
    if guessed is not None:
        raise DataError(f"{guessed!r} states no unit, and a line above a division of {scale}: --unit '{scale}', or um?")
    counts = next((n for n, e in p.entries.items() if "counts need --resolution" in p.guesses.get(n, "")), None)
    if counts is not None and not errors:
        raise DataError(
            f"{counts!r} is in divisions, of {scale} by a line above: deviations (--set {counts}.role=error "
            f"--set '{counts}.unit={scale}'), or positions (--resolution, in mm or deg of one)?"
        )


_ENLARGED = re.compile(r"(?<![^\W_])[x×*]\s?10+(?![\d.,^]|\s?(?:[uµμ]?m|in)\b)|\b10+\s?(?:[x×]|:\s?1)(?![^\W_])")
_OF_SEVERAL = re.compile(
    r"\b(mean|avg|average\w*|mittel\w*|median|repeat\w*|wiederhol\w*|readings|messungen|moyenne|media)\b"
)


def refuse_enlarged(header: str, options: ImportOptions) -> None:
    """Raise DataError for readings that a header says are multiplied: `Deviation x100 (um)`, as drawn in a plot."""
    stated = options.unit or any("unit" in options.sets.get(name, {}) for name in (header, slug(header)))
    factor = None if stated or _OF_SEVERAL.search(plain(header)) else _ENLARGED.search(header)
    if factor is not None:
        times = max(map(int, re.findall(r"\d+", factor.group())))
        raise DataError(
            f"column {header!r}: are its readings multiplied ({factor.group().strip()})? Write them as they are, or "
            f"say what one is worth: --set '{header}.unit={1 / times:g} um' for um times {times}"
        )


def _of_heat(p: Proposal) -> list[str]:
    return [n for n, e in p.entries.items() if e["role"] == "temperature" and np.isfinite(p.data[n]).any()]


def _refuse_warm_without_a_unit(p: Proposal) -> None:
    """Raise DataError if temperatures without a unit are all above those of a shop and a cold machine in degC."""
    temperatures = _of_heat(p)
    unstated = [n for n in temperatures if "no unit is stated" in p.guesses.get(n, "")]
    if unstated and len(unstated) == len(temperatures) and min(np.nanmin(p.data[n]) for n in unstated) > START[1]:
        sets = " ".join(f"--set {n}.unit=degF" for n in unstated)
        raise DataError(
            f"no unit is stated for {', '.join(unstated)}, and no reading is below {START[1]:g}: degF, or degC of a "
            f"warm machine? Declare it with {sets} (or degC)"
        )


def refuse_another_scale(parts: Mapping[str, Proposal], stated: Iterable[str]) -> None:
    """Raise DataError if all temperatures of one file lie beyond those of the others, and within on the other scale.

    parts: by the name of the file; stated: columns whose unit the user gave.
    """
    rows = [(f, n, p.entries[n].get("unit"), p.data[n]) for f, p in parts.items() for n in _of_heat(p)]
    known = [(f, n, u, np.nanmin(v), np.nanmax(v)) for f, n, u, v in rows if n not in stated]
    for file, unit in dict.fromkeys((k[0], k[2]) for k in known if k[2] in ("degC", "degF")):
        own, agrees = [k for k in known if k[0] == file], []
        for _, name, _, low, high in own:
            around = [k for k in known if k[0] != file and k[1:3] == (name, unit)]
            floor, top = min((k[3] for k in around), default=np.nan), max((k[4] for k in around), default=np.nan)
            apart = low > top if unit == "degC" else high < floor
            low, high = ((v - 32.0) / 1.8 if unit == "degC" else 1.8 * v + 32.0 for v in (low, high))
            agrees.append(apart and low <= top and high >= floor)
        if len(own) >= FEWEST_APART and all(agrees):
            raise DataError(
                f"{file}: all temperatures lie beyond those of the other files ({own[0][1]}: {own[0][3]:.4g} to "
                f"{own[0][4]:.4g} {unit}) and would agree with them in {'degF' if unit == 'degC' else 'degC'}: correct "
                f"the unit in the header of this file. If {unit} is right: "
                + " ".join(f"--set {k[1]}.unit={unit}" for k in own)
            )


def _refuse_radians(p: Proposal) -> None:
    """Raise DataError if angles without a unit stay within a turn in rad, and are not multiples of half a degree."""
    unstated = [n for n, e in p.entries.items() if e["role"] in PLACES and e.get("unit") == "deg" and n in p.data]
    for name in [n for n in unstated if "no unit is stated" in p.guesses.get(n, "")]:
        angles = p.data[name][np.isfinite(p.data[name])]
        if np.max(np.abs(angles), initial=0.0) <= 2.0 * np.pi + 0.01 and np.any(2.0 * angles % 1.0):
            raise DataError(
                f"no unit is stated for {name!r}, which stays within {np.max(np.abs(angles)):.3g}: rad, or deg? "
                f"Declare it with --set {name}.unit=rad (or deg); turns must be written in deg first (times 360)"
            )


def resolve_units(p: Proposal, layout: Layout) -> None:
    """Raise DataError if a length without a unit may be in inches: with others in inches, or with no unit in the file.

    A temperature without a unit is not assumed to be in degC next to another in degF.
    """
    _refuse_warm_without_a_unit(p)
    for n in [n for n, e in p.entries.items() if e["role"] == "temperature" and e.get("unit") == "K"]:
        if np.nanmax(p.data[n], initial=0.0) < COLDEST_K:
            raise DataError(
                f"{n!r} is in K and at most {np.nanmax(p.data[n], initial=0.0):g}: a rise, counted from the "
                f"start? If it may be used as a temperature, use --set {n}.unit=degC, else --set {n}.role=ignore"
            )
    time = p.first("time")
    if time in p.data and "no unit is stated" in p.guesses.get(time, "") and order.is_log(p):
        step = float(np.nanmedian(np.abs(np.diff(p.data[time]))))
        if step > LONGEST_STEP:
            raise DataError(
                f"no unit is stated for {time!r}, and a moving axis is logged every {step:g}: s, or ms? Declare it "
                f"with --set {time}.unit=ms (or s)"
            )
    other_scale = next((n for n, e in p.entries.items() if e.get("unit") == "degF"), None)
    for name in [n for n, e in p.entries.items() if e["role"] == "temperature" and other_scale]:
        if "no unit is stated" in p.guesses.get(name, ""):
            raise DataError(
                f"no unit is stated for {name!r}, and {other_scale!r} is in degF: declare it with "
                f"--set {name}.unit=degC (or degF)"
            )
    _refuse_radians(p)
    stated = {c.unit or "" for c in layout.columns} | {split_header(line)[1] or "" for line in layout.above}
    inches = any(u.endswith("inch") for u in stated)
    metric = any(u.endswith(("um", "mm", "nm")) or u in ("m", "cm", "urad", "arcsec") for u in stated)
    places = [n for n, e in p.entries.items() if e["role"] in PLACES and e.get("unit") == "mm" and n in p.data]
    widest = max((np.ptp(v[np.isfinite(v)]) for n in places if np.isfinite(v := p.data[n]).any()), default=0.0)
    for name, why in p.guesses.items():
        entry = p.entries[name]
        if "no unit is stated" not in why or entry.get("unit") not in ("mm", "um"):
            continue
        written = [h for h, n in p.names.items() if n == name]
        if entry["role"] in PLACES and any(re.search(r"[ _/]m$", text) for text in (name, *written)):
            raise DataError(
                f"no unit is stated for {name!r}: metres, or measured? Declare it with --set {name}.unit=m (or mm)"
            )
        narrow = entry["role"] in PLACES and widest < readings.NARROW  # positions in one file have one unit
        if inches or (narrow and not metric):
            raise DataError(
                f"no unit is stated for {name!r}, and it may be inches: declare it with "
                f"--set {name}.unit={entry['unit']} (or inch, m)"
            )
