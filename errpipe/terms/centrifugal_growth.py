"""Proportional to the square of spindle speed, at once."""

from __future__ import annotations

from typing import Literal

from errpipe.domain.driver import Power
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfSpindleSpeed


class CentrifugalGrowth(OfSpindleSpeed):
    """A turning spindle swells and its bearings shift: at once with speed, and gone as soon as it stops.

    Equation   deviation = shift * (n / n_max)^2                     [um]
    Assumes    no warming (that is `spindle_growth`)
    Typical    1..20 um at full speed
    Moves      often against the growth: the spindle gets shorter as it swells
    Source     stress in a rotating cylinder; contact angle of preloaded ball bearings
    """

    term: Literal["centrifugal_growth"] = "centrifugal_growth"
    family = "spindle"
    rowwise = True
    gains = (Parameter("shift", "um", (1.0, 20.0), (-200.0, 200.0), "shift at full speed"),)

    def _driver(self, *nonlinear: float) -> Power:
        return self._power(2.0)
