"""Least value of a function of few variables by a simplex that walks downhill: Nelder and Mead 1965.

Step for step what scipy.optimize.minimize(method="Nelder-Mead") does, so that the least values are the same bits,
without the import of scipy.optimize, which takes longer than most fits.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

FIRST_STEP, STEP_FROM_ZERO = 0.05, 0.00025  # of the first simplex: relative, and where a variable is zero


def minimise(
    cost: Callable[[np.ndarray], float], begin: np.ndarray, x_step: float, cost_step: float, steps: int
) -> tuple[np.ndarray, float]:
    """(variables, shape (n,); cost) at the lowest corner, in the units of `begin` and of `cost`.

    Ends where the corners lie within `x_step` and their costs within `cost_step` of the lowest, or after `steps`.
    """
    corners = np.vstack([begin, np.where(np.eye(begin.size, dtype=bool), _stepped(begin), begin)])
    corners, costs = _sorted(corners, np.array([cost(corner) for corner in corners]))
    for _ in range(steps - 1):
        if np.abs(corners[1:] - corners[0]).max() <= x_step and np.abs(costs[0] - costs[1:]).max() <= cost_step:
            break
        _step(cost, corners, costs)
        corners, costs = _sorted(corners, costs)
    return corners[0], float(costs[0])


def _stepped(begin: np.ndarray) -> np.ndarray:
    return np.where(begin != 0.0, (1.0 + FIRST_STEP) * begin, STEP_FROM_ZERO)


def _sorted(corners: np.ndarray, costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(costs)
    return corners[order], costs[order]


def _step(cost: Callable[[np.ndarray], float], corners: np.ndarray, costs: np.ndarray) -> None:
    """Replace the highest corner by one beyond or before the centre of the others, or draw all to the lowest."""
    worst, centre = corners[-1], np.add.reduce(corners[:-1], 0) / (len(corners) - 1)
    reflected = 2.0 * centre - worst
    at_reflected = cost(reflected)
    if at_reflected < costs[0]:
        further = 3.0 * centre - 2.0 * worst
        at_further = cost(further)
        better = at_further < at_reflected
        corners[-1], costs[-1] = (further, at_further) if better else (reflected, at_reflected)
        return
    if at_reflected < costs[-2]:
        corners[-1], costs[-1] = reflected, at_reflected
        return
    outside = at_reflected < costs[-1]
    nearer = 1.5 * centre - 0.5 * worst if outside else 0.5 * centre + 0.5 * worst
    at_nearer = cost(nearer)
    if at_nearer <= at_reflected if outside else at_nearer < costs[-1]:
        corners[-1], costs[-1] = nearer, at_nearer
        return
    for k in range(1, len(corners)):
        corners[k] = corners[0] + 0.5 * (corners[k] - corners[0])
        costs[k] = cost(corners[k])
