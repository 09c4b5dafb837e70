"""Units of a finding's parameters: terms state um over mm; responses may be angles or forces, axes may turn.

A term's unit is parsed as text: its numerator `um` is replaced by the response's unit, a length in the denominator by
the unit of the axis. A unit that is impossible on an axis (um/m on a rotary one) is never returned.
"""

from __future__ import annotations

import math

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import is_rotary
from errpipe.terms import Term

PER_DEGREE = (  # unit on a linear axis, unit on a rotary one, and the factor for the value
    ("/(m/s2)", "/(deg/s2)", 1e-3),
    (" s/m", " s/deg", 1e-3),
    ("/m", "/deg", 1e-3),
)
INERTIA = {"N m": ("kg m2", 1e-3 * 180.0 / math.pi)}  # of N m/(rad/s2), where N/(m/s2) is 1 kg
LAG_OF_ANGLES = 1e-6 * 180.0 / math.pi * 1e3  # ms of urad/(deg/s), where um/(mm/s) is 1 ms


def on_rotary_axis(term: Term, recording: Recording) -> bool:
    """Does the term act along a rotary axis?"""
    return is_rotary(recording, str(getattr(term, "axis", "")))


def reported(unit: str, response: str, rotary: bool) -> tuple[str, float]:
    """The unit in which a parameter of a term is reported, and the factor for its value."""
    factor = 1.0
    if rotary and unit == "kg":
        return INERTIA.get(response, ("N/(deg/s2)", 1e-3))
    if rotary:
        if unit == "ms":
            return unit, LAG_OF_ANGLES if response == "urad" else 1.0
        for linear, turned, change in PER_DEGREE:
            if linear in unit:
                unit, factor = unit.replace(linear, turned), change
                break
        unit = unit.replace("mm", "deg")
    if unit.startswith("um") and response in ("urad", "N", "N m"):
        unit = response + unit[2:]
    elif unit.startswith("N") and response == "N m":
        unit = response + unit[1:]
    return unit, factor


def rounded(value: float, digits: int = 3) -> str:
    """A number in a sentence, to so many significant digits, without an exponent up to a million."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text
