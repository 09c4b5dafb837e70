"""Proportional to the mass on the table, possibly times its position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_deviation
from errpipe.domain.driver import Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import axes, position, position_name, travel
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import scaled
from errpipe.yamlfile import quantity


class WorkpieceLoad(Term):
    """The mass on the table deforms bed and guideway, in proportion to the mass and depending on the table's position.

    Equation   deviation = load / full_load * (settle + tilt * u + bend * u^2),  u = position scaled to 0..1
    Assumes    elastic; proportional to the mass
    Typical    5..30 um at full load
    Moves      nothing on an empty table
    Source     elastic foundation; Ni 1997, errors from load
    """

    term: Literal["workpiece_load"] = "workpiece_load"
    column: str = Field(description="Column of the mass on the table.")
    axis: str | None = Field(None, description="Axis over which the load's effect changes; none: the same everywhere.")
    low: float = quantity("mm", "Lower end of the axis over which the load acts.", 0.0)
    high: float = quantity("mm", "Upper end of that axis.", 1.0)
    full_load: float = quantity("kg", "Mass for which the parameters are stated.", 100.0, gt=0)
    order: int = Field(0, description="Highest degree over that axis; 0: the same everywhere.")
    family = "load"

    def linear(self) -> tuple[Parameter, ...]:
        names = ("settle", "tilt", "bend")[: self.order + 1]
        return tuple(Parameter(n, "um", (1.0, 30.0), (-500.0, 500.0), f"at {self.full_load:g} kg") for n in names)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.column, position_name(recording, self.axis)) if self.axis else (self.column,)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[WorkpieceLoad]:
        if not is_deviation(component):
            return
        for name in recording.names("load"):
            values = recording.array(name)
            if not np.nanmax(values) > np.nanmin(values):
                continue
            yield cls(column=name)
            for axis in axes(recording):
                low, high = travel(recording, axis)
                yield cls(column=name, axis=axis, low=low, high=high, order=2)

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[WorkpieceLoad]:
        """Sizes are stated at the largest mass that was on the table."""
        for term in cls.bind(recording, component):
            yield term.model_copy(update={"full_load": float(np.nanmax(recording.array(term.column)))})

    def _powers(self, x: np.ndarray) -> np.ndarray:
        unit = (np.asarray(x, dtype=float) - self.low) / (self.high - self.low)
        return np.column_stack([unit**k for k in range(self.order + 1)])

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        load = recording.array(self.column)[:, None] / self.full_load
        return load if self.axis is None else load * self._powers(position(recording, self.axis))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        gains = self.gain_values(parameters) / self.full_load
        source = Input(name=self.column)
        if self.axis is None:
            return (Lowered(scaled(source, float(gains[0]))),)
        return (Lowered(source, self.axis, lambda x: self._powers(x) @ gains),)
