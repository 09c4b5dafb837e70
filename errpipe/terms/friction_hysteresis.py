"""Builds up over the first tenths of a millimetre after a reversal, then saturates."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import Approach
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, direction_column, position, position_name, response_share, travel
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._slack import Slack, bent, start_states
from errpipe.yamlfile import quantity

OVERRUN = 0.4  # mm by which machines run past a target to approach it from the other side (chosen in 0.1..1),
MAX_OVERRUN_SHARE = 0.005  # and at most this share of the travel, for a stage of a few millimetres cannot

START = 0.4  # freedom of the state in which a session starts, as of lags: with 1 held-out starts are predicted badly


class FrictionHysteresis(Term):
    """Guide and screw deform elastically before they slip: a reversal error that builds up over a short travel.

    Equation   z -> d over the travelled length: dz = (d - z) |dx| / length;  deviation = -lost_motion / 2 * z
    Assumes    the last move was long, or is recorded; no dependence on speed. Where a direction column tells from
               which side a target was approached, `overrun` mm of travel went unrecorded at each change of side
    Typical    1..10 um, length 0.02..0.5 mm
    Moves      positive lost motion: as `backlash`, but soft; the same after long moves
    Source     Dahl 1968 (pre-sliding friction)
    """

    term: Literal["friction_hysteresis"] = "friction_hysteresis"
    axis: Axis
    radial: Radial = False
    overrun: float = quantity("mm", "Travel that the approach has already made when the target is read.", 0.0)
    also_of_positioning = True
    family = "reversal"
    simulated_log_odds = -4.0
    gains = (Parameter("lost_motion", "um", (1.0, 10.0), (-200.0, 200.0), "step between directions, saturated"),)
    searched = (Parameter("length", "mm", (0.02, 0.5), (0.003, 10.0), "travel over which it builds up"),)
    sample = {"axis": "X"}  # all travel is recorded, as a controller sees it

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (direction_column(recording, self.axis), position_name(recording, self.axis))

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[FrictionHysteresis]:
        for axis in axes_acting(recording, component):
            if recording.names("direction", axis=axis) or recording.names("velocity", axis=axis):
                sided = bool(recording.names("direction", axis=axis)) and not is_radial(component)
                low, high = travel(recording, axis) if sided else (0.0, 0.0)
                overrun = min(OVERRUN, MAX_OVERRUN_SHARE * (high - low))
                yield cls(axis=axis, radial=is_radial(component), overrun=overrun)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        if self.overrun:
            run, side = sessions(recording), direction(recording, self.axis)
            z = responses.approach(run, position(recording, self.axis), side, nonlinear[0], self.overrun)
        else:
            z = drive(Approach(axis=self.axis, length=nonlinear[0]), recording)
        return (-0.5 * z * response_share(recording, self.axis, self.radial))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        for factor in (0.3, 3.0):  # contacts slip one after the other: a spread of lengths
            yield self.basis(recording, nonlinear[0] * factor)[:, 0] - base[:, 0], 0.25
        if not self.overrun:  # all travel is recorded, but not the moves before the recording
            travelled = np.r_[0.0, np.cumsum(np.abs(np.diff(position(recording, self.axis))))]
            for decay, freedom in start_states(recording, nonlinear[0], START, START, travelled):
                yield 0.5 * decay * response_share(recording, self.axis, self.radial), freedom
        if not self.radial:
            yield from bent(base[:, 0], position(recording, self.axis))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        (length,) = self.nonlinear_values(parameters)
        half = -0.5 * parameters["lost_motion"]
        return (Lowered(Approach(axis=self.axis, length=length), None, lambda x: np.full(np.shape(x), half)),)
