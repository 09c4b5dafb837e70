"""The same everywhere and always: where the machine's zero lies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import Constant
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import Parameter, Term


class Offset(Term):
    """A constant deviation.

    Equation   deviation = level
    Assumes    one datum for the whole recording (else the nuisance `run_offset`)
    Typical    0..100 um
    Moves      positive level: everywhere too far
    Source     Ni 1997: the polynomials E_k start at i = 0; the mixed formula drops the constant without saying so
    """

    term: Literal["offset"] = "offset"
    rowwise = True
    is_level = True
    gains = (Parameter("level", "um", (0.0, 100.0), meaning="deviation where everything else is zero"),)
    sample = {}

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return ()

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return np.ones((len(recording), 1))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        return (Lowered(Constant(value=parameters["level"])),)
