"""Gains times the rise of every temperature since the start of the run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from errpipe.models._thermal import ThermalFamily, linear

if TYPE_CHECKING:
    import numpy as np

    from errpipe.fitting.thermal_competition import Entrant
    from errpipe.fitting.thermal_linear import LinearProblem

STRENGTHS = (0.0, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # of the ridge, on columns of unit rms; the competition chooses
LEAST_RIDGE = 1e-5  # keeps the normal equations of collinear sensors well conditioned
FREEDOMS = (0.1, 1.0, 10.0)  # of each run's own gains beside the common ones (`thermal_linear.common_gains`)


class Rises(ThermalFamily):
    """Least squares, ridge, and gains that runs share (random effects of each run), on rises."""

    family: Literal["rises"] = Field("rises", description="Model family.")

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Every strength of the ridge, and every freedom of the runs; of one day the mean of sensors taken alone."""
        from errpipe.fitting import thermal_linear as t

        family, width = self.family_name(), problem.plain
        if not width:
            return []

        def ridge(strength: float) -> Entrant:
            def gains(groups: tuple[int, ...]) -> np.ndarray:
                return t.ridge(*problem.stacked(groups, width), strength)

            return linear(family, f"rises, ridge {strength:g}", problem, gains)

        def common(freedom: float) -> Entrant:
            def gains(groups: tuple[int, ...]) -> np.ndarray:
                return t.common_gains([problem.stacked((g,), width) for g in groups], LEAST_RIDGE, freedom)

            return linear(family, f"rises, common to runs {freedom:g}", problem, gains)

        def mean(groups: tuple[int, ...]) -> np.ndarray:
            return t.mean_of_sensors(*problem.stacked(groups, width)[:2])

        name = f"{family}, mean of sensors"
        alone = [linear(name, name, problem, mean)] if problem.one_day else []
        return [*map(ridge, STRENGTHS), *map(common, FREEDOMS), *alone]
