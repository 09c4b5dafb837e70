"""A step between the directions that grows with distance from the screw's drive end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import Direction
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, direction_column, position, position_name, response_share, travel
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import is_radial, linear_axes_acting
from errpipe.terms._slack import Slack, of_reversal
from errpipe.yamlfile import quantity


class ScrewWindup(Term):
    """Friction twists and stretches the screw: the reversal error grows with the loaded length of the screw.

    Equation   deviation(d, x) = -step_at_far_end / 2 * d * |x - drive_end| / length
    Assumes    equal friction in both directions; no gap (add `backlash` for the constant part)
    Typical    2..15 um at the far end
    Moves      positive step: approached from below the axis stops short, most of all at the far end
    Source     axial compliance of a screw, force * length / (E A)
    """

    term: Literal["screw_windup"] = "screw_windup"
    axis: Axis
    drive_end: float = quantity("mm", "Position of the screw's drive end.")
    length: float = quantity("mm", "Length of the screw, at whose far end the parameter is stated.")
    radial: Radial = False
    family = "reversal"
    gains = (Parameter("step_at_far_end", "um", (2.0, 15.0), (-200.0, 200.0), "step between directions, far end"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (direction_column(recording, self.axis), position_name(recording, self.axis))

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ScrewWindup]:
        for axis in linear_axes_acting(recording, component):
            if not (recording.names("direction", axis=axis) or recording.names("velocity", axis=axis)):
                continue
            low, high = travel(recording, axis)
            known = recording.manifest.axis(axis)
            ends = (low, high) if known is None or known.drive_end is None else (known.drive_end,)
            for end in ends:
                yield cls(axis=axis, drive_end=end, length=high - low, radial=is_radial(component))

    def _reach(self, x: np.ndarray) -> np.ndarray:
        return np.abs(np.asarray(x, dtype=float) - self.drive_end) / self.length

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        step = -0.5 * direction(recording, self.axis) * self._reach(position(recording, self.axis))
        return (step * response_share(recording, self.axis, self.radial))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        return of_reversal(base[:, 0], recording, self.axis, self.radial)

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        half = -0.5 * parameters["step_at_far_end"]
        return (Lowered(Direction(axis=self.axis), self.axis, lambda x: half * self._reach(x)),)
