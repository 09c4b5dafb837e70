"""The drive gives no more force than it can."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Affine, Clip, Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.terms._base import NEVER, Parameter, Term
from errpipe.terms._search import Speeds


class Saturation(Term):
    """The drive's current is limited: where the simulation asks for more, the force stays at the limit.

    Equation   force = clip(f, -limit, limit) - f                    [N], f the simulated force
    Assumes    the same limit both ways; a loop that does not wind up
    Typical    limit 0.5..0.95 of the largest simulated force
    Moves      nothing while the force stays below the limit
    Source     current limit of servo drives
    """

    term: Literal["saturation"] = "saturation"
    column: str = Field(description="Column of the simulated force.")
    reports_as = "saturation"
    family = "friction"
    compensable = False
    simulated_log_odds = NEVER
    nuisance = False
    gain_sd = 0.15  # it has no size of its own beside its limit
    in_part = "never"
    gains = (Parameter("share", "1", (0.8, 1.2), (0.0, 2.0), "1 where it explains the mismatch in full"),)
    prior_log_odds = -2.0  # most drives are chosen large enough, and most forces are measured from zero

    def nonlinear(self) -> tuple[Parameter, ...]:
        shares = (0.3, 0.4, 0.5, 0.58, 0.66, 0.74, 0.82, 0.9, 0.95)
        return (
            Parameter(
                "limit", "N", (10.0, 5000.0), (0.0, 1e6), "largest force of the drive", search=Speeds(shares=shares)
            ),
        )

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Saturation]:
        for column in recording.names("simulated", component=component) if component.startswith("F_") else ():
            yield cls(column=column)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        force = recording.array(self.column)
        return (np.clip(force, -nonlinear[0], nonlinear[0]) - force)[:, None]

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (limit,) = self.nonlinear_values(parameters)
        force, share = Input(name=self.column), parameters["share"]
        return (Lowered(Affine(weights=(share, -share), of=(Clip(low=-limit, high=limit, of=force), force))),)
