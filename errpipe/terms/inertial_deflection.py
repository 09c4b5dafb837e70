"""Proportional to acceleration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import response_share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import scaled
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._slack import Slack, lagged


class InertialDeflection(Term):
    """Slide and column deflect under acceleration.

    Equation   deviation = -compliance * a                          [um] = [um/(m/s2)] * [m/s2]
    Assumes    acceleration slow compared with the first natural frequency
    Typical    1..10 um per m/s2
    Moves      positive compliance: against the acceleration
    Source     mass * lever / stiffness; ISO 230-4
    """

    term: Literal["inertial_deflection"] = "inertial_deflection"
    axis: Axis
    column: str = Field(description="Column of the acceleration.")
    radial: Radial = False
    family = "servo"
    gains = (Parameter("compliance", "um/(m/s2)", (1.0, 10.0), (-500.0, 500.0), "deflection per m/s2"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[InertialDeflection]:
        for axis in axes_acting(recording, component):
            for column in recording.names("acceleration", axis=axis):
                yield cls(axis=axis, column=column, radial=is_radial(component))

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        lean = -1e-3 * recording.array(self.column)
        return (lean * response_share(recording, self.axis, self.radial))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        for tau in (0.004, 0.02):  # the structure's vibration decays in about this time
            yield lagged(recording, base[:, 0], tau) - base[:, 0], 0.25

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        if self.radial:
            return None
        return (Lowered(scaled(Input(name=self.column), -1e-3 * parameters["compliance"])),)
