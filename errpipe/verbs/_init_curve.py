"""Which curve of an axis `init` writes: a polynomial, or the measured points where these leave clearly less."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from errpipe.cleaning import clean
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.verbs import _init_heat

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

CLEARLY_LESS = 0.9  # of the held-out rms of the polynomial, by judgement: it also smooths, and measured points do not
_POLYNOMIAL = re.compile(r"\{term: (offset|chebyshev|backlash)\b")
_OTHERWISE = re.compile(r"^ +# (instead of the three|terms: \[\{term: measured_points)")


def proposed(text: str, recording: Recording | None) -> tuple[str, list[str]]:
    """A pipeline with a polynomial and a reversal, or with measured points in their place, and why in one sentence.

    The points must leave clearly less in all, and less in every one, of the runs that are held out.
    """
    found = re.search(r"\{term: chebyshev, axis: ([^,}]+)", text)
    if found is None or recording is None:
        return text, []
    points = _with_points(text, f"{{term: measured_points, axis: {found[1]}}}")
    try:
        cleaned = clean(recording)[0]
    except DataError:
        return text, []
    if (scheme := _init_heat.scheme_of(cleaned)) is None:
        return text, []
    of_polynomial, of_points = (
        _init_heat.held_out_residuals(cleaned, scheme, _init_heat.family_of(_without_heat(way))) for way in (text, points)
    )
    if of_polynomial is None or of_points is None:
        return text, []
    before, after = _init_heat.rms(of_polynomial), _init_heat.rms(of_points)
    less = (p.rms(p.after) < c.rms(c.after) for p, c in zip(of_points, of_polynomial, strict=True))
    if after > CLEARLY_LESS * before or not all(less):
        return text, []
    what = holdout.name(scheme)
    why = f"measured points: {what} leaves {after:.3g} um with them, {before:.3g} um with a polynomial"
    return points.replace("@WHY@", why), [why]


def _with_points(text: str, term: str) -> str:
    lines, first = list[str](), True
    for line in text.splitlines():
        if _POLYNOMIAL.search(line):
            lines += [f"{line[: line.index('{')]}{term}   # @WHY@"] if first else []
            first = False
        elif not _OTHERWISE.match(line):
            lines.append(line)
    return "\n".join([*lines, ""])


def _without_heat(text: str) -> str:
    return "\n".join(line for line in text.splitlines() if _init_heat.WARM not in line and _init_heat.HEAT not in line)
