"""Drive force with the sign of velocity that grows along the axis."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, moving, position, position_name
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfVelocity
from errpipe.terms._drivers import scaled, sign
from errpipe.terms._place import velocities
from errpipe.terms._slack import AT_STANDSTILL, Slack, gradual_reversal
from errpipe.yamlfile import quantity

ANYWHERE = 0.3  # freedom of the place where it is as simulated: friction that is larger all along is `coulomb_friction`


class FrictionGradient(OfVelocity):
    """Coulomb friction that increases along the axis: a guide tighter at one end, a folding cover.

    Equation   force = growth * sign(v) * (x - middle) / length      [N]
    Assumes    equal in both directions, linear in position; friction at mid-travel as simulated
               (else add `coulomb_friction`)
    Typical    5..200 N from end to end
    Moves      positive growth: the drive pushes harder towards the positive end, whichever way it moves
    Source     preload of guides out of parallel, telescopic covers; Coulomb 1785
    """

    term: Literal["friction_gradient"] = "friction_gradient"
    middle: float = quantity("mm", "Position where the friction is as simulated.")
    length: float = quantity("mm", "Way over which the growth is stated: that of the recording.")
    gains = (Parameter("growth", "N", (5.0, 200.0), (-5000.0, 5000.0), "friction at one end less that at the other"),)
    prior_log_odds = -2.0  # friction that is stronger here than there is mostly there in full
    simulated_log_odds = -4.0

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[FrictionGradient]:
        for axis, column in velocities(recording, component):
            if recording.name("position", axis=axis) is not None:
                x = position(recording, axis)
                low, high = float(np.nanmin(x)), float(np.nanmax(x))
                if high > low:
                    yield cls(axis=axis, column=column, middle=0.5 * (low + high), length=high - low)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.column, position_name(recording, self.axis))

    def _reach(self, x: np.ndarray) -> np.ndarray:
        return (np.asarray(x, dtype=float) - self.middle) / self.length

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return (moving(recording, self.column) * self._reach(position(recording, self.axis)))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        way = moving(recording, self.column)
        yield way, ANYWHERE
        held = direction(recording, self.axis) - way
        yield held * self._reach(position(recording, self.axis)), AT_STANDSTILL
        yield from gradual_reversal(base[:, 0], recording, self.axis)  # bristles bend before they slide

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        return (Lowered(scaled(sign(self.column), parameters["growth"]), self.axis, self._reach),)
