"""A smooth static curve over one axis, as a polynomial."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from errpipe.terms import _profiles as shapes
from errpipe.terms._driven import CurveOverAxis
from errpipe.yamlfile import quantity


class Chebyshev(CurveOverAxis):
    """Any smooth function of position: lead error, bow, or their sum.

    Equation   deviation(x) = sum c_k T_k(u),  u from -1 to 1 over the span, k = lowest..degree
    Assumes    the same at every temperature; held at its end values beyond the span
    Typical    degree 3..8, 1..50 um
    Moves      positive c1: the deviation grows along the axis
    Source     Ni 1997, geometric polynomials; Chebyshev's instead of powers, which no computer can solve for
    """

    term: Literal["chebyshev"] = "chebyshev"
    rowwise = True
    degree: int = Field(4, ge=1, le=40, description="Highest degree.")
    lowest: int = Field(1, ge=0, description="1 leaves out the level, 2 the straight line too.")
    span: tuple[float, float] | None = quantity("mm", "Ends of the curve; the positions seen otherwise.", None)

    def _profile(self) -> shapes.Polynomial:
        return shapes.Polynomial(degree=self.degree, lowest=self.lowest, span=self.span)
