"""A smooth static curve over one axis, as a polynomial."""

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


class Chebyshev(Term):
    """Any smooth deviation that only position decides: lead error, bow, the sum of both.

    Equation   deviation(x) = sum c_k T_k(u),  u from -1 to 1 over the span, k = lowest..degree
    Assumes    the same at every temperature; held at its end values beyond the span
    Typical    degree 3..8, 1..50 um
    Moves      positive c1: the deviation grows along the axis
    Source     Ni 1997, geometric polynomials; Chebyshev's instead of powers, which no computer can solve for
    """

    term: Literal["chebyshev"] = "chebyshev"
    rowwise = True
    axis: Axis
    degree: int = Field(4, ge=1, le=40, description="Highest degree.")
    lowest: int = Field(1, ge=0, description="1 leaves out the level, 2 the straight line too.")
    span: tuple[float, float] | None = quantity("mm", "Ends of the curve; the positions seen otherwise.", None)
    sample = {"axis": "X"}

    def _profile(self) -> shapes.Polynomial:
        return shapes.Polynomial(degree=self.degree, lowest=self.lowest, span=self.span)

    def settled(self, recording: Recording) -> Chebyshev:
        """The term with its span written down."""
        profile = self._profile().settled(position(recording, self.axis))
        return self.model_copy(update={"span": profile.span})

    def linear(self) -> tuple[Parameter, ...]:
        return shapes.parameters(self._profile(), rotary=False)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return self._profile().basis(position(recording, self.axis))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        gains = np.array([parameters[p.name] for p in self.linear()])
        return (Lowered(ONE, self.axis, shapes.curve(self._profile(), gains, rotary=False)),)
