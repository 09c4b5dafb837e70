"""Drive force proportional to velocity."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfVelocity
from errpipe.terms._drivers import scaled
from errpipe.terms._slack import Slack


class ViscousFriction(OfVelocity):
    """Viscous friction of oil and grease: the drive force grows with speed.

    Equation   force = damping * v                                  [N] = [N s/m] * [m/s]
    Assumes    in proportion to speed
    Typical    50..3000 N s/m
    Moves      positive damping: the drive pushes the way it moves
    Source     Newton's law of viscosity
    """

    term: Literal["viscous_friction"] = "viscous_friction"
    friction_part = "viscous"
    gains = (Parameter("damping", "N s/m", (50.0, 3000.0), (-50000.0, 50000.0), "force per speed"),)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (1e-3 * recording.array(self.column))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        yield np.abs(base[:, 0]), 0.4  # it may differ by direction

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        return (Lowered(scaled(Input(name=self.column), 1e-3 * parameters["damping"])),)
