"""Deviation proportional to axis position, at every temperature."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, response_share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._slack import Slack, chebyshev


class ScaleError(Term):
    """The lead of the screw or the pitch of the scale is wrong: the axis travels too far by a constant fraction.

    Equation   deviation(x) = slope * x                            [um] = [um/m] * [m]
    Assumes    the same slope at every temperature (else `scale_expansion`); a measuring beam out of line looks
               the same (cosine error)
    Typical    5..50 um/m
    Moves      positive slope: the axis travels past its target, in proportion to position
    Source     ISO 230-2; Ni 1997, geometric errors
    """

    term: Literal["scale_error"] = "scale_error"
    axis: Axis
    radial: Radial = False
    family = "geometric"
    rowwise = True
    gains = (Parameter("slope", "um/m", (5.0, 50.0), (-1000.0, 1000.0), "share by which the axis travels too far"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ScaleError]:
        for axis in axes_acting(recording, component):
            yield cls(axis=axis, radial=is_radial(component))

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (position(recording, self.axis) * (1e-3 * response_share(recording, self.axis, self.radial)))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        if not self.radial:  # a lead error is not quite straight
            yield from ((column, 0.12) for column in chebyshev(position(recording, self.axis), 8).T[2:])

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        slope = parameters["slope"] * 1e-3
        return (Lowered(ONE, self.axis, lambda x: slope * np.asarray(x, dtype=float)),)
