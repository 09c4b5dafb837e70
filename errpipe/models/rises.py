"""Gains times the rise of every temperature since the start of the run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from errpipe.models._thermal import ThermalFamily, linear

if TYPE_CHECKING:
    from errpipe.fitting.thermal_competition import Entrant
    from errpipe.fitting.thermal_linear import LinearProblem

STRENGTHS = (0.0, 1e-4, 1e-3, 1e-2, 1e-1)  # of the ridge, on columns of unit rms; the competition chooses
FREEDOMS = (0.1, 1.0, 10.0)  # of each run's own gains beside the common ones (`thermal_linear.common_gains`)


class Rises(ThermalFamily):
    """Least squares, ridge, and gains that runs share (random effects of each run), on rises."""

    family: Literal["rises"] = Field("rises", description="Model family.")

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Every strength of the ridge, and every freedom of the runs."""
        from errpipe.fitting import thermal_linear as t

        own, width = self.family_name(), problem.plain
        out = [
            linear(own, f"rises, ridge {s:g}", problem, lambda g, s=s: t.ridge(*problem.stacked(g, width), s))
            for s in STRENGTHS
        ]
        for f in FREEDOMS:
            name = f"rises, common to runs {f:g}"
            out.append(linear(own, name, problem, lambda g, f=f: t.common_gains(_each(problem, g, width), 1e-5, f)))
        return out


def _each(problem: LinearProblem, groups: Sequence[int], width: int) -> list:
    return [problem.stacked((g,), width) for g in groups]
