"""Variable projection: the linear parameters are solved for exactly, only the few non-linear ones are searched.

The search starts from every promising combination of a coarse sweep, because the sum of squares
over a lag or a period has many local minima.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.fitting.solve import one_thread

STARTS = 12  # values per parameter in the first sweep, over its typical range
SWEEPS = 2  # rounds of one-at-a-time sweeps before the joint search
KEPT_STARTS = 3  # best combinations from which the joint search starts


@dataclass(frozen=True)
class Unknown:
    """A non-linear parameter: bounds, values to start from, and whether it is searched by its logarithm."""

    name: str
    low: float
    high: float
    starts: tuple[float, ...] = ()

    @property
    def logarithmic(self) -> bool:
        return self.low > 0 and self.high / self.low > 3.0

    def trial(self) -> np.ndarray:
        if self.starts:
            return np.clip(np.asarray(self.starts, dtype=float), self.low, self.high)
        spread = np.geomspace if self.logarithmic else np.linspace
        return spread(self.low, self.high, STARTS)

    def to_search_scale(self, value: float) -> float:
        return float(np.log(value)) if self.logarithmic else float(value)

    def from_search_scale(self, value: float) -> float:
        # exp(log(bound)) may end a rounding error outside its bound.
        return float(np.clip(np.exp(value) if self.logarithmic else value, self.low, self.high))


def search(
    moving: Callable[[np.ndarray], np.ndarray],
    still: np.ndarray,
    response: np.ndarray,
    unknowns: Sequence[Unknown],
    begin: np.ndarray | None = None,
) -> np.ndarray:
    """Non-linear parameters of the smallest residual, shape (q,).

    moving: columns that depend on them, (q,) -> (n, k); still: the other columns, (n, p), which are projected
    out once; response: (n,). Weights and penalty rows are already included by the caller. begin: start values
    instead of sweeping.
    """
    from scipy.optimize import least_squares  # 0.14 s, which models without such parameters do not need

    with one_thread():
        basis = _orthonormal(still)
        unexplained = _orthogonal_to(basis, response[:, None])[:, 0]

        def residual(inner: np.ndarray) -> np.ndarray:
            outer = np.array([u.from_search_scale(v) for u, v in zip(unknowns, inner, strict=True)])
            columns = moving(outer)
            if not np.isfinite(columns).all():  # the term is undefined here on these rows
                return unexplained
            columns = _orthogonal_to(basis, columns)
            return unexplained - columns @ _coefficients(columns, unexplained)

        starts = _sweep(residual, unknowns) if begin is None else [begin]
        lower = np.array([u.to_search_scale(u.low) for u in unknowns])
        upper = np.array([u.to_search_scale(u.high) for u in unknowns])
        best, least = np.empty(0), np.inf
        for start in starts:
            inside = np.clip([u.to_search_scale(v) for u, v in zip(unknowns, start, strict=True)], lower, upper)
            step = 1e-6 * np.maximum(upper - lower, 1e-9)
            inside = np.clip(inside, lower + step, upper - step)
            optimum = least_squares(residual, inside, bounds=(lower, upper), x_scale="jac", xtol=1e-10, ftol=1e-12)
            if optimum.cost < least:
                best, least = optimum.x, optimum.cost
    return np.array([u.from_search_scale(v) for u, v in zip(unknowns, best, strict=True)])


def _sweep(residual: Callable[[np.ndarray], np.ndarray], unknowns: Sequence[Unknown]) -> list[np.ndarray]:
    """Starting points: one parameter at a time over its trial values, the others fixed, from several midpoints."""

    def cost(outer: np.ndarray) -> float:
        e = residual(np.array([u.to_search_scale(v) for u, v in zip(unknowns, outer, strict=True)]))
        return float(e @ e)

    trials = [u.trial() for u in unknowns]
    if len(unknowns) == 1:
        costs = [cost(np.array([v])) for v in trials[0]]
        return [np.array([trials[0][k]]) for k in np.argsort(costs, kind="stable")[:KEPT_STARTS]]
    ends: dict[tuple[float, ...], float] = {}
    for quantile in (0.25, 0.5, 0.75):
        current = np.array([v[int(quantile * (v.size - 1))] for v in trials])
        for _ in range(SWEEPS):
            for j, values in enumerate(trials):
                costs = [cost(np.r_[current[:j], v, current[j + 1 :]]) for v in values]
                current[j] = values[int(np.argmin(costs))]
        ends[tuple(current)] = cost(current)
    return [np.array(k) for k in sorted(ends, key=lambda k: ends[k])[:KEPT_STARTS]]


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    if columns.shape[1] == 0:
        return columns
    length = np.sqrt(np.sum(columns**2, axis=0))
    u, s, _ = np.linalg.svd(columns / np.where(length > 0, length, 1.0), full_matrices=False)
    return u[:, s > 1e-10 * s.max(initial=0.0)]


def _orthogonal_to(basis: np.ndarray, columns: np.ndarray) -> np.ndarray:
    return columns - basis @ (basis.T @ columns) if basis.shape[1] else columns


def _coefficients(columns: np.ndarray, response: np.ndarray) -> np.ndarray:
    length = np.sqrt(np.sum(columns**2, axis=0))
    length[length == 0] = 1.0
    return np.linalg.lstsq(columns / length, response, rcond=1e-10)[0] / length
