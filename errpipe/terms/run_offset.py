"""Every run has its own datum: set-up, not machine."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter, Term


class RunOffset(Term):
    """A constant per run, for instruments that are zeroed anew each time. A nuisance: never compensated.

    Equation   deviation = level of the row's run
    Assumes    nothing of the machine hides in the levels; a drift from run to run would
    Typical    0..100 um
    Moves      a positive level: the whole run reads too far
    Source     ISO 230-2, 2014, clause on the datum of a measuring run
    """

    term: Literal["run_offset"] = "run_offset"
    runs: tuple[str, ...] = Field((), description="Labels of the runs; none: all of them.")
    compensable = False
    sample = {}

    def settled(self, recording: Recording) -> RunOffset:
        """The term with the runs' labels written down."""
        return self if self.runs else self.model_copy(update={"runs": recording.run_labels()})

    def linear(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(f"level_{run}", "um", (0.0, 100.0), meaning=f"datum of run {run}") for run in self.runs)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return recording.names("run")

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        names = np.asarray(recording.run_labels(), dtype=object)[recording.run_codes()]
        return np.column_stack([names == run for run in self.runs]).astype(float)
