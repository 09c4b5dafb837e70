"""Proportional to the square of spindle speed, at once."""

from __future__ import annotations

from typing import Literal

from errpipe.domain.driver import Power
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfSpindleSpeed


class CentrifugalGrowth(OfSpindleSpeed):
    """Centrifugal load expands a rotating spindle and shifts its bearings: immediate with speed, and zero at rest.

    Equation   deviation = shift * (n / n_max)^2                     [um]
    Assumes    no heating (see `spindle_growth`)
    Typical    1..20 um at full speed
    Moves      often opposite to thermal growth: the spindle shortens as its diameter expands
    Source     stress in a rotating cylinder; contact angle of preloaded ball bearings
    """

    term: Literal["centrifugal_growth"] = "centrifugal_growth"
    family = "spindle"
    rowwise = True
    gains = (Parameter("shift", "um", (1.0, 20.0), (-200.0, 200.0), "shift at full speed"),)

    def _driver(self, *nonlinear: float) -> Power:
        return self._power(2.0)
