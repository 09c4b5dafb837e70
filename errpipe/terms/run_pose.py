"""Every workpiece lies a little shifted and turned on the measuring machine: set-up, not machine."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import position
from errpipe.terms._base import Parameter
from errpipe.terms._driven import PerRun

UM_PER_URAD_MM = 1e-3


class RunPose(PerRun):
    """Shift and rotation in a plane per run, shared by both deviations. A nuisance: never compensated.

    Equation   E_X = shift_X - rotation * y,  E_Y = shift_Y + rotation * x      [um] = [urad] * [mm] * 1e-3
    Assumes    small angles; squareness remains an error of the machine, because a rotation affects both axes alike
    Typical    200 um, 100 urad
    Moves      positive rotation: the workpiece is turned counter-clockwise seen from +Z
    Source     rigid-body motion in a plane
    """

    term: Literal["run_pose"] = "run_pose"
    axes: tuple[str, str] = Field(("X", "Y"), description="The two axes of the plane.")

    def linear(self) -> tuple[Parameter, ...]:
        first, second = self.axes
        return tuple(
            Parameter(f"{what}_{run}", unit, typical, meaning=f"{what} of run {run}")
            for run in self.runs
            for what, unit, typical in (
                (f"shift_{first}", "um", (0.0, 300.0)),
                (f"shift_{second}", "um", (0.0, 300.0)),
                ("rotation", "urad", (0.0, 200.0)),
            )
        )

    def shared(self, recording: Recording, component: str, *nonlinear: float) -> np.ndarray:
        """Design columns for one of the two components, shape (rows, 3 per run)."""
        first, second = self.axes
        is_first = component[-1] == first
        lever = (
            position(recording, second) * -UM_PER_URAD_MM if is_first else position(recording, first) * UM_PER_URAD_MM
        )
        columns = np.column_stack(
            [np.full(len(recording), float(is_first)), np.full(len(recording), float(not is_first)), lever]
        )
        return np.hstack([columns * run[:, None] for run in self.in_run(recording).T])
