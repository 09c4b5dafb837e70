"""The minimum that scipy's Nelder-Mead finds, to the last bit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize

from errpipe.fitting.simplex import minimum

VALLEYS: dict[str, Callable[[np.ndarray], float]] = {
    "Rosenbrock 1960": lambda v: float(100 * (v[1] - v[0] ** 2) ** 2 + (1 - v[0]) ** 2),
    "a kink": lambda v: float(abs(v[0] - 0.3) + 3 * abs(v[1] + v[0])),
    "equal costs": lambda v: float(np.round(np.hypot(*(v - 0.4)), 2)),
    "no number beyond": lambda v: float("inf") if v[0] > 0.5 else float((v[0] - 0.6) ** 2 + v[1] ** 2),
}


@pytest.mark.parametrize("most", [3, 15, 79, 400])
@pytest.mark.parametrize("name", VALLEYS)
def test_the_place_and_value_are_those_of_scipy(name: str, most: int) -> None:
    for start in ([-1.2, 1.0], [0.0, 0.3], [0.0, 0.0], [4.0, -7.0]):
        place, value = minimum(VALLEYS[name], start, near=1e-4, alike=1e-6, most=most)
        options = {"xatol": 1e-4, "fatol": 1e-6, "maxiter": most + 1}
        expected = minimize(VALLEYS[name], start, method="Nelder-Mead", options=options)
        assert (place.tolist(), value) == (expected.x.tolist(), expected.fun)
