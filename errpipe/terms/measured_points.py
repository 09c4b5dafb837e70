"""What was measured, target by target, in both directions; between targets a straight line and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import ONE, Direction, Driver
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, position, position_name
from errpipe.errors import DataError
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis
from errpipe.yamlfile import quantity

SAME_TARGET = 1e-3  # of the span: positions closer than this are readings of one target (0.5 mm on 500 mm)
WIDEST = 2.0  # of that distance: readings of one target; more are several, each near the next
MAX_TARGETS = 400  # more places than any list of targets has: a log; `smooth_curve` fits one


class MeasuredPoints(Term):
    """A value for each target and, if both directions were measured, half of the reversal error.

    Equation   deviation(x, d) = sum (p_k + d * r_k) * hat_k(x),  d = +1 or -1; hat_k: 1 at target k, 0 at the others
    Assumes    straight between targets, held beyond the first and last; the same at every temperature. What lies
               between two targets (a pitch error of the screw) is not seen
    Typical    p 1..50 um, r 1..10 um
    Moves      where p is positive the axis travels too far; negative r: approached from below it stops short
    Source     ISO 230-2:2014, 3.8 and 3.9 (mean unidirectional deviation at a position), as least squares over the runs
    """

    term: Literal["measured_points"] = "measured_points"
    axis: Axis
    targets: tuple[float, ...] | None = quantity("mm", "Ascending; where not given, those measured.", None)
    both: tuple[float, ...] | None = quantity(
        "mm", "Targets measured in both directions; where not given, those that were. Empty: one direction.", None
    )
    sample = {"axis": "X", "targets": (0.0, 100.0, 250.0, 400.0), "both": (0.0, 100.0, 250.0, 400.0)}

    def settled(self, recording: Recording) -> MeasuredPoints:
        """The term with its targets written down. Raises DataError if positions are no list of targets."""
        x = position(recording, self.axis)
        if self.targets is not None and self.both is not None:
            return self
        targets = self.targets or _targets(x, self.axis)
        both = self.both
        if both is None:
            nearest = np.argmin(np.abs(x[:, None] - np.array(targets)), axis=1)
            measured = recording.name("direction", axis=self.axis) is not None
            side = direction(recording, self.axis) if measured else np.ones(x.size)
            sides = [set(side[(nearest == k) & np.isfinite(x)].tolist()) >= {-1.0, 1.0} for k in range(len(targets))]
            both = tuple(t for t, in_both in zip(targets, sides, strict=True) if in_both)
        return self.model_copy(update={"targets": targets, "both": both})

    def linear(self) -> tuple[Parameter, ...]:
        means = [Parameter(f"p{k}", "um", (1.0, 50.0)) for k in range(len(self.targets or ()))]
        halves = [Parameter(f"r{k}", "um", (1.0, 10.0)) for k in range(len(self.both or ()))]
        return (*means, *halves)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        place, side = position_name(recording, self.axis), recording.name("direction", axis=self.axis)
        return (place,) if side is None or self.both == () else (place, side)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        x = position(recording, self.axis)
        means = _hats(x, self.targets or ())
        if not self.both:
            return means
        return np.hstack([means, direction(recording, self.axis)[:, None] * _hats(x, self.both)])

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        targets = self.targets or ()

        def part(driver: Driver, nodes: tuple[float, ...], letter: str) -> Lowered:
            values = np.array([parameters[f"{letter}{k}"] for k in range(len(nodes))])
            return Lowered(driver, self.axis, lambda x: np.interp(x, nodes, values), nodes=targets)

        means = part(ONE, targets, "p")
        return (means, part(Direction(axis=self.axis), self.both, "r")) if self.both else (means,)

    def sentence(self, parameters: Mapping[str, float]) -> str:
        targets = self.targets or ()
        p = [parameters[f"p{k}"] for k in range(len(targets))]
        span = f"{self.axis} from {targets[0]:g} to {targets[-1]:g}"
        text = f"{len(targets)} targets of {span}: {min(p):.4g} to {max(p):.4g} um"
        if self.both:
            gap = -2.0 * float(np.mean([parameters[f"r{k}"] for k in range(len(self.both))]))
            text += f", lost motion {gap:.4g} um on average"
        return text


def _targets(x: np.ndarray, axis: str) -> tuple[float, ...]:
    """The places at which readings gather. Raises DataError if there are too many of them or fewer than two."""
    sorted_x = np.sort(x[np.isfinite(x)])
    if sorted_x.size == 0 or sorted_x[-1] == sorted_x[0]:
        raise DataError(
            f"measured_points: all readings are at one position of {axis} (at least two targets are needed)"
        )
    near = SAME_TARGET * (sorted_x[-1] - sorted_x[0])
    starts = np.flatnonzero(np.r_[True, np.diff(sorted_x) > near])
    groups = np.split(sorted_x, starts[1:])
    wide = next((g for g in groups if g[-1] - g[0] > WIDEST * near), None)
    if wide is not None:
        raise DataError(
            f"measured_points: readings from {wide[0]:g} to {wide[-1]:g} of {axis} follow each other within {near:g} "
            f"(a thousandth of the span): no list of targets (at most {MAX_TARGETS}); smooth_curve fits a curve "
            "through them"
        )
    if len(groups) > MAX_TARGETS or 2 * len(groups) > sorted_x.size:
        raise DataError(
            f"measured_points: {sorted_x.size} readings at {len(groups)} places of {axis} are no list of targets (at "
            f"most {MAX_TARGETS}, each measured at least twice); smooth_curve fits a curve through them"
        )
    return tuple(float(np.round(np.median(g), 4)) for g in groups)


def _hats(x: np.ndarray, nodes: tuple[float, ...]) -> np.ndarray:
    """One column per node: 1 there, 0 at the others, straight between, held beyond the ends. NaN where x is."""
    unit = np.eye(len(nodes))
    return np.stack([np.interp(x, nodes, column) for column in unit], axis=1) + 0.0 * x[:, None]
