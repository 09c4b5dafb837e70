"""Gains times the rises of all temperatures and times the same through lags, few of them or all shrunk."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from errpipe.models._thermal import ThermalFamily, linear

if TYPE_CHECKING:
    import numpy as np

    from errpipe.fitting.thermal_competition import Entrant
    from errpipe.fitting.thermal_linear import LinearProblem

LASSO = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)  # shares of the penalty that leaves no gain; the competition chooses
RIDGE = (1e-4, 1e-3, 1e-2, 1e-1)  # on columns of unit rms
COMMON = tuple((f, s) for f in (0.1, 1.0, 10.0) for s in (1e-3, 1e-2, 1e-1))  # freedom of a run, strength of the ridge


class Lagged(ThermalFamily):
    """Lasso, ridge, and gains that runs share, on rises and lagged rises; time constants follow from the recording."""

    family: Literal["lagged"] = Field("lagged", description="Model family.")

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Every setting; lasso, ridge and common gains each send their best into a mixture."""
        from errpipe.fitting import thermal_linear as t

        width, own = len(problem.drivers), self.family_name()

        @cache
        def path(groups: tuple[int, ...]) -> np.ndarray:
            return t.lasso_path(*problem.stacked(groups, width), LASSO)

        out = [
            linear(f"{own}, lasso", f"lagged, lasso {s:g}", problem, lambda g, k=k: path(g)[k])
            for k, s in enumerate(LASSO)
        ]
        out += [
            linear(
                f"{own}, ridge", f"lagged, ridge {s:g}", problem, lambda g, s=s: t.ridge(*problem.stacked(g, width), s)
            )
            for s in RIDGE
        ]
        out += [
            linear(
                f"{own}, common",
                f"lagged, common to runs {f:g}, ridge {s:g}",
                problem,
                lambda g, f=f, s=s: t.common_gains([problem.stacked((k,), width) for k in g], s, f),
            )
            for f, s in COMMON
        ]
        return out
