"""Two axes lag differently: an ellipse at 45 degrees that changes sign with the direction of travel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import axes, position_name, response_share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._place import is_radial


class ServoMismatch(Term):
    """The two axes of a circle have different lags (servo mismatch): the circle becomes an ellipse at 45 degrees.

    Equation   deviation = -lag_difference / 2 * (vx x - vy y) / R    [um] = [ms] * [mm/s]
               lag_difference = lag of the first axis minus lag of the second
    Assumes    constant speed along the circle; the common part of the lag does not show in the radius
    Typical    1..20 um
    Moves      the ellipse turns by 90 degrees with the direction of travel and grows with feed
    Source     ISO 230-4 (circular tests); Kakino 1987
    """

    term: Literal["servo_mismatch"] = "servo_mismatch"
    first: str = Field(description="Letter of the one axis.")
    second: str = Field(description="Letter of the other axis.")
    family = "servo"
    gains = (Parameter("lag_difference", "ms", (0.01, 5.0), (-1000.0, 1000.0), "first axis minus second"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        names = [recording.name("velocity", axis=a) for a in (self.first, self.second)]
        return tuple(n for n in names if n) + tuple(position_name(recording, a) for a in (self.first, self.second))

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ServoMismatch]:
        letters = axes(recording)[:2]
        if is_radial(component) and len(letters) == 2 and all(recording.name("velocity", axis=a) for a in letters):
            yield cls(first=letters[0], second=letters[1])

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        along = [
            recording.array(recording.names("velocity", axis=a)[0]) * response_share(recording, a, True)
            for a in (self.first, self.second)
        ]
        return (-0.5 * (along[0] - along[1]))[:, None]
