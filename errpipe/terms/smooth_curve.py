"""A static curve of any smooth shape over one axis, as a penalised B-spline."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position
from errpipe.terms import _profiles as shapes
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis
from errpipe.yamlfile import quantity


class SmoothCurve(Term):
    """Any deviation that only position decides, as smooth as the measurements ask for.

    Equation   deviation(x) = sum b_k B_k(x), cubic B-splines on equal stretches, strength of smoothing from the data
    Assumes    the same at every temperature; held at its end values beyond the span
    Typical    10..40 stretches, 1..50 um
    Moves      where the curve is positive the axis goes too far
    Source     Eilers and Marx 1996 (P-splines); Wood 2011 (restricted likelihood for the strength)
    """

    term: Literal["smooth_curve"] = "smooth_curve"
    axis: Axis
    segments: int = Field(20, ge=2, le=400, description="Stretches of equal length; more than the shape needs.")
    line: bool = Field(True, description="The curve may hold a straight part; false where another term has it.")
    span: tuple[float, float] | None = quantity("mm", "Ends of the curve; the positions seen otherwise.", None)
    sample = {"axis": "X", "segments": 8}

    def _profile(self) -> shapes.Curve:
        return shapes.Curve(segments=self.segments, line=self.line, span=self.span)

    def settled(self, recording: Recording) -> SmoothCurve:
        """The term with its span written down."""
        profile = self._profile().settled(position(recording, self.axis))
        return self.model_copy(update={"span": profile.span})

    def linear(self) -> tuple[Parameter, ...]:
        return shapes.parameters(self._profile(), rotary=False)

    def penalty(self) -> np.ndarray | None:
        return self._profile().penalty()

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return self._profile().basis(position(recording, self.axis))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        gains = np.array([parameters[p.name] for p in self.linear()])
        return (Lowered(ONE, self.axis, shapes.curve(self._profile(), gains, rotary=False)),)
