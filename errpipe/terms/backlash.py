"""Constant step between the two directions of approach."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import Direction
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, direction_column, share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import as_positioning, axes_acting, is_radial
from errpipe.terms._slack import Slack, of_reversal


class Backlash(Term):
    """The axis stops short on the side it came from: a step between the two directions of approach.

    Equation   deviation(d) = -lost_motion / 2 * d,  d = +1 or -1
    Assumes    the gap is closed within the approach (else `friction_hysteresis`); the same all along the axis
               (else `screw_windup`)
    Typical    2..20 um
    Moves      positive lost motion: approached from below the axis stops short of the target (deviation negative)
    Source     ISO 230-2 (reversal value); Ni 1997, geometric errors
    """

    term: Literal["backlash"] = "backlash"
    axis: Axis
    radial: Radial = False
    family = "reversal"
    gains = (Parameter("lost_motion", "um", (2.0, 20.0), (-200.0, 200.0), "step between the directions"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (direction_column(recording, self.axis),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Backlash]:
        for axis in axes_acting(recording, component):
            if recording.names("direction", axis=axis) or recording.names("velocity", axis=axis):
                yield cls(axis=axis, radial=is_radial(component))

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[Backlash]:
        return cls.bind(recording, as_positioning(component))

    def splittable_in_batches(self, recording: Recording) -> bool:
        return recording.name("direction", axis=self.axis) is not None

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (-0.5 * direction(recording, self.axis) * share(recording, self.axis, self.radial))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        return of_reversal(base[:, 0], recording, self.axis, self.radial)

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        half = -0.5 * parameters["lost_motion"]
        return (Lowered(Direction(axis=self.axis), None, lambda x: np.full(np.shape(x), half)),)
