"""Gains times the rises of all temperatures and their lagged rises, sparse (lasso) or shrunk (ridge)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from errpipe.models._thermal import ThermalFamily, linear

if TYPE_CHECKING:
    import numpy as np

    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem

# Shares of the smallest lasso penalty at which all gains are zero; selected by the competition.
LASSO = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
RIDGE = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)  # on columns of unit rms


class Lagged(ThermalFamily):
    """Lasso and ridge on rises and lagged rises; time constants follow from the recording."""

    family: Literal["lagged"] = Field("lagged", description="Model family.")

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """Every setting; the best lasso and the best ridge may join the mixture."""
        from errpipe.thermal import linear as t

        width, family = len(problem.drivers), self.family_name()

        @cache
        def path(groups: tuple[int, ...]) -> np.ndarray:
            return t.lasso_path(*problem.stacked(groups, width), LASSO)

        def lasso(number: int) -> Entrant:
            name = f"lagged, lasso {LASSO[number]:g}"
            return linear(f"{family}, lasso", name, problem, lambda groups: path(groups)[number])

        @cache
        def shrunk(groups: tuple[int, ...]) -> np.ndarray:
            return t.ridge_path(*problem.stacked(groups, width), RIDGE)

        def ridge(number: int) -> Entrant:
            name = f"lagged, ridge {RIDGE[number]:g}"
            return linear(f"{family}, ridge", name, problem, lambda groups: shrunk(groups)[number])

        return [*map(lasso, range(len(LASSO))), *map(ridge, range(len(RIDGE)))]
