"""Minimum without derivatives (Nelder and Mead 1965), bit for bit that of scipy.optimize, whose import takes 0.14 s."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

FIRST_STEP, FROM_ZERO = 0.05, 0.00025  # sides of the first simplex: share of each coordinate, and where it is zero


def minimum(
    cost: Callable[[np.ndarray], float], start: Sequence[float], near: float, alike: float, most: int
) -> tuple[np.ndarray, float]:
    """Place and value of a local minimum.

    near, alike: largest difference of the simplex' corners, and of their costs, at the end; most: iterations.
    """
    corners = np.array([start] * (len(start) + 1))
    for k, value in enumerate(start):
        corners[k + 1, k] = (1.0 + FIRST_STEP) * value or FROM_ZERO
    costs = np.array([cost(corner) for corner in corners])
    for _ in range(most):
        order = np.argsort(costs)
        corners, costs = corners[order], costs[order]
        if np.abs(corners[1:] - corners[0]).max() <= near and np.abs(costs[0] - costs[1:]).max() <= alike:
            break
        centre, worst = np.add.reduce(corners[:-1], 0) / len(start), corners[-1]
        new = 2.0 * centre - worst
        at_new = cost(new)
        if at_new < costs[0]:
            beyond = 3.0 * centre - 2.0 * worst
            at_beyond = cost(beyond)
            new, at_new = (beyond, at_beyond) if at_beyond < at_new else (new, at_new)
        elif at_new >= costs[-2]:
            outside = at_new < costs[-1]
            limit = at_new if outside else np.nextafter(costs[-1], -np.inf)
            new = 1.5 * centre - 0.5 * worst if outside else 0.5 * centre + 0.5 * worst
            at_new = cost(new)
            if not at_new <= limit:
                for k in range(1, len(corners)):
                    corners[k] = corners[0] + 0.5 * (corners[k] - corners[0])
                    costs[k] = cost(corners[k])
                continue
        corners[-1], costs[-1] = new, at_new
    best = int(np.argmin(costs))
    return corners[best], float(costs[best])
