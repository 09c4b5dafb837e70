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
from errpipe.terms._drivers import scaled
from errpipe.terms._search import Listed
from errpipe.terms._slack import Slack
from errpipe.yamlfile import quantity

MAX_TOOLS = 40  # runs; more are not tools
EXPONENTS = Listed((0.35, 0.55, 0.75, 1.0, 1.3))
OWN_RATE = 0.5  # standard deviation of a tool's rate over the mean of all tools (chosen, not measured)


class ToolWear(Term):
    """The cutting edge recedes by wear: the part becomes oversize until the tool is changed.

    Equation   deviation = wear * (s / 1000 m)^exponent               [um], s = length cut with this edge
    Assumes    the length cut starts at 0 with each tool, or where the label of `tool` changes; exponent < 1: fast at
               first, then steady
    Typical    1..30 um
    Moves      one way only, back at each tool change
    Source     ISO 3685 (flank wear curve)
    """

    term: Literal["tool_wear"] = "tool_wear"
    column: str = Field(description="Column of the length cut.")
    reference: float = quantity("m", "Length cut at which the wear is stated.", 1000.0, gt=0)
    tool: str | None = Field(None, description="Column of the tool's label, where the length cut runs on over tools.")
    form = "any rate"
    family = "process"
    searched = (Parameter("exponent", "1", (0.5, 1.0), (0.2, 3.0), "shape of the wear curve", EXPONENTS),)

    def linear(self) -> tuple[Parameter, ...]:
        return (Parameter("wear", "um", (1.0, 30.0), (-500.0, 500.0), f"after {self.reference:g} m"),)

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
            for tool in (None, *labels_over(recording, term.column)):
                cut = since_change(recording, term.column, tool)
                if np.nanmax(cut) > 0:
                    yield term.model_copy(update={"reference": float(np.nanmax(cut)), "tool": tool})

    def _driver(self, exponent: float) -> Power:
        return Power(of=Affine(weights=(1.0 / self.reference,), of=(Input(name=self.column),)), exponent=exponent)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        if self.tool is None:
            return drive(self._driver(*nonlinear), recording)[:, None]
        cut = since_change(recording, self.column, self.tool)
        return (np.maximum(cut / self.reference, 0.0) ** nonlinear[0])[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        yield self.basis(recording, min(nonlinear[0] * 1.6, 3.0))[:, 0], 0.3
        run = recording.run_codes() if self.tool is None else tool_numbers(recording, self.tool)
        codes = np.unique(run)
        for code in codes if 2 <= codes.size <= MAX_TOOLS else ():
            own = base[:, 0] * ((run == code) - 1.0 / codes.size)  # less the mean of all: that is the form
            yield own, OWN_RATE * float(np.sqrt(np.mean(own**2) / max(np.var(base[:, 0]), 1e-300)))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        if self.tool is not None:
            return None
        return (Lowered(scaled(self._driver(*self.nonlinear_values(parameters)), parameters["wear"])),)


def labels_over(recording: Recording, column: str) -> tuple[str, ...]:
    """Label columns (2 to MAX_TOOLS values) across which a length cut accumulates; none if the length ever falls."""
    cut = recording.array(column)
    if np.any(np.diff(cut[np.isfinite(cut)]) < 0):
        return ()
    names = (*recording.names("group"), *recording.names("run"))
    return tuple(n for n in names if 2 <= recording.frame[n].nunique() <= MAX_TOOLS)


def tool_numbers(recording: Recording, label: str) -> np.ndarray:
    """0, 1, ... for each stretch of rows with one label, shape (rows,)."""
    labels = recording.frame[label].to_numpy()
    return np.r_[0, np.cumsum(labels[1:] != labels[:-1])].astype(np.int64)


def since_change(recording: Recording, column: str, label: str | None) -> np.ndarray:
    """Length cut since the label changed: less the value on the row before; as recorded where there is no label."""
    cut = recording.array(column)
    if label is None:
        return cut
    number = tool_numbers(recording, label)
    first = np.r_[0, np.flatnonzero(np.diff(number)) + 1]
    return cut - np.r_[0.0, cut[first[1:] - 1]][number]
