"""Drive force with the sign of velocity, constant otherwise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_force
from errpipe.domain.driver import Driver
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, moving, position
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfVelocity
from errpipe.terms._drivers import curve, scaled, sign
from errpipe.terms._place import driven_axes
from errpipe.terms._search import Speeds
from errpipe.terms._slack import AT_STANDSTILL, Slack, chebyshev, gradual_reversal

SHARES = Speeds(shares=(0.0, 0.003, 0.01, 0.03))
GROWS = 0.3  # freedom of friction that grows along the travel (guides and covers; chosen, not measured)


class CoulombFriction(OfVelocity):
    """Coulomb (dry) friction: a constant drive force in the direction of motion, independent of speed.

    Equation   force = friction * tanh(v / sharpness)               [N]
    Assumes    equal force in both directions, unless `by_direction`: then the mean of both and half their difference
    Typical    5..300 N
    Moves      positive friction: the drive pushes the way it moves
    Source     Coulomb 1785; sharpness 0 means a plain sign
    """

    term: Literal["coulomb_friction"] = "coulomb_friction"
    column: str = Field(description="Column of the velocity, or of the direction.")
    friction_part = "dry"
    gains = (Parameter("force", "N", (5.0, 300.0), (-5000.0, 5000.0), "friction force"),)
    searched = (
        Parameter("sharpness", "mm/s", (0.0, 1.0), (0.0, 10.0), "speed within which the force turns round", SHARES),
    )

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[CoulombFriction]:
        for axis in driven_axes(recording, component) or (component[2:],) * is_force(component):
            for column in recording.names("velocity", axis=axis):
                yield cls(axis=axis, column=column)
            if not recording.names("velocity", axis=axis):
                for column in recording.names("direction", axis=axis):
                    yield cls(axis=axis, column=column, fixed={"sharpness": 0.0})

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        side = direction(recording, self.axis)
        yield side - base[:, 0], AT_STANDSTILL
        if recording.name("position", axis=self.axis) is None:
            return
        yield from gradual_reversal(side, recording, self.axis)  # bristles bend before they slide
        place = chebyshev(position(recording, self.axis), 2)
        yield base[:, 0] * place[:, 1], GROWS  # friction of guides and seals varies along the travel
        yield base[:, 0] * place[:, 2], 0.5 * GROWS

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        if nonlinear[0] <= 0:
            return moving(recording, self.column)[:, None]
        return np.tanh(recording.array(self.column) / nonlinear[0])[:, None]

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (sharpness,) = self.nonlinear_values(parameters)
        way: Driver = sign(self.column)
        if sharpness > 0:
            way = curve(self.column, lambda v: np.tanh(v / sharpness), 8 * sharpness)
        return (Lowered(scaled(way, parameters["force"])),)
