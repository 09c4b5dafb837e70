"""Which curve of an axis `init` writes: a polynomial, or the measured points where these leave clearly less."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from errpipe.cleaning import clean
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.verbs import _init_heat

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

CLEARLY_LESS = 0.9  # of the held-out rms of the polynomial, by judgement: it also smooths, and measured points do not
GOLDEN_RATIO = 0.6180339887498949  # its multiples modulo 1 are spread evenly, and near no short cycle
# The line of a template with what else may describe the curve, and the line above it.
_ALTERNATIVE = re.compile(r"(?m)^ +# instead of the three[^\n]*\n +# terms: \[(\{[^}]*\})\]\n")
_TERM = re.compile(r"^ +- \{term: ")


def proposed(text: str, recording: Recording | None) -> tuple[str, list[str]]:
    """A pipeline with a polynomial and a reversal, or with measured points in their place, and why in one sentence.

    The points must leave clearly less in all, and less in every one, of the runs that are held out.
    """
    found = _ALTERNATIVE.search(text)
    if found is None or recording is None:
        return text, []
    points = _with_term(text.replace(found[0], ""), found[1])
    try:
        cleaned = thinned(clean(recording)[0])
    except DataError:
        return text, []
    if (scheme := _init_heat.scheme_of(cleaned)) is None:
        return text, []
    families = [_init_heat.family_of(_without_heat(way)) for way in (text, points)]
    of_polynomial, of_points = (_init_heat.held_out_residuals(cleaned, scheme, family) for family in families)
    if of_polynomial is None or of_points is None:
        return text, []
    before, after = _init_heat.rms(of_polynomial), _init_heat.rms(of_points)
    less = (p.rms(p.after) < c.rms(c.after) for p, c in zip(of_points, of_polynomial, strict=True))
    if after > CLEARLY_LESS * before or not all(less):
        return text, []
    what = holdout.name(scheme)
    why = f"measured points: {what} leaves {after:.3g} um with them, {before:.3g} um with a polynomial"
    return points.replace("@WHY@", why), [why]


def thinned(recording: Recording) -> Recording:
    """About MAX_ROWS of the rows, spread evenly; all if there are no more.

    Not every n-th row: these may be the same target of each run.
    """
    kept = np.arange(len(recording)) * GOLDEN_RATIO % 1.0 < _init_heat.MAX_ROWS / max(len(recording), 1)
    return recording.take(kept)


def _with_term(text: str, term: str) -> str:
    """The pipeline with one term in place of those that need no temperature."""
    lines, first = list[str](), True
    for line in text.splitlines():
        if not _TERM.match(line) or _init_heat.WARM in line:
            lines.append(line)
        elif first:
            lines.append(f"{line[: line.index('{')]}{term}   # @WHY@")
            first = False
    return "\n".join([*lines, ""])


def _without_heat(text: str) -> str:
    return "\n".join(line for line in text.splitlines() if _init_heat.WARM not in line and _init_heat.HEAT not in line)
