"""A layer of tanh units: trained on deviations since the start of each run, and as nodes of a table."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from errpipe.domain import driver as d
from errpipe.thermal.arithmetic import ridge_gains
from errpipe.thermal.causes import columns
from errpipe.thermal.competition import Entrant
from errpipe.thermal.linear import LinearProblem

MOST_ROWS = 1500  # training rows, evenly thinned: neighbours are correlated
MOST_STEPS = 150  # iterations of L-BFGS (early stopping): more fit the noise
REACH, STEPS = 4.0, 65  # the table of tanh ends at 0.9993; its linear interpolation is within 0.0015


class Start(NamedTuple):
    """First measured rows of every run, whose mean is its zero: their numbers, mean (runs, first), run of each row.

    A non-linear function of inputs that count from the start is not zero in the mean of the first rows. A network
    trained as if it were had errors of up to 12 um on a machine that warms quickly (`trials.thermal`, seed 7301).
    """

    first: np.ndarray
    mean: np.ndarray
    run: np.ndarray

    @classmethod
    def of(cls, run: np.ndarray, rows: int, measured: np.ndarray) -> Start:
        codes, number = np.unique(run, return_inverse=True)
        whole = [np.flatnonzero(number == k) for k in range(codes.size)]
        own = [k[measured[k]][:rows] if measured[k].any() else k[:rows] for k in whole]
        mean = np.zeros((codes.size, sum(o.size for o in own)))
        mean[np.repeat(np.arange(codes.size), [o.size for o in own]), np.arange(mean.shape[1])] = 1.0
        return cls(np.concatenate(own), mean / mean.sum(axis=1, keepdims=True), number)

    def centred(self, values: np.ndarray) -> np.ndarray:
        """Values of every row minus the mean of the first rows of its run, (rows,)."""
        return values - (self.mean @ values[self.first])[self.run]


class Layer(NamedTuple):
    """nodes: inputs of the layer; centre: subtracted from each, (nodes,); units: their number; penalty: of squared
    weights, on inputs of unit rms; ridge: of an additional linear model on all drivers of the problem, None: without.
    """

    nodes: Sequence[d.Driver]
    centre: np.ndarray | float
    units: int
    penalty: float
    ridge: float | None = None


def entrant(family: str, name: str, problem: LinearProblem, layer: Layer) -> Entrant:
    """The layer, trained on the rows of groups, as one setting of a family in a competition."""
    width = len(problem.drivers)
    values = np.nan_to_num(columns(problem.recording, layer.nodes) - layer.centre)
    size = np.sqrt(np.mean(values[problem.rows] ** 2, axis=0))
    size[size == 0] = 1.0
    start = Start.of(problem.recording.run_codes(), problem.datum_rows, np.isfinite(problem.response))

    @cache
    def gains(groups: tuple[int, ...]) -> np.ndarray:
        if layer.ridge is None:
            return np.zeros(width)
        return ridge_gains(*problem.stacked(groups, width), layer.ridge)

    @cache
    def net(groups: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = np.flatnonzero(problem.rows & np.isin(problem.group, groups))
        rows = rows[:: max(1, rows.size // MOST_ROWS)]
        left = problem.response[rows] - problem.values[rows] @ gains(groups)
        return _trained(values / size, start, rows, left, layer.units, layer.penalty)

    def bent(groups: tuple[int, ...]) -> np.ndarray:
        inner, bias, outer = net(groups)
        return np.asarray(np.tanh(values / size @ inner + bias) @ outer)

    def predict(groups: tuple[int, ...]) -> np.ndarray:
        return problem.values @ gains(groups) + start.centred(bent(groups))

    def linear(groups: tuple[int, ...]) -> Any:  # the units differ from fit to fit
        return tuple(("ridge", float(g), node) for g, node in zip(gains(groups), problem.drivers, strict=True) if g)

    def parts(groups: tuple[int, ...]) -> Any:
        inner, bias, outer = net(groups)
        weights = inner.T / size
        at_zero = bias - weights @ np.broadcast_to(layer.centre, size.shape)
        units = [_unit(layer.nodes, w, float(z)) for w, z in zip(weights, at_zero, strict=True)]
        named = [(f"unit {k + 1}", float(g), node) for k, (g, node) in enumerate(zip(outer, units, strict=True))]
        if np.any(layer.centre):  # the inputs are not all zero at the start of a run
            start_value = (start.mean @ bent(groups)[start.first]).mean() - np.tanh(at_zero) @ outer
            named.append(("start", -float(start_value), d.Constant(value=1.0)))
        return (*linear(groups), *named)

    return Entrant(family, name, predict, parts, linear=linear)


def _trained(
    x: np.ndarray, start: Start, rows: np.ndarray, y: np.ndarray, units: int, penalty: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (columns, units), biases (units,), outer weights (units,), um.

    x: (all rows, columns), unit rms; rows: numbers of the training rows; y: (rows,), um, since the start of the run;
    penalty: of squared weights.
    """
    scale = float(np.sqrt(np.mean(y**2))) or 1.0
    right, run, width = y / scale, start.run[rows], x.shape[1]
    both = x[np.r_[rows, start.first]]  # training rows, then those that define the zeros

    def unpacked(w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return w[: width * units].reshape(width, units), w[width * units : -units], w[-units:]

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        inner, bias, outer = unpacked(w)
        hidden = np.tanh(both @ inner + bias)
        value = hidden @ outer
        left = value[: rows.size] - (start.mean @ value[rows.size :])[run] - right
        slope = np.r_[left, -start.mean.T @ np.bincount(run, left, start.mean.shape[0])]
        inside = np.outer(slope, outer) * (1.0 - hidden**2)
        decay = np.r_[inner.ravel(), np.zeros(units), outer] * penalty
        by_weight = np.r_[(both.T @ inside).ravel(), inside.sum(axis=0), hidden.T @ slope] + decay
        return float(left @ left + decay @ w) / (2 * rows.size), by_weight / rows.size

    reach = np.sqrt(6.0 / np.r_[np.full((width + 1) * units, width + units), np.full(units, units + 1)])  # Glorot 2010
    first = np.random.default_rng(0).uniform(-reach, reach)
    inner, bias, outer = unpacked(
        minimize(loss, first, jac=True, method="L-BFGS-B", options={"maxiter": MOST_STEPS, "ftol": 1e-7}).x
    )
    return inner, bias, outer * scale


def _unit(nodes: Sequence[d.Driver], weights: np.ndarray, bias: float) -> d.Driver:
    """tanh(weights . nodes + bias) - tanh(bias) as a table of tanh, held at its ends."""
    grid = np.linspace(-REACH, REACH, STEPS)
    inside = d.Affine(offset=bias, weights=tuple(map(float, weights)), of=tuple(nodes))
    table = np.tanh(grid)
    bent = d.Lookup(of=inside, start=-REACH, step=float(grid[1] - grid[0]), values=tuple(map(float, table)))
    return d.Affine(offset=-float(np.interp(bias, grid, table)), weights=(1.0,), of=(bent,))
