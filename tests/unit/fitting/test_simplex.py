"""The simplex search: scipy's answers, bit for bit, and no import of scipy.optimize for them."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.optimize import minimize, rosen

from errpipe.fitting.simplex import minimise


def bowl(x: np.ndarray) -> float:
    return float(np.sum((x - np.arange(x.size)) ** 2 * (1.0 + np.arange(x.size))))


def steps_of_a_stair(x: np.ndarray) -> float:
    """Flat almost everywhere: corners tie, and the simplex is drawn together."""
    return float(np.sum(np.floor(4.0 * np.abs(x - 0.3))))


@pytest.mark.parametrize("cost", [bowl, rosen, steps_of_a_stair, lambda x: float(np.abs(x).sum() ** 0.3)])
@pytest.mark.parametrize("variables", [2, 3, 5])
def test_the_least_value_is_scipys_to_the_last_bit(cost, variables: int) -> None:
    rng = np.random.default_rng(3)
    for begin in (np.zeros(variables), *rng.normal(0.0, 2.0, (4, variables))):
        options = {"xatol": 1e-3, "fatol": 1e-4, "maxiter": 80}
        theirs = minimize(cost, begin, method="Nelder-Mead", options=options)
        x, least = minimise(cost, begin, x_step=1e-3, cost_step=1e-4, steps=80)
        assert x.tobytes() == theirs.x.tobytes() and least == theirs.fun


def test_a_fit_of_linear_terms_imports_no_scipy_optimize() -> None:
    """Its import took 0.16 s of the 0.85 s that a worker of a fleet needs before its first machine."""
    code = "import sys, errpipe.stages._fleet_worker; print('scipy.optimize' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "False\n"
