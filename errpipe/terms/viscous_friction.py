"""Drive force proportional to velocity."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import Parameter, Term
from errpipe.terms._equations import times
from errpipe.terms._fields import Axis
from errpipe.terms._place import velocities
from errpipe.terms._slack import Slack


class ViscousFriction(Term):
    """Viscous friction of oil and grease: the drive force grows with speed.

    Equation   force = damping * v                                  [N] = [N s/m] * [m/s]
    Assumes    in proportion to speed
    Typical    50..3000 N s/m
    Moves      positive damping: the drive pushes the way it moves
    Source     Newton's law of viscosity
    """

    term: Literal["viscous_friction"] = "viscous_friction"
    axis: Axis
    column: str = Field(description="Column of the velocity.")
    family = "friction"
    compensable = False
    form = "any shape"
    friction_part = "viscous"
    gains = (Parameter("damping", "N s/m", (50.0, 3000.0), (-50000.0, 50000.0), "force per speed"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ViscousFriction]:
        for axis, column in velocities(recording, component):
            yield cls(axis=axis, column=column)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (1e-3 * recording.array(self.column))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        yield np.abs(base[:, 0]), 0.4  # it may differ by direction

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        return (Lowered(times(Input(name=self.column), 1e-3 * parameters["damping"])),)
