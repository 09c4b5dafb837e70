"""Gains times the rise of every temperature since the start of the run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from errpipe.models._thermal import ThermalFamily, linear

if TYPE_CHECKING:
    import numpy as np

    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem

STRENGTHS = (0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # of the ridge, on columns of unit rms; selected by the competition
# Sensors per block of one run from which their mean is used before individual gains, which so few blocks cannot
# distinguish. Stretches of a spindle's run (16 sensors): residual of the rest 0.74 um, 1.39 um without; for machines
# of 4 to 6 sensors the mean is worse (165 single days: 0.112 to 0.245 of uncompensated, 0.127 to 0.275 with it).
MANY = 2.0
LEAST_RIDGE = 1e-5  # keeps the normal equations of collinear sensors well conditioned
FREEDOMS = (0.1, 1.0, 10.0)  # of each run's own gains relative to the common ones (`thermal.linear.common_gains`)


class Rises(ThermalFamily):
    """Least squares, ridge, or a random-effects model (one effect per run) on temperature rises."""

    family: Literal["rises"] = Field("rises", description="Model family.")

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Every strength of the ridge, and every freedom of the runs; for one day only the mean of sensors."""
        from errpipe.thermal import linear as t
        from errpipe.thermal.arithmetic import ridge_gains

        family, width = self.family_name(), problem.plain
        if not width:
            return []

        def ridge(strength: float) -> Entrant:
            def gains(groups: tuple[int, ...]) -> np.ndarray:
                return ridge_gains(*problem.stacked(groups, width), strength)

            return linear(family, f"rises, ridge {strength:g}", problem, gains)

        def common(freedom: float) -> Entrant:
            def gains(groups: tuple[int, ...]) -> np.ndarray:
                return t.common_gains([problem.stacked((g,), width) for g in groups], LEAST_RIDGE, freedom)

            return linear(family, f"rises, common to runs {freedom:g}", problem, gains)

        def mean(groups: tuple[int, ...]) -> np.ndarray:
            return t.mean_of_sensors(*problem.stacked(groups, width)[:2])

        name = f"{family}, mean of sensors"
        many = width > MANY * len(problem.groups)
        alone = [replace(linear(name, name, problem, mean), plain=many)] if problem.within_one_day else []
        return [*map(ridge, STRENGTHS), *map(common, FREEDOMS), *alone]
