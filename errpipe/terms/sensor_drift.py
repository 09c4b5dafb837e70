"""Grows with time alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter, Term

# Log prior odds; an effect that has the same form and may stray from it pays about as much for that
LOG_ODDS_OF_DRIFT = -30.0


class SensorDrift(Term):
    """Drift of the measuring device: a deviation that grows with time, independent of the machine.

    Equation   deviation = rate * t                                  [um] = [um/h] * [h]
    Assumes    constant rate; never compensated, because it is not an error of the machine
    Typical    0.5..5 um/h
    Moves      one way, through pauses too
    Source     drift of probes and amplifiers (ISO 230-3, drift of the measuring set-up)
    """

    term: Literal["sensor_drift"] = "sensor_drift"
    restarts: bool = Field(False, description="Does the clock restart with each run?")
    family = "measurement"
    compensable = False
    artefact = "it is the instrument that drifts, not the machine: correct the reading"
    simulated_log_odds = -12.0
    gains = (Parameter("rate", "um/h", (0.5, 5.0), (-500.0, 500.0), "drift per hour"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (recording.name("time") or "row",)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[SensorDrift]:
        if recording.name("time") is not None:
            yield cls(restarts=bool(np.any(np.diff(recording.time()) < 0)))

    def log_prior_odds(self) -> float:
        """An instrument does not depend on the start of a run: an effect that restarts there is likely wear or heat."""
        return LOG_ODDS_OF_DRIFT if self.restarts else 0.0

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        t = recording.time()
        return ((t - np.nanmin(t)) / 3600.0)[:, None]
