"""Forces below a threshold do not show."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import Clip, Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfSimulatedForce
from errpipe.terms._drivers import scaled
from errpipe.terms._search import Speeds

SHARES = Speeds(shares=(0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3))  # of the largest force


class DeadZone(OfSimulatedForce):
    """Play or a dead band of the amplifier: forces below the threshold are lost, larger ones are reduced by it.

    Equation   force = -clip(f, -threshold, threshold)               [N], f the simulated force
    Assumes    the same threshold both ways
    Typical    threshold 0.01..0.2 of the largest simulated force
    Moves      with every force, up to the threshold
    Source     dead band of amplifiers, play of couplings
    """

    term: Literal["dead_zone"] = "dead_zone"
    searched = (Parameter("threshold", "N", (0.5, 500.0), (0.0, 1e6), "force that does not come through", SHARES),)
    prior_log_odds = -2.0  # rare, because forces are usually measured from zero

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        force = recording.array(self.column)
        return (-np.clip(force, -nonlinear[0], nonlinear[0]))[:, None]

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (threshold,) = self.nonlinear_values(parameters)
        force = Input(name=self.column)
        return (Lowered(scaled(Clip(low=-threshold, high=threshold, of=force), -parameters["share"])),)
