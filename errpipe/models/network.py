"""The physical core alone: bodies, heat while running and hidden parts, gains of known sign averaged over networks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from errpipe.errors import DataError
from errpipe.models._thermal import ThermalFamily
from errpipe.thermal.season_options import SeasonOptions

if TYPE_CHECKING:
    import numpy as np

    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem


class Network(ThermalFamily):
    """Heat sources whose effect has a known sign (`thermal.causes`), without a learnt correction and without fading."""

    family: Literal["network"] = Field("network", description="Model family.")
    options: SeasonOptions = Field(SeasonOptions(), description="Causes and how they are weighed.")

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """One setting; none if no sensor is on the machine."""
        from errpipe.thermal.competition import Entrant
        from errpipe.thermal.season import Problem

        try:
            core = Problem(problem.recording, self.component, self.options, problem.rows, problem.group)
        except DataError:
            return ()
        core.choose_signs()
        middle = core.full_core()

        @cache
        def gains(groups: tuple[int, ...]) -> np.ndarray:
            return core.solve(groups, corrected=False).core

        def parts(groups: tuple[int, ...]) -> Any:
            return tuple((c.name, float(g), c.driver) for c, g in zip(core.causes, gains(groups), strict=True) if g)

        return [Entrant(self.family_name(), "network", lambda groups: middle @ gains(groups), parts, True)]
