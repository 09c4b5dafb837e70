"""A static curve of any smooth shape over one axis, as a penalised B-spline."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.terms import _profiles as shapes
from errpipe.terms._driven import CurveOverAxis
from errpipe.yamlfile import quantity


class SmoothCurve(CurveOverAxis):
    """Any function of position; its smoothness is estimated from the measurements.

    Equation   deviation(x) = sum b_k B_k(x), cubic B-splines on equal stretches, strength of smoothing from the data
    Assumes    the same at every temperature; held at its end values beyond the span
    Typical    10..40 stretches, 1..50 um
    Moves      where the curve is positive the axis travels too far
    Source     Eilers and Marx 1996 (P-splines); Wood 2011 (restricted likelihood for the strength)
    """

    term: Literal["smooth_curve"] = "smooth_curve"
    segments: int = Field(20, ge=2, le=400, description="Stretches of equal length; more than the shape needs.")
    line: bool = Field(True, description="The curve may hold a straight part; false where another term has it.")
    span: tuple[float, float] | None = quantity("mm", "Ends of the curve; the positions seen otherwise.", None)
    sample = {"axis": "X", "segments": 8}

    def _profile(self) -> shapes.Curve:
        return shapes.Curve(segments=self.segments, line=self.line, span=self.span)

    def penalty(self) -> np.ndarray | None:
        return self._profile().penalty()
