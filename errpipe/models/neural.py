"""A small neural network, alone or on what a ridge leaves: few tanh units on rises and on rises through two lags."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from errpipe.models._thermal import ThermalFamily

if TYPE_CHECKING:
    import numpy as np

    from errpipe.domain import driver as d
    from errpipe.fitting.thermal_competition import Entrant
    from errpipe.fitting.thermal_linear import LinearProblem

UNITS = 4  # of the hidden layer; a network of few units extrapolates by few bends
# Of squared weights, on standardised columns: of a network alone, and of one beside a ridge on all lagged rises. Chosen
# on seed 9811 of `trials.thermal` (24 machines): the mixture leaves 3 % less with the second one.
PENALTY, PENALTY_BESIDE = 0.01, 0.1
RIDGE = 1e-5  # the middle one of the ridges that the competition tries (`lagged`)
MOST_ROWS = 1500  # training rows, evenly thinned: neighbours are correlated
MOST_STEPS = 150  # iterations of L-BFGS (early stopping): more fit the noise
REACH, STEPS = 4.0, 65  # the table of tanh ends where it is 0.9993; linear between its points it is within 0.0015
LAGS = (0.4, 0.8)  # which of the recording's time constants, as a share of their number


class Neural(ThermalFamily):
    """A multilayer perceptron of one hidden layer with tanh, zero where nothing has warmed up."""

    family: Literal["neural"] = Field("neural", description="Model family.")

    def entrants(self, problem: LinearProblem) -> Sequence[Entrant]:
        """A network alone, and one beside a ridge; both may join the mixture."""
        return [_entrant(self.family_name(), problem, beside) for beside in (False, True)]


def _entrant(family: str, problem: LinearProblem, beside: bool) -> Entrant:
    import numpy as np

    from errpipe.fitting import thermal_linear
    from errpipe.fitting.thermal_competition import Entrant

    used, width = _columns(problem), len(problem.drivers)
    values = problem.values[:, used]
    size = np.sqrt(np.mean(values[problem.rows] ** 2, axis=0))
    size[size == 0] = 1.0

    @cache
    def gains(groups: tuple[int, ...]) -> np.ndarray:
        return thermal_linear.ridge(*problem.stacked(groups, width), RIDGE) if beside else np.zeros(width)

    @cache
    def net(groups: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = np.flatnonzero(problem.rows & np.isin(problem.group, groups))
        rows = rows[:: max(1, rows.size // MOST_ROWS)]
        left = problem.response[rows] - problem.values[rows] @ gains(groups)
        return _trained(values[rows] / size, left, PENALTY_BESIDE if beside else PENALTY)

    def predict(groups: tuple[int, ...]) -> np.ndarray:
        inner, bias, outer = net(groups)
        return problem.values @ gains(groups) + (np.tanh(values / size @ inner + bias) - np.tanh(bias)) @ outer

    def linear(groups: tuple[int, ...]) -> Any:  # the units differ from fit to fit
        return tuple(("ridge", float(g), node) for g, node in zip(gains(groups), problem.drivers, strict=True) if g)

    def parts(groups: tuple[int, ...]) -> Any:
        inner, bias, outer = net(groups)
        nodes = [problem.drivers[k] for k in used]
        units = [_unit(nodes, weights / size, float(b)) for weights, b in zip(inner.T, bias, strict=True)]
        named = tuple((f"unit {k + 1}", float(g), unit) for k, (g, unit) in enumerate(zip(outer, units, strict=True)))
        return linear(groups) + named

    name = f"{family} beside ridge" if beside else family
    return Entrant(name, f"{name}, {UNITS} units", predict, parts, linear=linear)


def _columns(problem: LinearProblem) -> list[int]:
    """Numbers of the rises, and of every rise and heat of the spindle through two of the lags."""
    count, heat = problem.plain, problem.heat
    lags = (len(problem.drivers) - heat) // count - 1
    chosen = sorted({min(int(share * lags), lags - 1) for share in LAGS}) if lags > 0 else []
    series = count + heat // max(lags, 1)
    return [*range(count), *(count + k * lags + lag for k in range(series) for lag in chosen)]


def _trained(x: np.ndarray, y: np.ndarray, penalty: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (columns, units), biases (units,), outer weights (units,), um. x: (rows, columns); y: (rows,), um."""
    import numpy as np
    from sklearn.neural_network import MLPRegressor

    scale = float(np.sqrt(np.mean(y**2))) or 1.0
    net = MLPRegressor(
        hidden_layer_sizes=(UNITS,),
        activation="tanh",
        solver="lbfgs",
        alpha=penalty,
        max_iter=MOST_STEPS,
        random_state=0,
        tol=1e-5,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # reaching MOST_STEPS is intended
        net.fit(x, y / scale)
    return net.coefs_[0], net.intercepts_[0], net.coefs_[1][:, 0] * scale


def _unit(nodes: Sequence[d.Driver], weights: np.ndarray, bias: float) -> d.Driver:
    """tanh(weights . nodes + bias) - tanh(bias) as a table of tanh, held at its ends."""
    import numpy as np

    from errpipe.domain import driver as d

    grid = np.linspace(-REACH, REACH, STEPS)
    inside = d.Affine(offset=bias, weights=tuple(map(float, weights)), of=tuple(nodes))
    table = np.tanh(grid)
    bent = d.Lookup(of=inside, start=-REACH, step=float(grid[1] - grid[0]), values=tuple(map(float, table)))
    return d.Affine(offset=-float(np.interp(bias, grid, table)), weights=(1.0,), of=(bent,))
