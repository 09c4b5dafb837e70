"""Drive force that accelerates the axis' mass."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_force
from errpipe.domain.driver import Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import scaled


class MovingMass(Term):
    """Inertia of table, workpiece and screw: a drive force proportional to acceleration.

    Equation   force = mass * a                                     [N] = [kg] * [m/s2]
    Assumes    one rigid mass; rotating inertia counted as mass
    Typical    20..5000 kg
    Moves      positive mass: force ahead while the axis speeds up
    Source     Newton's second law
    """

    term: Literal["moving_mass"] = "moving_mass"
    column: str = Field(description="Column of the acceleration.")
    family = "friction"
    compensable = False
    gains = (Parameter("mass", "kg", (20.0, 5000.0), (-1e5, 1e5), "mass that is accelerated"),)
    prior_log_odds = -6.0  # nearly every simulation of a drive force includes it

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[MovingMass]:
        if is_force(component):
            for column in recording.names("acceleration", axis=component[2:]):
                yield cls(column=column)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (1e-3 * recording.array(self.column))[:, None]

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        return (Lowered(scaled(Input(name=self.column), 1e-3 * parameters["mass"])),)
