"""Proportional to the difference of two temperatures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from errpipe.domain.components import is_deviation
from errpipe.domain.driver import Affine, Input
from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter
from errpipe.terms._driven import Driven
from errpipe.terms._drivers import COOLANT_WORDS, sensors


class GradientBending(Driven):
    """A column or bed that is warmer on one side than on the other bends, and the tool leans with it.

    Equation   deviation = gain * (T1 - T2)                          [um] = [um/K] * [K]
    Assumes    the two sensors represent the two sides
    Typical    1..15 um/K (26 um/K for a column 1.5 m high and 0.5 m deep)
    Moves      nothing when both sides warm alike
    Source     bending of a strip, alpha h^2 / (2 b); Ni 1997
    """

    term: Literal["gradient_bending"] = "gradient_bending"
    first: str = Field(description="Column of one temperature.")
    second: str = Field(description="Column of the other temperature, taken off.")
    family = "thermal"
    simulated_log_odds = -6.0
    gains = (Parameter("gain", "um/K", (1.0, 15.0), (-200.0, 200.0), "shift per kelvin of difference"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.first, self.second)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[GradientBending]:
        if is_deviation(component):
            candidates = sensors(recording)
            for i, first in enumerate(candidates):
                for second in candidates[i + 1 :]:
                    yield cls(first=first, second=second)

    def log_prior_odds(self) -> float:
        places = f"{self.first} {self.second}".lower()
        return -3.0 if any(word in places for word in COOLANT_WORDS) else 0.0  # a fluid is rarely one side of a body

    def _driver(self, *nonlinear: float) -> Affine:
        return Affine(weights=(1.0, -1.0), of=(Input(name=self.first), Input(name=self.second)))
