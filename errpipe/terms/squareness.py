"""Deviation of one direction proportional to another axis' position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import axes, position, position_name
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import direction_of, is_radial, own_axis


class Squareness(Term):
    """Two axes are not at right angles: motion along one shifts the tool along the other, in proportion.

    Equation   deviation(y) = angle * y                             [um] = [urad] * [m];  circle: angle * x y / R
    Assumes    straight guideways (the curved part is `straightness`)
    Typical    5..60 urad
    Moves      positive angle: the tool shifts in the positive direction as the other axis moves positive
    Source     ISO 230-1 (squareness); Ni 1997, equation of the volumetric error
    """

    term: Literal["squareness"] = "squareness"
    axis: Axis
    radial: Radial = False
    family = "geometric"
    rowwise = True
    gains = (Parameter("angle", "urad", (5.0, 60.0), (-2000.0, 2000.0), "departure from a right angle"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        own = (position_name(recording, self.axis),)
        return own if not self.radial else tuple(position_name(recording, a) for a in axes(recording)[:2])

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Squareness]:
        letters = axes(recording)
        if is_radial(component) and len(letters) >= 2:
            yield cls(axis=letters[1], radial=True)
        elif own_axis(component) is None and direction_of(component) is not None:
            for axis in letters:
                if axis != direction_of(component):
                    yield cls(axis=axis)

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[Squareness]:
        """Also of a straightness: a fit attributes its slope to the set-up, but a simulation may lack it."""
        yield from cls.bind(recording, component)
        own = own_axis(component)
        if own in axes(recording) and direction_of(component) not in (own, None):
            yield cls(axis=str(own))

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        if not self.radial:
            return (position(recording, self.axis) * 1e-3)[:, None]
        x, y = (position(recording, a) for a in axes(recording)[:2])
        radius = np.hypot(x, y)
        return (x * y * 1e-3 / np.where(radius > 0, radius, np.nan))[:, None]

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        if self.radial:
            return None
        slope = parameters["angle"] * 1e-3
        return (Lowered(ONE, self.axis, lambda x: slope * np.asarray(x, dtype=float)),)
