"""An angular error motion of one axis multiplied by an offset along another axis or the tool length."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import axes, position, position_name, travel
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis
from errpipe.terms._lines import at_targets
from errpipe.terms._place import direction_of, own_axis
from errpipe.terms._slack import Slack, chebyshev
from errpipe.yamlfile import quantity


class AngularAbbe(Term):
    """A slide pitches, yaws or rolls as it moves; the further the point from the guideway, the larger the shift.

    Equation   deviation = lever * (tilt + sum of a_k u^k, k = 1..order)   [um] = [m] * [urad]
               u = position scaled to -1..1 over low..high; the lever is another axis' position or the tool length
    Assumes    small angles; a smooth guideway
    Typical    5..50 urad over the travel
    Moves      zero where the lever is zero; grows with tool length or table height
    Source     Abbe 1890; ISO 230-1 (angular error motions); Ni 1997, volumetric error
    """

    term: Literal["angular_abbe"] = "angular_abbe"
    axis: Axis
    lever: str = Field(description="Column or constant of the offset that the angle acts on.")
    low: float = quantity("mm", "Lower end of the axis, where the polynomial's scale starts.")
    high: float = quantity("mm", "Upper end of the axis.")
    order: int = Field(3, description="Highest degree of the angle over the axis.")
    family = "geometric"
    form = "any shape"
    rowwise = True

    def linear(self) -> tuple[Parameter, ...]:
        return tuple(
            Parameter(f"angle{k}", "urad", (5.0, 50.0), (-2000.0, 2000.0), f"angular error of degree {k}")
            for k in range(1, self.order + 1)
        )

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (position_name(recording, self.axis), self.lever)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[AngularAbbe]:
        pointing, own = direction_of(component), own_axis(component)
        if pointing is None:
            return
        levers: list[tuple[str | None, str]] = []
        levers += [(a, position_name(recording, a)) for a in axes(recording) if a != pointing]
        levers += [(None, n) for n in recording.names("overhang")]
        for axis in axes(recording):
            if own not in (None, axis):  # EXX: how X tilts, over where the others stand
                continue
            low, high = travel(recording, axis)
            x = position(recording, axis)
            spare = np.unique(at_targets(x[~np.isnan(x)])).size - 2  # each place may be left out
            for letter, lever in levers:
                values = recording.array(lever)
                if letter != axis and np.nanmax(values) > np.nanmin(values):
                    yield cls(axis=axis, lever=lever, low=low, high=high, order=int(np.clip(spare, 1, 3)))

    def _powers(self, x: np.ndarray) -> np.ndarray:
        unit = (2 * np.asarray(x, dtype=float) - self.low - self.high) / (self.high - self.low)
        return np.column_stack([unit**k for k in range(1, self.order + 1)])

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return self._powers(position(recording, self.axis)) * (recording.array(self.lever) * 1e-3)[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        yield recording.array(self.lever), 1.0  # the angle is zero at one end as often as in the middle
        polynomials = chebyshev(position(recording, self.axis), 6)
        for k in range(self.order + 1, 7):
            yield polynomials[:, k] * recording.array(self.lever), 0.2
        for k in range(1, self.order + 1):
            yield polynomials[:, k], 0.2  # the origin of the lever is unknown

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        gains = self.gain_values(parameters)
        return (Lowered(Input(name=self.lever), self.axis, lambda x: 1e-3 * self._powers(x) @ gains),)
