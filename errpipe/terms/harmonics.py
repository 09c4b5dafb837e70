"""Periodic in one axis' position, with a given or a searched period and any orders of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position
from errpipe.terms import _profiles as shapes
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis
from errpipe.yamlfile import quantity

MAX_STARTS = 4000  # trial periods: about one second of search on 10 000 rows


class Harmonics(Term):
    """A wave along the axis: screw runout, motor poles, gear mesh, encoder interpolation.

    Equation   deviation(x) = sum over orders k of sin_k sin(2 pi k x / period) + cos_k cos(2 pi k x / period)
    Assumes    the same wave all along; sampled finer than half of its shortest period, and not in step with it
    Typical    0.1..10 um
    Moves      positive sin_1: too far on the first half of each period
    Source     ISO 230-2 (periodic positional error)
    """

    term: Literal["harmonics"] = "harmonics"
    rowwise = True
    axis: Axis
    period: float | None = quantity("mm", "Repeat length; searched for where not given.", None, gt=0)
    search: tuple[float, float] = quantity("mm", "Shortest and longest period tried.", (2.0, 50.0))
    orders: tuple[int, ...] = Field((1,), min_length=1, description="Multiples of the basic wave.")
    spacing: float | None = quantity("1/mm", "Step between trials; from the travel.", None, gt=0)
    sample = {"axis": "X", "search": (5.0, 50.0)}

    def settled(self, recording: Recording) -> Harmonics:
        """The term with an explicit search step: a quarter of the resolution of the travel."""
        if self.period is not None or self.spacing is not None:
            return self
        x = position(recording, self.axis)
        return self.model_copy(update={"spacing": 0.25 / max(float(np.nanmax(x) - np.nanmin(x)), 1e-9)})

    def linear(self) -> tuple[Parameter, ...]:
        return shapes.parameters(self._profile(1.0), rotary=False, typical=(0.1, 10.0))

    def nonlinear(self) -> tuple[Parameter, ...]:
        if self.period is not None:
            return ()
        return (Parameter("period", "mm", self.search, self.search, "repeat length"),)

    def starts(self, name: str) -> tuple[float, ...]:
        """Trial periods, equally spaced in 1/mm so that none is missed over the travel."""
        low, high = self.search
        step = self.spacing or 1e-3
        count = int(min(MAX_STARTS, max(8, np.ceil((1 / low - 1 / high) / step))))
        return tuple(1.0 / np.linspace(1 / high, 1 / low, count))

    def _profile(self, period: float) -> shapes.Harmonics:
        return shapes.Harmonics(period=self.period or period, orders=self.orders)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return self._profile(*nonlinear or (1.0,)).basis(position(recording, self.axis))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        period = self.period or self.nonlinear_values(parameters)[0]
        profile = self._profile(period)
        gains = self.gain_values(parameters)
        return (Lowered(ONE, self.axis, shapes.curve(profile, gains, rotary=False), period),)
