"""Recording and simulation agree once one is shifted in time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.drivers.simulated import DelayDifference
from errpipe.terms._base import NEVER, Parameter, Term
from errpipe.terms._search import Delays, Signals, resolved_times
from errpipe.terms._time_shift import shift_of
from errpipe.yamlfile import quantity

# Usual differences of clocks, from so many sampling intervals and s on: shorter ones are mostly dead times (to 20 ms).
USUAL, LATE = 4.0, 0.05
STEPS, FINE = 60.0, 0.5  # sampling intervals that are tried, and from one to the next
FURTHER, FARTHER = 1.03, 900.0  # factor between longer ones, and the longest in s (typical ones reach 600 s)
COARSE = 14  # offsets of the coarse grid, early and late each
MIN_INTERVALS = 0.75  # sampling intervals by which clocks must differ to be seen


class ClockOffset(Term):
    """The clocks of the recording and of the simulation differ: the curves agree once one is shifted.

    Equation   deviation(t) = f(t - offset) - f(t), f the simulated signal
    Assumes    one constant offset; the signal is recorded without a break
    Typical    10..600 s
    Moves      large where the signal is steep, zero where it is constant
    Source     two loggers with their own clocks
    """

    term: Literal["clock_offset"] = "clock_offset"
    column: str = Field(description="Column of the simulated values.")
    shortest: float = quantity("s", "Smallest usual shift.", 10.0)
    longest: float = quantity("s", "Largest shift that is tried.", 600.0)
    family = "measurement"
    only_estimated = True
    compensable = False
    artefact = "the clocks of recording and simulation differ: set them right"
    simulated_log_odds = NEVER
    nuisance = False
    gain_sd = 0.15  # the difference of the shifted signals enters with gain 1
    in_part = "never"
    gains = (Parameter("share", "1", (0.8, 1.2), (0.0, 2.0), "1 where the shift explains it in full"),)
    prior_log_odds = -0.5  # shared among the estimated one and the grid: a little likelier than a dead time

    def nonlinear(self) -> tuple[Parameter, ...]:
        typical, bounds = (self.shortest, self.longest), (-self.longest, self.longest)
        return (Parameter("offset", "s", typical, bounds, "recording late", search=Delays()),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (recording.name("time") or "row",)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ClockOffset]:
        step, session = resolved_times(recording)
        longest = min(max(STEPS * step, FARTHER), 0.25 * session)
        if recording.name("time") is not None and longest > MIN_INTERVALS * step:
            for column in recording.names("simulated", component=component):
                yield cls(column=column, shortest=max(USUAL * step, LATE), longest=longest)

    @classmethod
    def estimates(
        cls, recording: Recording, component: str, signals: Signals
    ) -> Iterator[tuple[ClockOffset, tuple[float, ...]]]:
        """The offset with the smallest residual, and a coarse grid: gains of parts are not known yet."""
        step, _ = resolved_times(recording)
        for term in cls.bind(recording, component):
            late = step * np.arange(MIN_INTERVALS, STEPS, FINE)
            late = np.r_[late, np.exp(np.arange(np.log(STEPS * step), np.log(term.longest), np.log(FURTHER)))]
            late = late[late <= term.longest]
            if signals.values:
                offset = shift_of(DelayDifference(0.0, term.column), recording, signals, np.r_[-late[::-1], late], step)
                coarse = np.geomspace(late[0], late[-1], COARSE)
                yield from ((term, (float(v),)) for v in (offset, *coarse, *-coarse) if abs(v) >= MIN_INTERVALS * step)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return DelayDifference(nonlinear[0], self.column).value(recording)[:, None]
