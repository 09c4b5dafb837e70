"""The owner of a column: X1 beside X2, or none that is imported: a spindle's `S` next to X and Y, an excluded motor."""

from __future__ import annotations

import re
from dataclasses import replace

from errpipe.importing.columns import PLACE, Guesses
from errpipe.importing.layout import RawColumn

OF_AN_AXIS = ("command", "position", "actual", "velocity", "acceleration", "current", "force", "torque")
_CHANNEL = re.compile(r"([A-Z])\d?(?:[ _.:]|(?=[A-Z][a-z]))(.*)")
_AXES = "XYZABCUVW"
_NUMBERED = re.compile(r"(.*?)[ _.]?[(\[]?(\d+)[)\]]?")


def of_axes(columns: list[RawColumn], guesses: Guesses, axis: str | None) -> Guesses:
    """The guesses with the axis of each column. axis: as an option names it."""
    return _with_first_axis(drop_other_channels(columns, guesses), axis)


def drop_other_channels(columns: list[RawColumn], guesses: Guesses) -> Guesses:
    """The guesses without columns of a channel that is not an axis, if channels of axes have a column of the same name.

    Otherwise `S1_ActualVelocity` next to `X1_ActualVelocity` would be a velocity of the axis that the file names first.
    """
    parts = {c.header: match.groups() for c in columns if (match := _CHANNEL.fullmatch(c.header))}
    of_axes = {rest for letter, rest in parts.values() if letter in _AXES}
    others = {letter for letter, rest in parts.values() if letter not in _AXES and rest in of_axes}
    out = dict(guesses)
    for header, (letter, _) in parts.items():
        g = guesses[header]
        if letter in others and g.why and g.axis is None and g.kind in OF_AN_AXIS:
            out[header] = replace(g, kind="ignore", why=f"of {letter}, which is not an axis of ISO 841")
    return {**out, **_left_out(guesses)}


def _with_first_axis(guesses: Guesses, axis: str | None) -> Guesses:
    """The guesses with `X1` as an axis of that name if an option names it, or positions of X2 are recorded, too.

    Otherwise a control numbers its only X, and the axis is X.
    """
    out = dict(guesses)
    numbered = {g.axis[0] for g in guesses.values() if g.axis and g.axis[1:] and g.kind in PLACE}
    for header, g in guesses.items():
        if g.axis and (axis == f"{g.axis}1" or (g.axis in numbered and _first(header, g.axis))):
            out[header] = replace(g, axis=f"{g.axis}1")
    return out


def _first(header: str, letter: str) -> bool:
    return re.search(rf"(?<![A-Za-z]){letter}1(?!\d)", header, re.IGNORECASE) is not None


def _left_out(guesses: Guesses) -> Guesses:
    """Columns of a numbered channel whose positions the user excluded, as ignored: `speed (3)` with `pos (3)`."""
    numbers = {h: match.groups() for h in guesses if (match := _NUMBERED.fullmatch(h))}
    places = ("command", "position", "actual")
    of_places = {base for h, (base, _) in numbers.items() if guesses[h].kind in places}
    kept = {n for h, (_, n) in numbers.items() if guesses[h].kind in places}
    stated = {n for h, (base, n) in numbers.items() if base in of_places and guesses[h].kind == "ignore"}
    return {
        h: replace(guesses[h], kind="ignore", why=f"of channel {n}, whose positions are excluded")
        for h, (_, n) in numbers.items()
        if n in stated - kept and guesses[h].why and guesses[h].kind in OF_AN_AXIS
    }
