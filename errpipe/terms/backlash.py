"""Constant step between the two directions of approach."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Direction
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, direction_column, moving, response_share
from errpipe.drivers.sessions import hold
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._search import Speeds
from errpipe.terms._slack import Slack, of_reversal

SHARES = (0.03, 0.06, 0.12, 0.2, 0.35, 0.55, 0.8)  # of the highest acceleration
BRAKING = Parameter(
    *("braking", "mm/s2", (50.0, 2000.0), (0.0, 1e6), "deceleration beyond which the mass runs on across the gap"),
    search=Speeds(shares=SHARES),
)  # friction over mass: 0.005 to 0.2 of gravity
PUSHED = -2.0  # log odds: a gap shows where an axis stops, mostly


class Backlash(Term):
    """The axis stops short of its target from either side: a step between the two directions of approach.

    Equation   deviation(d) = -lost_motion / 2 * d,  d = +1 or -1
               in fast logs also d = the side that the drive pushes on: sign(v) + a / braking, held at rest
    Assumes    the gap is closed within the approach (else `friction_hysteresis`); the same all along the axis
               (else `screw_windup`)
    Typical    2..20 um
    Moves      positive lost motion: approached from below the axis stops short of the target (deviation negative)
    Source     ISO 230-2 (reversal error); Ni 1997, geometric errors
    """

    term: Literal["backlash"] = "backlash"
    axis: Axis
    radial: Radial = False
    column: str | None = Field(None, description="Column of the acceleration, by which a mass changes sides.")
    also_of_positioning = True
    family = "reversal"
    gains = (Parameter("lost_motion", "um", (2.0, 20.0), (-200.0, 200.0), "step between the directions"),)

    def nonlinear(self) -> tuple[Parameter, ...]:
        return (BRAKING,) if self.column else ()

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (direction_column(recording, self.axis), *([self.column] if self.column else ()))

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Backlash]:
        for axis in axes_acting(recording, component):
            if recording.names("direction", axis=axis) or recording.names("velocity", axis=axis):
                yield cls(axis=axis, radial=is_radial(component))
            if recording.names("velocity", axis=axis):
                for column in recording.names("acceleration", axis=axis):
                    yield cls(axis=axis, radial=is_radial(component), column=column)

    def splittable_in_batches(self, recording: Recording) -> bool:
        return recording.name("direction", axis=self.axis) is not None

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (-0.5 * self._side(recording, *nonlinear) * response_share(recording, self.axis, self.radial))[:, None]

    def _side(self, recording: Recording, *braking: float) -> np.ndarray:
        side = direction(recording, self.axis)
        if self.column is None:
            return side
        way = moving(recording, str(recording.name("velocity", axis=self.axis)))
        pushed = np.sign(way + recording.array(self.column) / braking[0])
        held = hold(recording.run_codes(), np.where((way == 0) | (pushed == 0), np.nan, pushed))
        return np.where(np.isnan(held), side, held)

    def log_prior_odds(self) -> float:
        return PUSHED if self.column else self.prior_log_odds

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        return of_reversal(base[:, 0], recording, self.axis, self.radial)

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        if self.column is not None:
            return None  # no controller has the acceleration that decides the side of the mass
        half = -0.5 * parameters["lost_motion"]
        return (Lowered(Direction(axis=self.axis), None, lambda x: np.full(np.shape(x), half)),)
