"""Recording and simulation agree once one is shifted in time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions
from errpipe.terms._base import NEVER, Parameter, Term
from errpipe.terms._search import Shifts
from errpipe.yamlfile import quantity


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
    shortest: float = quantity("s", "Smallest shift that is tried.", 10.0)
    longest: float = quantity("s", "Largest shift that is tried.", 600.0)
    family = "measurement"
    compensable = False
    artefact = "the clocks of recording and simulation differ: set them right"
    simulated_log_odds = NEVER
    nuisance = False
    gain_sd = 0.15  # the difference of the shifted signals enters with gain 1
    in_part = "never"
    gains = (Parameter("share", "1", (0.8, 1.2), (0.0, 2.0), "1 where the shift explains it in full"),)
    prior_log_odds = -1.0

    def nonlinear(self) -> tuple[Parameter, ...]:
        typical, bounds = (self.shortest, self.longest), (-self.longest, self.longest)
        return (Parameter("offset", "s", typical, bounds, "recording late", Shifts()),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (recording.name("time") or "row",)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ClockOffset]:
        t = recording.time()
        step = np.median(np.diff(t)[np.diff(t) > 0]) if len(t) > 3 else np.nan
        if recording.name("time") is None or not np.isfinite(step):
            return
        for column in recording.names("simulated", component=component):
            yield cls(column=column, shortest=float(0.75 * step), longest=float(min(max(60 * step, 0.0), 7200.0)))

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        (offset,) = nonlinear
        t, f, session = recording.time(), recording.array(self.column), sessions(recording)
        shifted = np.full(f.shape, np.nan)
        for s in np.unique(session):
            rows = np.flatnonzero((session == s) & np.isfinite(f))
            if rows.size > 1:
                at, first = np.unique(t[rows], return_index=True)
                shifted[rows] = np.interp(t[rows] - offset, at, f[rows][first])
        return (shifted - f)[:, None]
