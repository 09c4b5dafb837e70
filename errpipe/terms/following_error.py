"""Proportional to velocity, with its sign."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Input
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._warm import scaled


class FollowingError(Term):
    """The axis is late: at speed v it stands lag * v behind its command.

    Equation   deviation = -lag * v                                 [um] = [ms] * [mm/s]
    Assumes    constant loop gain Kv = 1 / lag, no feed-forward left over; a clock that is late looks the same
    Typical    v / Kv; 0.01..60 ms
    Moves      positive lag: behind the command in either direction
    Source     position loop with gain Kv; ISO 230-4, Weck
    """

    term: Literal["following_error"] = "following_error"
    axis: Axis
    column: str = Field(description="Column of the velocity.")
    radial: Radial = False
    reports_as = "following_error"
    family = "servo"

    def linear(self) -> tuple[Parameter, ...]:
        return (Parameter("lag", "ms", (0.01, 60.0), (-1000.0, 1000.0), "time by which the axis is late"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.column,)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[FollowingError]:
        for axis in () if is_radial(component) else axes_acting(recording, component):
            for column in recording.names("velocity", axis=axis):
                yield cls(axis=axis, column=column)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (-recording.array(self.column) * share(recording, self.axis, self.radial))[:, None]

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        return (Lowered(scaled(Input(name=self.column), -parameters["lag"])),)
