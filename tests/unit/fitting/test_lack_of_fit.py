"""What most runs repeat is no outlier: a curve with too few degrees must not give up the ends of the travel."""

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting import lack_of_fit, solve
from errpipe.fitting.model import ModelSpec, evaluate, fit

PLACES = np.linspace(0.0, 4000.0, 81)  # mm


def measured(runs: int, seed: int = 1, outliers: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, mm, deviation, um, and run of a screw: three waves of 9 um over 60 um, and outliers."""
    rng = np.random.default_rng(seed)
    x, run = np.tile(PLACES, runs), np.repeat(np.arange(runs), PLACES.size)
    y = 15e-3 * x + 9.0 * np.sin(6 * np.pi * x / 4000.0 + 0.5) + 0.3 * rng.standard_normal(x.size)
    wrong = rng.random(x.size) < outliers
    return x, y + np.where(wrong, rng.choice([-60.0, 60.0], x.size), 0.0), run


def model_of(x: np.ndarray, y: np.ndarray, run: np.ndarray, degree: int) -> np.ndarray:
    columns = {
        "run": Column(role="run"),
        "x": Column(role="position", axis="X", unit="mm"),
        "e": Column(role="error", component="EXX", unit="um"),
    }
    frame = pd.DataFrame({"run": run.astype(str), "x": x, "e": y})
    recording = Recording(Manifest(recording=1, tables=("recording.csv",), columns=columns), frame)
    terms = [{"term": "offset"}, {"term": "chebyshev", "axis": "X", "degree": degree}]
    spec = ModelSpec.model_validate({"components": [{"component": "EXX", "terms": terms}], "method": "robust"})
    return y - evaluate(fit(recording, spec, calibrate=False), recording)["EXX"]


def test_the_ends_of_travel_are_not_taken_for_outliers():
    """It left 47 um there, the largest residual of Huber's loss being 8 um, of least squares 4 um."""
    x, y, run = measured(5)
    left = model_of(x, y, run, 9)
    least = y - np.polynomial.Chebyshev.fit(x, y, 9)(x)
    assert np.abs(left).max() < 2.0 * np.abs(least).max()


@pytest.mark.parametrize("runs", [2, 3, 5, 10])
def test_outliers_at_random_are_still_rejected(runs):
    x, y, run = measured(runs, seed=runs, outliers=0.25)
    design = np.polynomial.chebyshev.chebvander(x / 2000.0 - 1.0, 30)
    solution = solve.robust(design, y)
    assert np.mean(solution.weights < lack_of_fit.REJECTED) > 0.15
    assert not lack_of_fit.is_repeated(design, solution, run)
    assert np.abs(model_of(x, y, run, 30))[solution.weights > 0.5].max() < 3.0


def test_of_two_runs_one_may_hold_the_outlier():
    x, y, run = measured(2)
    y[[3, 84]] += 60.0
    design = np.polynomial.chebyshev.chebvander(x / 2000.0 - 1.0, 30)
    assert not lack_of_fit.is_repeated(design, solve.robust(design, y), run)
