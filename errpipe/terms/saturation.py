"""The drive gives no more force than it can."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import Affine, Clip, Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfSimulatedForce
from errpipe.terms._search import Speeds

SHARES = (0.3, 0.4, 0.5, 0.58, 0.66, 0.74, 0.82, 0.9, 0.95)  # of the largest force


class Saturation(OfSimulatedForce):
    """The drive's current is limited: where the simulation asks for more, the force stays at the limit.

    Equation   force = clip(f, -limit, limit) - f                    [N], f the simulated force
    Assumes    the same limit both ways; a loop that does not wind up
    Typical    limit 0.5..0.95 of the largest simulated force
    Moves      nothing while the force stays below the limit
    Source     current limit of servo drives
    """

    term: Literal["saturation"] = "saturation"
    searched = (
        Parameter("limit", "N", (10.0, 5000.0), (0.0, 1e6), "largest force of the drive", search=Speeds(shares=SHARES)),
    )
    prior_log_odds = -2.0  # most drives are chosen large enough, and most forces are measured from zero

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        force = recording.array(self.column)
        return (np.clip(force, -nonlinear[0], nonlinear[0]) - force)[:, None]

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (limit,) = self.nonlinear_values(parameters)
        force, share = Input(name=self.column), parameters["share"]
        return (Lowered(Affine(weights=(share, -share), of=(Clip(low=-limit, high=limit, of=force), force))),)
