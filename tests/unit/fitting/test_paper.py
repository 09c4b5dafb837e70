import itertools

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import NotIdentifiable
from errpipe.fitting import paper
from errpipe.fitting.design import assemble
from errpipe.fitting.model import ModelSpec, fit

SENSORS = ("T1", "T2", "T3", "T4")


@pytest.fixture(scope="module")
def recording():
    """Rich enough that only what is written twice cannot be told apart: 60 thermal states, 20 positions each."""
    rng = np.random.default_rng(0)
    warm = np.repeat(rng.uniform(18, 30, (60, 4)), 20, axis=0)
    frame = pd.DataFrame(warm, columns=list(SENSORS)).assign(x=np.tile(np.linspace(0, 800, 20), 60), EXX=0.0)
    columns = {s: Column(role="temperature", unit="degC") for s in SENSORS}
    columns["x"] = Column(role="position", axis="X", unit="mm")
    columns["EXX"] = Column(role="error", component="EXX", unit="um")
    return Recording(Manifest(recording=1, tables=("r.csv",), columns=columns), frame)


def rank(design):
    return np.linalg.matrix_rank(design / np.linalg.norm(design, axis=0), tol=1e-9)


def test_the_formula_as_printed_has_25_columns_of_rank_18(recording):
    u, rises = recording.array("x") / 800.0, [recording.array(s) - 20.0 for s in SENSORS]
    slope = [np.ones(u.size), *rises, *(a * b for a, b in itertools.product(rises, rises))]
    printed = np.column_stack([*(u**i for i in range(1, 5)), *(u * s for s in slope)])
    assert printed.shape[1] == 25 and rank(printed) == 18


def test_the_terms_hold_each_column_once(recording):
    problem = assemble(recording, [("EXX", paper.mixed("X", 4, SENSORS, products=True))], ())
    design = problem.design(np.empty(0))
    assert design.shape[1] == rank(design) == 18 + 1  # and the level, which the mixed formula drops in silence
    problem = assemble(recording, [("EXX", paper.thermal(SENSORS, products=True))], ())
    assert problem.width == rank(problem.design(np.empty(0))) == 15


def test_slope_and_profile_are_separated(recording):
    x, one, three = (recording.array(n) for n in ("x", "T1", "T3"))
    y = 12 * (x / 800.0) ** 3 + 1e-3 * x * (3.0 * (one - 20) - 1.5 * (three - 20))
    y += np.random.default_rng(1).normal(0, 0.3, y.size)
    noisy = Recording(recording.manifest, recording.frame.assign(EXX=y))
    spec = ModelSpec(components=({"component": "EXX", "terms": paper.mixed("X", 4, SENSORS)},))
    model = fit(noisy, spec, calibrate=False)
    slopes = {f.term["driver"][0]["input"]: f.parameters[0] for f in model.components[0].terms[2:]}
    for sensor, truth in zip(SENSORS, (3.0, 0.0, -1.5, 0.0), strict=True):
        assert slopes[sensor].ci95[0] - 0.02 < truth < slopes[sensor].ci95[1] + 0.02
        assert slopes[sensor].unit == "um/m/K"


def test_the_printed_duplicate_is_refused_by_name(recording):
    twice = (*paper.geometric("X", 4), {"term": "scale_error", "axis": "X"})
    with pytest.raises(NotIdentifiable, match=r"c1 \(chebyshev\).*slope \(scale_error\)|slope.*c1"):
        fit(recording, ModelSpec.model_validate({"components": [{"component": "EXX", "terms": list(twice)}]}))
