"""Proportional to the product of two temperature rises, or the square of one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_deviation
from errpipe.domain.driver import Product
from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.terms._base import Parameter
from errpipe.terms._driven import Driven
from errpipe.terms._drivers import REFERENCE, rise_driver, sensors
from errpipe.terms._fields import Reference
from errpipe.terms._slack import MANY_STARTS, Slack


class ThermalInteraction(Driven):
    """Two warm parts interact (a hot spindle in a hot column), or the effect of one is more than proportional.

    Equation   deviation = gain * (T1 - T_ref) * (T2 - T_ref)        [um] = [um/K2] * [K]^2
    Assumes    rises counted from the reference; T1 = T2 gives the square
    Typical    0.05..0.5 um/K2
    Moves      nothing while one of the two is cold
    Source     Ni 1997, thermal error model with products of temperatures
    """

    term: Literal["thermal_interaction"] = "thermal_interaction"
    first: str = Field(description="Column of one temperature.")
    second: str = Field(description="Column of the other temperature; the same one for a square.")
    reference: Reference = REFERENCE
    family = "thermal"
    form = "any shape"  # all that departs is where the rises are counted from
    rowwise = True
    simulated_log_odds = -15.0
    gains = (Parameter("gain", "um/K2", (0.05, 0.5), (-20.0, 20.0), "shift per kelvin squared"),)
    prior_log_odds = -2.0  # a product is rarer than a sum

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return tuple(dict.fromkeys((self.first, self.second)))

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ThermalInteraction]:
        if is_deviation(component):
            candidates = sensors(recording)
            for i, first in enumerate(candidates):
                for second in candidates[i:]:
                    yield cls(first=first, second=second)

    def _driver(self, *nonlinear: float) -> Product:
        return Product(of=tuple(rise_driver(s, self.reference) for s in (self.first, self.second)))

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        for sensor in dict.fromkeys((self.first, self.second)):
            yield recording.array(sensor) - np.nanmean(recording.array(sensor)), 0.12

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[ThermalInteraction]:
        """Rises over the start of each session, and of a few over one value for all, as no body is reset overnight.

        What other values would add are sums of the two rises. Of many sessions it would be gains that differ from one
        to the next, which plays whatever does: a turning centre's 23 mornings.
        """
        starts = [values[np.isfinite(values)][0] for values in map(recording.array, sensors(recording))]
        one = float(np.median(starts)) if starts else REFERENCE
        for reference in (None, one) if 1 < np.unique(sessions(recording)).size < MANY_STARTS else (None,):
            yield from (t.model_copy(update={"reference": reference}) for t in cls.bind(recording, component))
