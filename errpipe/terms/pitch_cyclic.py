"""Periodic in axis position with the screw lead, or in angle with a worm or gear."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, position_name, share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._search import Waves
from errpipe.terms._slack import Slack, higher_harmonics, uneven_waves


def wave(x: np.ndarray, period: float) -> np.ndarray:
    """Sine and cosine of position, shape (rows, 2)."""
    angle = 2 * np.pi / period * np.asarray(x, dtype=float)
    return np.column_stack([np.sin(angle), np.cos(angle)])


class PitchCyclic(Term):
    """The screw runs out once per turn ("drunken thread"): a wave with the lead, or its second harmonic.

    Equation   deviation(x) = sine * sin(2 pi x / period) + cosine * cos(2 pi x / period)
    Assumes    sampling finer than a quarter of the period and not in step with it; the same wave all along
    Typical    0.5..5 um; period 5..20 mm (the lead), for rotary axes 360 deg / teeth
    Moves      positive sine: too far on the first half of each turn
    Source     ISO 230-2 (periodic positional error); Ni 1997, geometric errors
    """

    term: Literal["pitch_cyclic"] = "pitch_cyclic"
    axis: Axis
    radial: Radial = False
    reports_as = "pitch_cyclic"
    family = "geometric"
    rowwise = True
    on_both_axes = False

    def linear(self) -> tuple[Parameter, ...]:
        return (
            Parameter("sine", "um", (0.5, 5.0), (-100.0, 100.0), "amplitude of the sine part"),
            Parameter("cosine", "um", (0.5, 5.0), (-100.0, 100.0), "amplitude of the cosine part"),
        )

    def nonlinear(self) -> tuple[Parameter, ...]:
        return (
            Parameter("period", "mm", (2.5, 20.0), (0.5, 400.0), "length of the wave", search=Waves(least_places=40)),
        )

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (position_name(recording, self.axis),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[PitchCyclic]:
        """One binding for each of lead, half the lead; with the period free where no lead is stated."""
        for axis in axes_acting(recording, component):
            known = recording.manifest.axis(axis)
            radial = is_radial(component)
            if known is None or known.screw_lead is None:
                yield cls(axis=axis, radial=radial)
                continue
            for harmonic in (1, 2):
                yield cls(axis=axis, radial=radial, fixed={"period": known.screw_lead / harmonic})

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        (period,) = nonlinear
        return wave(position(recording, self.axis), period) * share(recording, self.axis, self.radial)[:, None]

    def log_prior_odds(self) -> float:
        return 0.0 if self.fixed else -3.0  # prior odds: the strongest of about a hundred waves is chosen

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        if not self.radial:
            x = position(recording, self.axis)
            yield from uneven_waves(base, x)
            if not self.fixed:
                yield from higher_harmonics(x, nonlinear[0])

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (period,) = self.nonlinear_values(parameters)
        gains = np.array([parameters["sine"], parameters["cosine"]])
        return (Lowered(ONE, self.axis, lambda x: wave(x, period) @ gains, period),)
