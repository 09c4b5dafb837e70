"""Rises and decays exponentially after spindle-speed changes, with a power of speed."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Literal

import numpy as np

from errpipe.domain.driver import Lag
from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfSpindleSpeed
from errpipe.terms._search import Listed
from errpipe.terms._slack import Slack, difference_of_shape, start_states


class SpindleGrowth(OfSpindleSpeed):
    """The bearings heat the spindle, which expands: an exponential after each change of speed.

    Equation   tau dy/dt + y = (n / n_max)^exponent;  deviation = growth * y
    Assumes    one body; equal time constants for warming and cooling unless tau_down differs
    Typical    5..60 um at full speed, tau 600..6000 s, exponent 1..2
    Moves      positive growth: towards the work as the spindle warms
    Source     Ni 1997, spindle model; ISO 230-3 (ETVE)
    """

    term: Literal["spindle_growth"] = "spindle_growth"
    family = "thermal"
    form = "any start"
    rowwise = True
    gains = (Parameter("growth", "um", (5.0, 60.0), (-500.0, 500.0), "growth at full speed, warmed through"),)
    searched = (
        Parameter("tau", "s", (600.0, 6000.0), (60.0, 40000.0), "time constant"),
        Parameter("exponent", "1", (1.0, 2.0), (0.3, 3.0), "power of the speed", search=Listed((0.7, 1.0, 1.4, 2.0))),
    )

    def _driver(self, *nonlinear: float) -> Lag:
        tau, exponent = nonlinear
        return Lag(of=self._power(exponent), tau_up=tau, tau_down=tau, start="zero")

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        tau, exponent = nonlinear
        yield from start_states(recording, tau, 0.1, 0.7)
        for factor in (0.3, 3.0):
            yield self.basis(recording, tau * factor, exponent)[:, 0], 0.25
        if recording.name("cut_length") is not None:  # or the spindle ran on between the parts
            ran_on = dataclasses.replace(recording, between="held")
            yield self.basis(ran_on, *nonlinear)[:, 0] - base[:, 0], 0.3
        for factor, power in itertools.product((1.0, 0.3), (1.0 / 1.5, 1.5)):  # each body has its own friction
            yield difference_of_shape(self.basis(recording, tau * factor, exponent * power)[:, 0], base[:, 0]), 0.15
