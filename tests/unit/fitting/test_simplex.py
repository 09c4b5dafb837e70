"""The simplex search against scipy's, bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from errpipe.fitting.simplex import lowest

COSTS = {
    "valley": lambda v: float(100.0 * (v[1] - v[0] ** 2) ** 2 + (1.0 - v[0]) ** 2),
    "kink": lambda v: float(np.abs(v[0] - 0.3) + 3.0 * np.abs(v[1] + v[0])),
    "waves": lambda v: float(np.sin(5.0 * v[0]) * np.cos(3.0 * v[1]) + 0.1 * v @ v),
    "step": lambda v: float(np.floor(3.0 * v[0]) + np.floor(v[1] ** 2)),
    "unknown": lambda v: float("nan") if v[0] > 1.0 else float(v @ v),
}


@pytest.mark.parametrize("name", COSTS)
def test_the_same_point_as_scipy_finds(name: str) -> None:
    rng = np.random.default_rng(0)
    for k in range(40):
        start = rng.normal(0.0, 2.0, 2) * (k % 5 != 0 or np.array([0.0, 1.0]))
        cost, steps = COSTS[name], (80, 12)[k % 2]
        options = {"xatol": 0.02, "fatol": 1e-3, "maxiter": steps}
        reference = minimize(cost, start, method="Nelder-Mead", options=options)
        point, value = lowest(cost, start, xatol=0.02, fatol=1e-3, steps=steps)
        assert point.tolist() == reference.x.tolist()
        np.testing.assert_equal(value, float(reference.fun))
