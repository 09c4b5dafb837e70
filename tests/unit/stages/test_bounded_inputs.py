"""A force or velocity far beyond what was fitted, as of a failed sensor, does not move an axis by millimetres."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting.components import solved
from errpipe.fitting.spec import ModelSpec
from errpipe.stages._compile import compile_model
from errpipe.stages.export import Export
from errpipe.tables.reference import Evaluator
from tests.unit.models.test_force import gauged, turning

CYCLES = 3000  # after which ramps and slews are through


def settled(evaluator: Evaluator, readings: dict[str, float]) -> float:
    """Correction in um."""
    return [1e3 * next(iter(evaluator.cycle(readings).correction.values())) for _ in range(CYCLES)][-1]


def test_a_force_beyond_twice_the_largest_push_is_no_reading() -> None:
    """Pushed with 500 N at most, the tool away to +X: less is commanded in proportion up to 1000 N, nothing beyond."""
    table = compile_model(turning().fit(gauged()).model, Export(kind="export"))
    (output,) = table.outputs
    evaluator = Evaluator(table)
    at = {force: settled(evaluator, {"Z": 100.0, "F": force}) for force in (500.0, 900.0, 1e6, float("nan"), 500.0)}
    assert at[500.0] < -10.0 and at[900.0] == pytest.approx(1.8 * at[500.0], rel=1e-6)
    assert at[1e6] == pytest.approx(0.0, abs=1e-6)
    assert output.magnitude is not None and output.magnitude < 200.0  # um; it was 8e4


def test_a_velocity_counts_up_to_twice_the_largest_that_was_fitted() -> None:
    rng = np.random.default_rng(2)
    velocity = np.tile([-100.0, -50.0, 50.0, 100.0], 60)
    frame = {"run": np.repeat(["1", "2", "3"], 80), "v": velocity, "EXX": 0.05 * velocity + rng.normal(0, 0.1, 240)}
    columns = {
        "run": Column(role="run"),
        "v": Column(role="velocity", axis="X", unit="mm/s"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), pd.DataFrame(frame))
    term = {"term": "profile_driver", "driver": [{"input": "v", "unit": "mm/s"}]}
    spec = ModelSpec.model_validate({"components": [{"component": "EXX", "terms": [term]}]})
    table = compile_model(solved(recording, spec, np.ones(240, dtype=bool)), Export(kind="export"))
    evaluator = Evaluator(table)
    at = {speed: settled(evaluator, {"v": speed}) for speed in (100.0, 190.0, 9e4, -9e4)}
    assert at[100.0] == pytest.approx(-5.0, abs=0.1) and at[190.0] == pytest.approx(1.9 * at[100.0], rel=1e-3)
    assert at[9e4] == pytest.approx(2.0 * at[100.0], rel=1e-3) and at[-9e4] == pytest.approx(-at[9e4], rel=1e-3)
    assert table.outputs[0].magnitude is not None and table.outputs[0].magnitude < 15.0  # um; it was 5e3


def test_a_current_stands_for_a_cutting_force_that_is_not_read() -> None:
    """3 A idle, 4 um/A, the tool away to +Y; its export was refused. A lost reading leaves no correction."""
    rng = np.random.default_rng(3)
    current = np.tile([3.0, 4.0, 6.0, 8.0], 60)
    deviation = 4.0 * (current - 3.0) + rng.normal(0, 0.1, 240)
    frame = {"run": np.repeat(["1", "2", "3"], 80), "I": current, "E_Y": deviation}
    columns = {
        "run": Column(role="run"),
        "I": Column(role="current", unit="A"),
        "E_Y": Column(role="error", component="E_Y", unit="um"),
    }
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), pd.DataFrame(frame))
    terms = [{"term": "offset"}, {"term": "profile_driver", "driver": [{"input": "I", "unit": "A"}]}]
    spec = ModelSpec.model_validate({"components": [{"component": "E_Y", "terms": terms}]})
    evaluator = Evaluator(compile_model(solved(recording, spec, np.ones(240, dtype=bool)), Export(kind="export")))
    assert settled(evaluator, {"I": 8.0}) == pytest.approx(-20.0, abs=0.1)
    assert settled(evaluator, {"I": 3.0}) == pytest.approx(0.0, abs=0.1)
    assert settled(evaluator, {"I": 8.0}) == pytest.approx(-20.0, abs=0.1)
    assert [settled(evaluator, {"I": float("nan")}) for _ in range(20)][-1] == pytest.approx(0.0, abs=0.1)
