"""Drive force periodic in position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import ONE
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, position_name
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis
from errpipe.terms._place import driven_axes
from errpipe.terms._search import Waves
from errpipe.terms._slack import Slack, higher_harmonics, uneven_waves


class TorqueRipple(Term):
    """The motor's magnets pull unevenly (cogging, commutation): a force that repeats with position.

    Equation   force = sine * sin(2 pi x / period) + cosine * cos(2 pi x / period)   [N]
    Assumes    the same ripple at every speed
    Typical    2..50 N; the period is that of the magnets, often not the screw's lead
    Moves      with position alone, not with time
    Source     cogging torque of permanent-magnet motors
    """

    term: Literal["torque_ripple"] = "torque_ripple"
    axis: Axis
    reports_as = "torque_ripple"
    family = "friction"
    compensable = False

    def linear(self) -> tuple[Parameter, ...]:
        return (
            Parameter("sine", "N", (2.0, 50.0), (-1000.0, 1000.0), "amplitude of the sine part"),
            Parameter("cosine", "N", (2.0, 50.0), (-1000.0, 1000.0), "amplitude of the cosine part"),
        )

    def nonlinear(self) -> tuple[Parameter, ...]:
        return (Parameter("period", "mm", (1.0, 60.0), (0.2, 200.0), "length of the wave", search=Waves()),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (position_name(recording, self.axis),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[TorqueRipple]:
        for axis in driven_axes(recording, component):
            yield cls(axis=axis)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        angle = 2 * np.pi / nonlinear[0] * position(recording, self.axis)
        return np.column_stack([np.sin(angle), np.cos(angle)])

    def log_prior_odds(self) -> float:
        return -3.0  # the strongest of some hundred waves is picked

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        x = position(recording, self.axis)
        yield from uneven_waves(base, x)
        yield from higher_harmonics(x, nonlinear[0])

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (period,) = self.nonlinear_values(parameters)
        gains = np.array([parameters["sine"], parameters["cosine"]])

        def wave(x: np.ndarray) -> np.ndarray:
            angle = 2 * np.pi / period * x
            return np.column_stack([np.sin(angle), np.cos(angle)]) @ gains

        return (Lowered(ONE, self.axis, wave, period),)
