"""Deflection that grows with the square or cube of an overhang."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Input, Power
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import axes, position_name
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import scaled
from errpipe.terms._place import direction_of, own_axis
from errpipe.terms._search import Listed
from errpipe.terms._slack import Slack, difference_of_shape
from errpipe.yamlfile import quantity

EXPONENTS = Listed((2.0, 2.5, 3.0))
LOADS = (2.0, 3.0, 4.0)  # exponents of a cantilever's deflection: moment, load at the end, own weight (beam tables)
TOGETHER = 0.3  # prior standard deviation of the share of each: any may be as large as a third of the others


class GravitySag(Term):
    """A ram, quill or table bends under its own weight, with the square or cube of the overhang.

    Equation   deviation(l) = sag * (l / length)^exponent            [um]
    Assumes    only one overhang matters; small deflection
    Typical    5..40 um at full overhang, exponent 2..3
    Moves      negative sag: the free end hangs down; the same in both directions of travel
    Source     beam bending, F l^3 / (3 E I); Ni 1997, errors from load
    """

    term: Literal["gravity_sag"] = "gravity_sag"
    column: str = Field(description="Column of the overhang or position that bends.")
    start: float = quantity("mm", "Position without overhang.", 0.0)
    length: float = quantity("mm", "Overhang at which the parameter is stated.")
    sign: Literal[-1, 1] = Field(1, description="+1 where the overhang grows with the column, -1 where it shrinks.")
    family = "load"
    rowwise = True
    gains = (Parameter("sag", "um", (5.0, 40.0), (-500.0, 500.0), "deflection at full overhang"),)
    searched = (Parameter("exponent", "1", (2.0, 3.0), (1.8, 4.0), "2: line load or moment, 3: end load", EXPONENTS),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[GravitySag]:
        pointing = direction_of(component)
        places = [position_name(recording, a) for a in axes(recording)] if pointing else []
        if pointing is None and component != "E_D":
            return
        own = own_axis(component)
        for name in [*places, *recording.names("overhang")]:
            axis = recording.manifest.columns[name].axis
            if (axis is not None and axis == pointing) or (own is not None and axis not in (own, None)):
                continue
            values = recording.array(name)
            low, high = np.nanmin(values), np.nanmax(values)
            if not high > low:
                continue
            if axis is None or low >= 0:
                yield cls(column=name, length=float(max(abs(low), abs(high))))
            if axis is not None:
                yield cls(column=name, start=float(high), length=float(high - low), sign=-1)
                if low < 0:
                    yield cls(column=name, start=float(low), length=float(high - low))

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        reach = np.clip(self.sign * (recording.array(self.column) - self.start), 0, None) / self.length
        return (reach ** nonlinear[0])[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        """A moment, a load at the end and the beam's own weight bend it together, in unknown shares."""
        for exponent in LOADS:
            yield difference_of_shape(self.basis(recording, exponent)[:, 0], base[:, 0]), TOGETHER

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        (exponent,) = self.nonlinear_values(parameters)
        if self.sign < 0 or self.start != 0:
            return None
        gain = parameters["sag"] / self.length**exponent
        reach = Power(of=Input(name=self.column), exponent=exponent)
        return (Lowered(scaled(reach, gain)),)
