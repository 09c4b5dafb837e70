"""Smooth non-linear deviation of one direction along another axis' position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import axes, position, position_name, response_share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis
from errpipe.terms._lines import at_targets
from errpipe.terms._place import direction_of, is_radial, own_axis
from errpipe.terms._search import Listed
from errpipe.terms._slack import Slack, chebyshev
from errpipe.yamlfile import quantity


def bow_columns(x: np.ndarray, low: float, high: float, order: int, line: float = 0.0) -> np.ndarray:
    """Chebyshev polynomials of degree 2..order over low..high, held beyond, 3 with `line` of 1, (rows, order - 1)."""
    unit = (2 * np.clip(np.asarray(x, dtype=float), low, high) - low - high) / (high - low)
    curve = np.polynomial.chebyshev.chebvander(unit, order)
    curve[..., 3:4] += line * curve[..., 1:2]
    return curve[..., 2:]


# Slopes of reference lines over bow3: from that through the ends to that along the middle; of least squares 0.6
LINES = (-1.0, -0.5, -0.2, 0.1, 0.3, 0.6, 1.0, 1.7, 3.0)


class Straightness(Term):
    """A guideway is not straight: motion along one axis shifts the tool sideways, smoothly and not linearly.

    Equation   deviation(x) = sum of b_k T_k(u), k = 2..order, u = position scaled to -1..1 over low..high
    Assumes    a smooth guideway; degree 1 belongs to squareness, degree 0 to the datum; ends held beyond low..high
               (circle, any_line: degree 1 is `line` times degree 3, for the reference line of the profile is unknown)
    Typical    2..20 um
    Moves      positive bow: the ends of travel lie further in the positive direction than the middle
    Source     ISO 230-1 (straightness error motion); Ni 1997, geometric errors
    """

    term: Literal["straightness"] = "straightness"
    axis: Axis
    low: float = quantity("mm", "Lower end of the axis, where the polynomial's scale starts.")
    high: float = quantity("mm", "Upper end of the axis.")
    order: int = Field(4, ge=2, le=12, description="Highest degree.")
    across: str | None = Field(None, description="Circular test: the axis whose direction the deviation points in.")
    any_line: bool = Field(False, description="Circular test: the slope of the reference line is solved for.")
    family = "geometric"
    rowwise = True
    form = "any shape"
    on_both_axes = False  # two guideways do not bend alike, and two cubic bows are the sine wave of a squareness

    def nonlinear(self) -> tuple[Parameter, ...]:
        span = (min(LINES), max(LINES))
        line = Parameter("line", "1", span, span, "slope of the reference line over bow3", search=Listed(LINES))
        return (line,) if self.across and self.any_line and self.order > 2 else ()

    def linear(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"bow{k}", "um", (2.0, 20.0), (-500.0, 500.0), f"amplitude of degree {k}")
            for k in range(2, self.order + 1)
        )

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        names = (self.axis, self.across) if self.across else (self.axis,)
        return tuple(position_name(recording, a) for a in names)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Straightness]:
        pointing = direction_of(component)
        letters = axes(recording)[:2]
        if is_radial(component) and len(letters) == 2:
            for axis, across in (letters, letters[::-1]):
                x = position(recording, axis)
                yield cls(axis=axis, low=float(np.nanmin(x)), high=float(np.nanmax(x)), across=across)
        if pointing is None:
            return
        own = own_axis(component)
        for axis in axes(recording):
            if axis == pointing or (own is not None and axis != own):
                continue
            x = position(recording, axis)
            low, high = float(np.nanmin(x)), float(np.nanmax(x))
            if (degree := np.unique(at_targets(x[~np.isnan(x)])).size - 1) >= 2:  # what few places determine
                yield cls(axis=axis, low=low, high=high, order=min(degree, 4))

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[Straightness]:
        """Of a circle also the reference line: a slope beyond it is a squareness, another effect."""
        yield from (term.model_copy(update={"any_line": True}) for term in cls.bind(recording, component))

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        curve = bow_columns(position(recording, self.axis), self.low, self.high, self.order, *nonlinear)
        return curve * response_share(recording, self.across, True)[:, None] if self.across else curve

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        polynomials = chebyshev(position(recording, self.axis), 8)
        across = response_share(recording, self.across, True) if self.across else 1.0
        for k in (0, 1) if not self.across else (0,):  # whichever line, of a circle whichever centre, it counts from
            yield polynomials[:, k] * across, 0.4
        for k in range(self.order + 1, 9):
            yield polynomials[:, k] * across, 0.3

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        if self.across:
            return None
        gains = self.gain_values(parameters)
        low, high, order = self.low, self.high, self.order
        return (Lowered(ONE, self.axis, lambda x: bow_columns(x, low, high, order) @ gains),)
