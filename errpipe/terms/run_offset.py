"""Every run has its own datum: set-up, not machine."""

from __future__ import annotations

from typing import Literal

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter
from errpipe.terms._driven import PerRun


class RunOffset(PerRun):
    """A constant per run, for instruments that are zeroed before each run. A nuisance: never compensated.

    Equation   deviation = level of the row's run
    Assumes    the levels contain no error of the machine; a drift from run to run would be absorbed
    Typical    0..100 um
    Moves      a positive level: the whole run reads too far
    Source     ISO 230-2, 2014, clause on the datum of a measuring run
    """

    term: Literal["run_offset"] = "run_offset"

    def linear(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"level_{run}", "um", (0.0, 100.0), meaning=f"datum of run {run}") for run in self.runs)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return self.in_run(recording).astype(float)
