"""Minimum of a function of a few variables without its slopes: the simplex search of Nelder and Mead (1965).

Step for step that of scipy.optimize, whose import takes a tenth of a second: every run of a pipeline needs this alone.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

EDGE, EDGE_OF_ZERO = 0.05, 0.00025  # first edges: of a variable that is not zero, and of one that is


def lowest(
    cost: Callable[[np.ndarray], float], start: np.ndarray, *, xatol: float, fatol: float, steps: int
) -> tuple[np.ndarray, float]:
    """The point of least cost that was found, (n,), and its cost.

    Ends where all corners are within `xatol` of the best and their costs within `fatol`, or after `steps` - 1 steps.
    """
    corners = np.tile(np.asarray(start, dtype=float), (len(start) + 1, 1))
    for k, x in enumerate(start):
        corners[k + 1, k] = (1 + EDGE) * x if x != 0 else EDGE_OF_ZERO
    costs = np.array([cost(corner) for corner in corners])
    for _ in range(1, steps):
        corners, costs = _ordered(corners, costs)
        if np.max(np.abs(corners[1:] - corners[0])) <= xatol and np.max(np.abs(costs[0] - costs[1:])) <= fatol:
            break
        corners, costs = _stepped(cost, corners, costs)
    corners, costs = _ordered(corners, costs)
    return corners[0], float(costs[0])


def _ordered(corners: np.ndarray, costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(costs)
    return corners[order], costs[order]


def _stepped(cost, corners: np.ndarray, costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The worst corner reflected, and then stretched, contracted, or all corners drawn towards the best one."""
    middle, worst = np.add.reduce(corners[:-1], 0) / (len(corners) - 1), corners[-1]
    new = 2 * middle - worst
    value = cost(new)
    if value < costs[0]:
        further = 3 * middle - 2 * worst
        if (there := cost(further)) < value:
            new, value = further, there
    elif not value < costs[-2]:
        outside = value < costs[-1]
        limit = value if outside else costs[-1]
        new = 1.5 * middle - 0.5 * worst if outside else 0.5 * middle + 0.5 * worst
        value = cost(new)
        if not (value <= limit if outside else value < limit):
            drawn = np.concatenate([corners[:1], corners[0] + 0.5 * (corners[1:] - corners[0])])
            return drawn, np.array([costs[0], *(cost(corner) for corner in drawn[1:])])
    return np.concatenate([corners[:-1], new[None]]), np.append(costs[:-1], value)
