"""Grows with the length cut, resets at a tool change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Affine, Input, Power
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import Parameter, Term
from errpipe.terms._search import Listed
from errpipe.terms._slack import Slack
from errpipe.terms._warm import scaled

MOST_TOOLS = 40  # runs; more are not tools
OWN_RATE = 0.5  # standard deviation of a tool's rate over the mean of all tools (chosen, not measured)


class ToolWear(Term):
    """The edge wears back as it cuts: the work grows, until a fresh edge is put in.

    Equation   deviation = wear * (s / 1000 m)^exponent               [um], s = length cut with this edge
    Assumes    the length cut starts at 0 with each tool; exponent < 1: fast at first, then steady
    Typical    1..30 um
    Moves      one way only, back at each tool change
    Source     ISO 3685 (flank wear curve)
    """

    term: Literal["tool_wear"] = "tool_wear"
    column: str = Field(description="Column of the length cut.")
    reference: float = Field(
        1000.0, gt=0, description="Length cut at which the wear is stated.", json_schema_extra={"unit": "m"}
    )
    reports_as = "tool_wear"
    family = "process"

    def linear(self) -> tuple[Parameter, ...]:
        return (Parameter("wear", "um", (1.0, 30.0), (-500.0, 500.0), f"after {self.reference:g} m"),)

    def nonlinear(self) -> tuple[Parameter, ...]:
        return (
            Parameter(
                "exponent",
                "1",
                (0.5, 1.0),
                (0.2, 3.0),
                "shape of the wear curve",
                search=Listed((0.35, 0.55, 0.75, 1.0, 1.3)),
            ),
        )

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.column,)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ToolWear]:
        if component.startswith(("E", "F")):  # a worn edge removes less and needs more force
            for column in recording.names("cut_length"):
                values = recording.array(column)
                if np.nanmax(values) > np.nanmin(values):
                    yield cls(column=column)

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[ToolWear]:
        """Wear is stated at the longest length cut: beyond it nothing is known."""
        for term in cls.bind(recording, component):
            yield term.model_copy(update={"reference": float(np.nanmax(recording.array(term.column)))})

    def _driver(self, exponent: float) -> Power:
        return Power(of=Affine(weights=(1.0 / self.reference,), of=(Input(name=self.column),)), exponent=exponent)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return drive(self._driver(*nonlinear), recording)[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        yield self.basis(recording, min(nonlinear[0] * 1.6, 3.0))[:, 0], 0.3
        run = recording.run_codes()
        codes = np.unique(run)
        for code in codes if 2 <= codes.size <= MOST_TOOLS else ():
            own = base[:, 0] * (run == code)
            yield own, OWN_RATE * float(np.sqrt(np.mean(own**2) / max(np.var(base[:, 0]), 1e-300)))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        return (Lowered(scaled(self._driver(*self.nonlinear_values(parameters)), parameters["wear"])),)
