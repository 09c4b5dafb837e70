"""The solvers against certified answers: NIST Statistical Reference Datasets (StRD), linear and non-linear regression.

`nist.json` holds the published data with NIST's certified parameters, their standard deviations and the residual
standard deviation. LRE is the log relative error of StRD: about the number of correct digits.
Linear parameters of the non-linear problems are eliminated (variable projection), as everywhere in errpipe, so each
problem is stated by its bounds for the non-linear ones only; no certified value is a starting value.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from errpipe.fitting import solve
from errpipe.fitting.separable import Unknown, search

PROBLEMS = json.loads((Path(__file__).parent / "nist.json").read_text(encoding="utf-8"))
Columns = Callable[[np.ndarray, np.ndarray], np.ndarray]


def lre(value: np.ndarray, certified: np.ndarray) -> float:
    """Smallest log relative error over all values: correct decimal digits, at most 15."""
    error = np.abs(np.asarray(value) - np.asarray(certified)) / np.abs(certified)
    return float(-np.log10(np.maximum(error, 1e-15)).max())


def linear_design(name: str) -> np.ndarray:
    x = np.asarray(PROBLEMS[name]["x"], dtype=float)
    if name == "Filip":
        return np.vander(x, 11, increasing=True)
    return np.column_stack([np.ones(len(x)), x])


# Digits: what double precision leaves at the condition number of each design (Longley 5e9, Filip 2e15 unscaled).
@pytest.mark.parametrize("name, digits", [("Longley", 9.0), ("Filip", 6.5)])
def test_linear_regression(name: str, digits: float) -> None:
    problem = PROBLEMS[name]
    y = np.asarray(problem["y"])
    solution = solve.least_squares(linear_design(name), y)
    spread = np.sqrt(np.sum(solution.residual**2) / (y.size - solution.rank))
    assert lre(solution.coefficients, problem["parameters"]) >= digits
    assert lre(spread, problem["residual_standard_deviation"]) >= digits
    assert lre(spread * np.sqrt(np.diag(solution.inverse)), problem["standard_deviations"]) >= digits


def _waves(x: np.ndarray, q: np.ndarray) -> np.ndarray:
    turns = [2 * np.pi * x / period for period in (12.0, *q)]
    return np.column_stack([np.ones_like(x), *(f(t) for t in turns for f in (np.cos, np.sin))])


def _rational(x: np.ndarray, q: np.ndarray) -> np.ndarray:
    below = 1 + q[0] * x + q[1] * x**2 + q[2] * x**3
    return np.vander(x, 4, increasing=True) / below[:, None]


# name -> columns of the linear parameters given the non-linear ones, bounds of those, where the certified linear and
# non-linear parameters stand in NIST's list, and the digits asked for.
# Thurber is searched within the range in which its denominator has no zero.
NONLINEAR: dict[str, tuple[Columns, list[tuple[float, float]], list[int], list[int], float]] = {
    "Misra1a": (lambda x, q: -np.expm1(-q[0] * x)[:, None], [(1e-5, 1e-1)], [0], [1], 6),
    "Misra1b": (lambda x, q: (1 - (1 + q[0] * x / 2) ** -2.0)[:, None], [(1e-5, 1e-1)], [0], [1], 6),
    "DanWood": (lambda x, q: (x ** q[0])[:, None], [(0.5, 10.0)], [0], [1], 6),
    "BoxBOD": (lambda x, q: -np.expm1(-q[0] * x)[:, None], [(0.01, 10.0)], [0], [1], 5),
    "Rat42": (lambda x, q: (1 / (1 + np.exp(q[0] - q[1] * x)))[:, None], [(0.1, 10.0), (1e-3, 1.0)], [0], [1, 2], 6),
    "Eckerle4": (
        lambda x, q: (np.exp(-0.5 * ((x - q[1]) / q[0]) ** 2) / q[0])[:, None],
        [(0.5, 50.0), (400.0, 500.0)],
        [0],
        [1, 2],
        5,
    ),
    "MGH17": (
        lambda x, q: np.column_stack([np.ones_like(x), np.exp(-q[0] * x), np.exp(-q[1] * x)]),
        [(1e-3, 0.5), (1e-3, 0.5)],
        [0, 1, 2],
        [3, 4],
        5,
    ),
    "MGH09": (
        lambda x, q: ((x**2 + x * q[0]) / (x**2 + x * q[1] + q[2]))[:, None],
        [(1e-3, 50.0), (1e-3, 50.0), (1e-3, 50.0)],
        [0],
        [1, 2, 3],
        4.5,  # a flat valley: the finite-difference Jacobian stops at 4.9 digits
    ),
    "ENSO": (_waves, [(30.0, 60.0), (20.0, 29.0)], [0, 1, 2, 4, 5, 7, 8], [3, 6], 5),
    "Thurber": (_rational, [(0.0, 3.0), (0.0, 2.0), (0.0, 0.5)], [0, 1, 2, 3], [4, 5, 6], 5),
    "MGH10": (
        lambda x, q: np.exp(q[0] / (x + q[1]) - 20.0)[:, None],  # b1 times exp(20): keeps exp in range
        [(1e3, 2e4), (100.0, 1000.0)],
        [0],
        [1, 2],
        5,
    ),
}


@pytest.mark.parametrize("name", NONLINEAR)
def test_nonlinear_regression(name: str) -> None:
    columns, bounds, linear, nonlinear, digits = NONLINEAR[name]
    problem = PROBLEMS[name]
    x, y = np.asarray(problem["x"]), np.asarray(problem["y"])
    unknowns = [Unknown(f"b{k + 1}", low, high) for k, (low, high) in zip(nonlinear, bounds, strict=True)]
    match = search(lambda q: columns(x, q), np.empty((y.size, 0)), y, unknowns)
    certified = np.asarray(problem["parameters"])
    order = np.argsort(certified[nonlinear]) if name == "MGH17" else np.arange(len(nonlinear))  # two like exponentials
    assert lre(np.sort(match) if name == "MGH17" else match, certified[nonlinear][order]) >= digits
    solution = solve.least_squares(columns(x, match), y)
    rss = float(np.sum(solution.residual**2))
    assert lre(rss, problem["residual_sum_of_squares"]) >= digits
    if name not in ("MGH10", "MGH17"):
        assert lre(solution.coefficients, certified[linear]) >= digits


def test_a_wrong_answer_has_few_digits() -> None:
    assert lre(np.array([1.001]), np.array([1.0])) == pytest.approx(3.0, abs=0.01)
    wrong = solve.least_squares(linear_design("Longley")[:, :-1], np.asarray(PROBLEMS["Longley"]["y"]))
    assert lre(wrong.coefficients, PROBLEMS["Longley"]["parameters"][:-1]) < 2
