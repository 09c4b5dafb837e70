"""A small neural network, alone or on what a ridge leaves: few tanh units on rises, lagged rises, and rates."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

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
        """A network alone, and one beside a ridge that knows the rates too; both may join the mixture."""
        return [_entrant(self.family_name(), problem, beside, self.datum_rows) for beside in (False, True)]


def _entrant(family: str, problem: LinearProblem, beside: bool, datum_rows: int) -> Entrant:
    import numpy as np

    from errpipe.fitting import thermal_linear
    from errpipe.fitting.thermal_causes import columns
    from errpipe.fitting.thermal_competition import Entrant

    width, run = len(problem.drivers), problem.recording.run_codes()
    nodes = [*_drivers(problem), *(thermal_linear.rates(problem) if beside else ())]
    values = np.nan_to_num(columns(problem.recording, nodes))
    size = np.sqrt(np.mean(values[problem.rows] ** 2, axis=0))
    size[size == 0] = 1.0
    start = _Start.of(run, datum_rows, np.isfinite(problem.response))

    @cache
    def gains(groups: tuple[int, ...]) -> np.ndarray:
        return thermal_linear.ridge(*problem.stacked(groups, width), RIDGE) if beside else np.zeros(width)

    @cache
    def net(groups: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = np.flatnonzero(problem.rows & np.isin(problem.group, groups))
        rows = rows[:: max(1, rows.size // MOST_ROWS)]
        left = problem.response[rows] - problem.values[rows] @ gains(groups)
        return _trained(values / size, start, rows, left, PENALTY_BESIDE if beside else PENALTY)

    def predict(groups: tuple[int, ...]) -> np.ndarray:
        inner, bias, outer = net(groups)
        return problem.values @ gains(groups) + start.centred(np.tanh(values / size @ inner + bias) @ outer)

    def linear(groups: tuple[int, ...]) -> Any:  # the units differ from fit to fit
        return tuple(("ridge", float(g), node) for g, node in zip(gains(groups), problem.drivers, strict=True) if g)

    def parts(groups: tuple[int, ...]) -> Any:
        inner, bias, outer = net(groups)
        units = [_unit(nodes, weights / size, float(b)) for weights, b in zip(inner.T, bias, strict=True)]
        named = tuple((f"unit {k + 1}", float(g), unit) for k, (g, unit) in enumerate(zip(outer, units, strict=True)))
        return linear(groups) + named

    name = f"{family} beside ridge" if beside else family
    return Entrant(name, f"{name}, {UNITS} units", predict, parts, linear=linear)


def _drivers(problem: LinearProblem) -> list[d.Driver]:
    """The rises, and every rise and heat of the spindle through two of the lags."""
    count, heat = problem.plain, problem.heat
    lags = (len(problem.drivers) - heat) // count - 1
    chosen = sorted({min(int(share * lags), lags - 1) for share in LAGS}) if lags > 0 else []
    series = count + heat // max(lags, 1)
    used = [*range(count), *(count + k * lags + lag for k in range(series) for lag in chosen)]
    return [problem.drivers[k] for k in used]


class _Start(NamedTuple):
    """First measured rows of every run, whose mean is its zero: their numbers, mean (runs, first), run of each row.

    A bent function of inputs that count from the start is not zero in the mean of the first rows. A net that was
    trained as if it were, was off by up to 12 um where a machine warms quickly (`trials.thermal`, seed 7301).
    """

    first: np.ndarray
    mean: np.ndarray
    run: np.ndarray

    @classmethod
    def of(cls, run: np.ndarray, rows: int, measured: np.ndarray) -> _Start:
        import numpy as np

        codes, number = np.unique(run, return_inverse=True)
        whole = [np.flatnonzero(number == k) for k in range(codes.size)]
        own = [k[measured[k]][:rows] if measured[k].any() else k[:rows] for k in whole]
        mean = np.zeros((codes.size, sum(o.size for o in own)))
        mean[np.repeat(np.arange(codes.size), [o.size for o in own]), np.arange(mean.shape[1])] = 1.0
        return cls(np.concatenate(own), mean / mean.sum(axis=1, keepdims=True), number)

    def centred(self, values: np.ndarray) -> np.ndarray:
        """Values of every row less the mean of the first rows of its run, (rows,)."""
        return values - (self.mean @ values[self.first])[self.run]


def _trained(
    x: np.ndarray, start: _Start, rows: np.ndarray, y: np.ndarray, penalty: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (columns, units), biases (units,), outer weights (units,), um.

    x: (all rows, columns), unit rms; rows: numbers of those to learn from; y: (rows,), um, since the start of the run.
    """
    import numpy as np
    from scipy.optimize import minimize

    scale = float(np.sqrt(np.mean(y**2))) or 1.0
    right, run, width = y / scale, start.run[rows], x.shape[1]
    both = x[np.r_[rows, start.first]]  # training rows, then those that are the zeros

    def unpacked(w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return w[: width * UNITS].reshape(width, UNITS), w[width * UNITS : -UNITS], w[-UNITS:]

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        inner, bias, outer = unpacked(w)
        hidden = np.tanh(both @ inner + bias)
        value = hidden @ outer
        left = value[: rows.size] - (start.mean @ value[rows.size :])[run] - right
        slope = np.r_[left, -start.mean.T @ np.bincount(run, left, start.mean.shape[0])]
        inside = np.outer(slope, outer) * (1.0 - hidden**2)
        decay = np.r_[inner.ravel(), np.zeros(UNITS), outer] * penalty
        by_weight = np.r_[(both.T @ inside).ravel(), inside.sum(axis=0), hidden.T @ slope] + decay
        return float(left @ left + decay @ w) / (2 * rows.size), by_weight / rows.size

    reach = np.sqrt(6.0 / np.r_[np.full((width + 1) * UNITS, width + UNITS), np.full(UNITS, UNITS + 1)])  # Glorot 2010
    first = np.random.default_rng(0).uniform(-reach, reach)
    inner, bias, outer = unpacked(
        minimize(loss, first, jac=True, method="L-BFGS-B", options={"maxiter": MOST_STEPS, "ftol": 1e-7}).x
    )
    return inner, bias, outer * scale


def _unit(nodes: Sequence[d.Driver], weights: np.ndarray, bias: float) -> d.Driver:
    """tanh(weights . nodes + bias) - tanh(bias) as a table of tanh, held at its ends."""
    import numpy as np

    from errpipe.domain import driver as d

    grid = np.linspace(-REACH, REACH, STEPS)
    inside = d.Affine(offset=bias, weights=tuple(map(float, weights)), of=tuple(nodes))
    table = np.tanh(grid)
    bent = d.Lookup(of=inside, start=-REACH, step=float(grid[1] - grid[0]), values=tuple(map(float, table)))
    return d.Affine(offset=-float(np.interp(bias, grid, table)), weights=(1.0,), of=(bent,))
