"""A small neural network, alone or on the residual of a ridge: few tanh units on rises, lagged rises, and rates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from errpipe.models._thermal import ThermalFamily

if TYPE_CHECKING:
    from errpipe.domain import driver as d
    from errpipe.thermal.competition import Entrant
    from errpipe.thermal.linear import LinearProblem

UNITS = 4  # of the hidden layer; few units limit the extrapolation
# For squared weights, on standardised columns: of a network alone, and of one with a ridge on all lagged rises. Chosen
# on seed 9811 of `trials.thermal` (24 machines): the mixture has 3 % less residual with the second one.
PENALTY, PENALTY_WITH_RIDGE = 0.01, 0.1
RIDGE = 1e-5  # the middle one of the competition's ridges (`lagged`)
LAGS = (0.4, 0.8)  # the recording's time constants used, as shares of their number


class Neural(ThermalFamily):
    """A multilayer perceptron with one hidden layer of tanh units; zero where all temperature rises are zero."""

    family: Literal["neural"] = Field("neural", description="Model family.")
    nonlinear: ClassVar[bool] = True

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """A network alone, and one with a ridge that also uses the rates; none without a temperature."""
        from errpipe.models._perceptron import Layer, entrant
        from errpipe.thermal.linear import rates

        if not problem.plain:
            return []
        name, nodes = self.family_name(), _drivers(problem)
        alone = Layer(nodes, 0.0, UNITS, PENALTY)
        with_ridge = Layer([*nodes, *rates(problem)], 0.0, UNITS, PENALTY_WITH_RIDGE, RIDGE)
        return [
            entrant(name, f"{called}, {UNITS} units", problem, layer)
            for called, layer in ((name, alone), (f"{name} and ridge", with_ridge))
        ]


def _drivers(problem: LinearProblem) -> list[d.Driver]:
    """The rises, and every rise and heat of the spindle through two of the lags."""
    count, heat = problem.plain, problem.heat
    lags = (len(problem.drivers) - heat) // count - 1
    chosen = sorted({min(int(share * lags), lags - 1) for share in LAGS}) if lags > 0 else []
    series = count + heat // max(lags, 1)
    used = [*range(count), *(count + k * lags + lag for k in range(series) for lag in chosen)]
    return [problem.drivers[k] for k in used]
