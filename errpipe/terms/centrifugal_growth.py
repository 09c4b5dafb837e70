"""Proportional to the square of spindle speed, at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Affine, Input, Power
from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter
from errpipe.terms._driven import Driven
from errpipe.yamlfile import quantity


class CentrifugalGrowth(Driven):
    """A turning spindle swells and its bearings shift: at once with speed, and gone as soon as it stops.

    Equation   deviation = shift * (n / n_max)^2                     [um]
    Assumes    no warming (that is `spindle_growth`)
    Typical    1..20 um at full speed
    Moves      often against the growth: the spindle gets shorter as it swells
    Source     stress in a rotating cylinder; contact angle of preloaded ball bearings
    """

    term: Literal["centrifugal_growth"] = "centrifugal_growth"
    column: str = Field(description="Column of the spindle speed.")
    full_speed: float = quantity("rpm", "Speed at which the parameter is stated.")
    reports_as = "centrifugal_growth"
    family = "spindle"
    rowwise = True
    gains = (Parameter("shift", "um", (1.0, 20.0), (-200.0, 200.0), "shift at full speed"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[CentrifugalGrowth]:
        if component.startswith("E"):
            for column in recording.names("spindle_speed"):
                values = recording.array(column)
                if np.nanmax(values) > max(np.nanmin(values), 0.0):
                    yield cls(column=column, full_speed=float(np.nanmax(values)))

    def _driver(self, *nonlinear: float) -> Power:
        return Power(of=Affine(weights=(1.0 / self.full_speed,), of=(Input(name=self.column),)), exponent=2.0)
