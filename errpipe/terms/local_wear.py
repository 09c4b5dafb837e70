"""A deviation confined to one stretch of the axis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import axes, position, position_name, response_share, travel
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, direction_of, is_radial, own_axis
from errpipe.terms._search import Places, Widths
from errpipe.terms._slack import Slack
from errpipe.yamlfile import quantity


class LocalWear(Term):
    """One section of the guideway or screw is worn (or the scale is dirty there): a local dip or bump.

    Equation   deviation(x) = depth * exp(-(x - centre)^2 / (2 width^2))
    Assumes    one smooth stretch; the same in both directions
    Typical    2..20 um over 50..300 mm (about four widths)
    Moves      positive depth: too far (or up) on that stretch, nothing elsewhere
    Source     ISO 230-1 (local deviation); Ni 1997, geometric errors
    """

    term: Literal["local_wear"] = "local_wear"
    axis: Axis
    radial: Radial = False
    length: float = quantity("mm", "Length of the axis, which bounds the worn stretch.", 1000.0)
    family = "geometric"
    simulated_log_odds = -12.0
    in_part = "never"  # it already acts on one stretch
    gains = (Parameter("depth", "um", (2.0, 20.0), (-200.0, 200.0), "height of the bump", at_largest=True),)

    def nonlinear(self) -> tuple[Parameter, ...]:
        narrow, wide, far = 0.01 * self.length, 0.15 * self.length, 10 * self.length
        usual = (min(max(12.0, narrow), wide / 2), max(min(75.0, wide), 2 * narrow))
        return (
            Parameter("centre", "mm", (0.0, self.length), (-far, far), "middle of it", Places()),
            Parameter("width", "mm", usual, (narrow, wide), "standard deviation of the bell", search=Widths()),
        )

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[LocalWear]:
        own = own_axis(component)
        positioning = own is not None and component == f"E{own}{own}"  # of a rotary axis, too
        if direction_of(component) is None and not is_radial(component) and not positioning:
            return
        along = axes_acting(recording, component) if is_radial(component) or positioning else axes(recording)
        for axis in along:
            if own is None or axis == own:
                low, high = travel(recording, axis)
                yield cls(axis=axis, radial=is_radial(component), length=high - low)

    def _bell(self, x: np.ndarray, centre: float, width: float) -> np.ndarray:
        return np.exp(-0.5 * ((np.asarray(x, dtype=float) - centre) / width) ** 2)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        bell = self._bell(position(recording, self.axis), *nonlinear)
        return (bell * response_share(recording, self.axis, self.radial))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        centre, width = nonlinear
        for shift in () if self.radial else (-0.6, 0.6):
            yield self.basis(recording, centre + shift * width, width)[:, 0] - base[:, 0], 0.5

    def active_ranges(self, recording: Recording, *nonlinear: float) -> dict[str, tuple[float, float]]:
        centre, width = nonlinear
        return {position_name(recording, self.axis): (centre - 2 * width, centre + 2 * width)}

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        depth = parameters["depth"]
        centre, width = self.nonlinear_values(parameters)
        return (Lowered(ONE, self.axis, lambda x: depth * self._bell(x, centre, width)),)
