"""Proportional to a cutting force, possibly times overhang cubed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_deviation
from errpipe.domain.driver import Affine, Driver, Input, Power, Product
from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter
from errpipe.terms._driven import Driven
from errpipe.terms._search import Listed
from errpipe.terms._slack import Slack


class CuttingCompliance(Driven):
    """Tool, spindle and workpiece deflect under the cutting force; a boring bar with the cube of its overhang.

    Equation   deviation = compliance * F * (l / 100 mm)^exponent     [um] = [um/kN] * [kN]
    Assumes    elastic; exponent 0 (the machine) to 3 (a bar clamped at one end)
    Typical    5..60 um/kN
    Moves      positive compliance: the tool is pushed away from the work
    Source     beam bending F l^3 / (3 E I); Ni 1997, cutting force induced errors
    """

    term: Literal["cutting_compliance"] = "cutting_compliance"
    force: str = Field(description="Column of the cutting force.")
    overhang: str | None = Field(None, description="Column of the overhang, where stiffness falls with its cube.")
    family = "process"
    gains = (Parameter("compliance", "um/kN", (5.0, 60.0), (-2000.0, 2000.0), "deflection per kilonewton"),)

    def nonlinear(self) -> tuple[Parameter, ...]:
        if self.overhang is None:
            return ()
        return (Parameter("exponent", "1", (1.0, 3.0), (0.5, 4.0), "power of the overhang", Listed((1.0, 2.0, 3.0))),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return tuple(n for n in (self.force, self.overhang) if n)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[CuttingCompliance]:
        if not is_deviation(component):
            return
        for force in recording.names("force"):
            values = recording.array(force)
            if not np.nanmax(values) > np.nanmin(values):
                continue
            yield cls(force=force)
            for overhang in recording.names("overhang"):
                if recording.frame[overhang].nunique() > 1:
                    yield cls(force=force, overhang=overhang)

    def _driver(self, *nonlinear: float) -> Driver:
        push = Affine(weights=(1e-3,), of=(Input(name=self.force),))
        if self.overhang is None:
            return push
        reach = Affine(weights=(1e-2,), of=(Input(name=self.overhang),))
        return Product(of=(push, Power(of=reach, exponent=nonlinear[0])))

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        if self.overhang:
            yield recording.array(self.force), 0.4  # compliance beside the bar's
