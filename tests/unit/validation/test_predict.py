from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting.components import evaluate
from errpipe.fitting.model import ModelSpec, fit
from errpipe.simulation import spindle_drift
from errpipe.validation.predict import Evaluated, of_model, predict, predict_parts


@pytest.fixture(scope="module")
def drift():
    return spindle_drift.simulate(1)[0]


@pytest.fixture(scope="module")
def model(drift):
    terms = [
        {"term": "offset"},
        {"term": "thermal_drift", "sensor": "T_front"},
        {"term": "thermal_lag", "sensor": "T_room"},
    ]
    spec = ModelSpec.model_validate({"components": [{"component": "E_Z", "terms": terms}]})
    return fit(drift.take(drift.run_codes() < 5), spec)


def test_one_row_per_row_in_order(drift, model):
    prediction = predict(model, drift)
    assert list(prediction) == ["run", "time", "E_Z_predicted", "E_Z_lower", "E_Z_upper", "E_Z_outside"]
    assert (prediction["run"] == drift.frame["run"]).all() and (prediction["time"] == drift.frame["t"]).all()
    assert (prediction["E_Z_lower"] < prediction["E_Z_predicted"]).all()
    assert np.sqrt(np.mean((prediction["E_Z_predicted"] - drift.frame["E_Z"]) ** 2)) < 1.5


def test_the_future_and_other_runs_change_nothing(drift, model):
    whole = predict(model, drift)
    rng = np.random.default_rng(0)
    for cut in (300, 701, 1500):
        run = drift.run_codes()[cut]
        own = (drift.run_codes() == run) & (np.arange(len(drift)) <= cut)
        frame = drift.frame.copy()
        names = ["T_front", "T_rear", "T_room", "n"]
        frame.loc[~own, names] = frame.loc[~own, names].to_numpy() + rng.normal(0, 5, (int((~own).sum()), len(names)))
        changed = predict(model, Recording(drift.manifest, frame))
        assert changed["E_Z_predicted"][cut] == whole["E_Z_predicted"][cut]
        alone = predict(model, drift.take(own))
        assert alone["E_Z_predicted"].iloc[-1] == whole["E_Z_predicted"][cut]


def test_the_response_is_never_read(drift, model):
    blind = Recording(drift.manifest, drift.frame.assign(E_Z=np.nan))
    assert predict(model, blind)["E_Z_predicted"].equals(predict(model, drift)["E_Z_predicted"])


def test_without_the_response_columns_are_named_by_component(drift, model):
    bare = Recording(drift.manifest, drift.frame.drop(columns="E_Z"))
    assert "E_Z_predicted" in predict(model, bare)


def test_outside_is_reported_and_widens(drift, model):
    prediction = predict(model, drift)
    summer = prediction["run"].isin(["s1", "s2", "s3"])
    assert prediction.loc[summer, "E_Z_outside"].mean() > 0.9
    assert prediction.loc[~summer, "E_Z_outside"].mean() == 0.0
    width = prediction["E_Z_upper"] - prediction["E_Z_lower"]
    assert width[summer].max() > 1.5 * width[~summer].max()


def test_a_sensor_that_drops_out_holds_its_last_value(drift, model):
    frame = drift.frame.copy()
    frame.loc[100:110, "T_front"] = np.nan
    held = frame.copy()
    held.loc[100:110, "T_front"] = held.loc[99, "T_front"]
    one, two = (predict(model, Recording(drift.manifest, f)) for f in (frame, held))
    assert one["E_Z_predicted"].equals(two["E_Z_predicted"])


def test_a_sensor_that_is_logged_now_and_then_is_known_in_between_and_one_that_stops_is_not(drift, model):
    """T_front every fourth row, silent from row 60 on: known until three such pauses are over."""
    frame = drift.frame.copy()
    rows = np.arange(len(frame))
    first = drift.run_codes() == 0
    frame.loc[first & ((rows % 4 > 0) | (rows > 60)), "T_front"] = np.nan
    everything = Recording(drift.manifest, frame)
    outside = predict(model, everything)["E_Z_outside"].to_numpy()
    inside = np.flatnonzero(first & (outside == 0))
    assert set(range(8, 73)) <= set(inside) and inside.max() == 72
    cut = [0, 1, 2, 9, 10, 33, 61, 70, len(frame)]
    source = replace(of_model(model), begin=lambda _: lambda part: Evaluated(evaluate(model, part)))
    parts = [everything.take(slice(a, b)) for a, b in pairwise(cut)]
    in_parts = pd.concat(predict_parts(source, parts))["E_Z_outside"].to_numpy()
    np.testing.assert_array_equal(in_parts, outside)


def test_before_a_sensors_first_value_nothing_is_predicted(drift, model):
    frame = drift.frame.copy()
    frame.loc[0:4, "T_front"] = np.nan
    prediction = predict(model, Recording(drift.manifest, frame))
    assert (prediction["E_Z_predicted"][:5] == 0).all() and (prediction["E_Z_outside"][:5] == 1).all()


def test_a_column_that_is_missing_is_named(drift, model):
    with pytest.raises(DataError, match="no column T_room, which the model reads"):
        predict(model, Recording(drift.manifest, drift.frame.drop(columns="T_room")))


def test_nothing_predicted_has_no_interval(drift, model):
    """A sensor that has not shown a value since its run began: 0 stands for no prediction, not for no deviation."""
    first = drift.run_codes() == 0
    dead = predict(model, Recording(drift.manifest, drift.frame.assign(T_front=drift.frame["T_front"].mask(first))))
    assert (dead.loc[first, "E_Z_predicted"] == 0).all() and (dead.loc[first, "E_Z_outside"] == 1).all()
    assert dead.loc[first, ["E_Z_lower", "E_Z_upper"]].isna().all(axis=None)
    assert dead.loc[~first, ["E_Z_lower", "E_Z_upper"]].notna().all(axis=None)
