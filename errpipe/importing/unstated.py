"""Units missing in a file that only the user can state: inches, metres, degF, ms, rad."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np

from errpipe.errors import DataError
from errpipe.importing import order, readings
from errpipe.importing.layout import Layout
from errpipe.importing.proposed import Proposal
from errpipe.importing.temperatures import START
from errpipe.importing.units import split_header

FEWEST_APART = (
    2  # temperatures of a file: a single one may be of a warm part in one run and of a cold one in the others
)
COLDEST_K = 200.0  # K: below any machine
LONGEST_STEP = 0.5  # s: longer steps are rare in a log of a moving axis; in ms they are usual
PLACES = ("command", "position", "actual")


def _refuse_warm_without_a_unit(p: Proposal) -> None:
    """Raise DataError if temperatures without a unit are all above those of a shop and a cold machine in degC."""
    temperatures = [n for n, e in p.entries.items() if e["role"] == "temperature" and np.isfinite(p.data[n]).any()]
    unstated = [n for n in temperatures if "no unit is stated" in p.guesses.get(n, "")]
    if unstated and len(unstated) == len(temperatures) and min(np.nanmin(p.data[n]) for n in unstated) > START[1]:
        sets = " ".join(f"--set {n}.unit=degF" for n in unstated)
        raise DataError(
            f"no unit is stated for {', '.join(unstated)}, and no reading is below {START[1]:g}: degF, or degC of a "
            f"warm machine? Declare it with {sets} (or degC)"
        )


_OTHER_SCALE = {
    "degC": (lambda v: (v - 32.0) / 1.8, "degF", "above"),
    "degF": (lambda v: 1.8 * v + 32.0, "degC", "below"),
}


def refuse_another_scale(parts: Mapping[str, Proposal], stated: Iterable[str]) -> None:
    """Raise DataError if all temperatures of one file lie apart from the other files, and would not on the other scale.

    parts: by the name of the file; stated: columns whose unit the user gave.
    """
    ranges: dict[str, dict[tuple[str, str], tuple[float, float]]] = {}
    for file, part in parts.items():
        of_heat = [n for n, e in part.entries.items() if e["role"] == "temperature" and n not in stated]
        known = [n for n in of_heat if np.isfinite(part.data[n]).any()]
        ranges[file] = {
            (n, part.entries[n].get("unit", "")): (np.nanmin(part.data[n]), np.nanmax(part.data[n])) for n in known
        }
    for file, own in ranges.items():
        around = {}
        for key in own:
            others = [r[key] for other, r in ranges.items() if other != file and key in r]
            around[key] = (min(low for low, _ in others), max(high for _, high in others)) if others else None
        if len(own) < FEWEST_APART or None in around.values():
            continue
        if all(_of_another_scale(key[1], own[key], around[key]) for key in own):
            _, unit, where = _OTHER_SCALE[next(iter(own))[1]]
            (name, scale), (low, high) = next(iter(own.items()))
            raise DataError(
                f"{file}: all temperatures are {where} those of the other files ({name}: {low:.4g} to {high:.4g} "
                f"{scale}), and would agree with them in {unit}: correct the unit in the header of this file. If "
                f"{scale} is right: " + " ".join(f"--set {n}.unit={u}" for n, u in own)
            )


def _of_another_scale(unit: str, own: tuple[float, float], others: tuple[float, float] | None) -> bool:
    """Whether a range lies beyond that of the other files, on the side of the other scale, and overlaps it on that."""
    if others is None or unit not in _OTHER_SCALE:
        return False
    convert, _, where = _OTHER_SCALE[unit]
    apart = own[0] > others[1] if where == "above" else own[1] < others[0]
    return apart and convert(own[0]) <= others[1] and convert(own[1]) >= others[0]


def _refuse_radians(p: Proposal) -> None:
    """Raise DataError if angles without a unit stay within a turn in rad, and are not multiples of half a degree."""
    unstated = [n for n, e in p.entries.items() if e["role"] in PLACES and e.get("unit") == "deg" and n in p.data]
    for name in [n for n in unstated if "no unit is stated" in p.guesses.get(n, "")]:
        angles = p.data[name][np.isfinite(p.data[name])]
        if np.max(np.abs(angles), initial=0.0) <= 2.0 * np.pi + 0.01 and np.any(2.0 * angles % 1.0):
            raise DataError(
                f"no unit is stated for {name!r}, which stays within {np.max(np.abs(angles)):.3g}: rad, or deg? "
                f"Declare it with --set {name}.unit=rad (or deg)"
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
