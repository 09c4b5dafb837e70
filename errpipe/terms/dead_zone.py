"""Forces below a threshold do not show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Clip, Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import NEVER, Parameter, Term
from errpipe.terms._equations import times
from errpipe.terms._search import Speeds


class DeadZone(Term):
    """A play or a dead band of the amplifier swallows small forces; larger ones come through less by as much.

    Equation   force = -clip(f, -threshold, threshold)               [N], f the simulated force
    Assumes    the same threshold both ways
    Typical    threshold 0.01..0.2 of the largest simulated force
    Moves      with every force, up to the threshold
    Source     dead band of amplifiers, play of couplings
    """

    term: Literal["dead_zone"] = "dead_zone"
    column: str = Field(description="Column of the simulated force.")
    reports_as = "dead_zone"
    family = "friction"
    compensable = False
    simulated_log_odds = NEVER
    nuisance = False
    gain_sd = 0.15  # its size is set by the threshold: gain 1
    in_part = "never"
    gains = (Parameter("share", "1", (0.8, 1.2), (0.0, 2.0), "1 where it explains the mismatch in full"),)
    prior_log_odds = -2.0  # rare, because forces are usually measured from zero

    def nonlinear(self) -> tuple[Parameter, ...]:
        shares = (0.01, 0.02, 0.035, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3)
        return (
            Parameter(
                "threshold",
                "N",
                (0.5, 500.0),
                (0.0, 1e6),
                "force that does not come through",
                search=Speeds(shares=shares),
            ),
        )

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[DeadZone]:
        for column in recording.names("simulated", component=component) if component.startswith("F_") else ():
            yield cls(column=column)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        force = recording.array(self.column)
        return (-np.clip(force, -nonlinear[0], nonlinear[0]))[:, None]

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (threshold,) = self.nonlinear_values(parameters)
        force = Input(name=self.column)
        return (Lowered(times(Clip(low=-threshold, high=threshold, of=force), -parameters["share"])),)
