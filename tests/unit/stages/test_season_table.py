"""The table of a thermal model that fades by itself: equal to the model far outside, faded where a sensor is lost."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe import jsonfile
from errpipe.domain.recording import Recording
from errpipe.formats import manifest_folder
from errpipe.stages import _artefacts
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.stages.predict import predict, table_values
from errpipe.tables import ect
from errpipe.thermal import season
from tests.unit.thermal.test_season import machine

SENSORS = ("T_room", "T_spindle", "T_bed")


@pytest.fixture(scope="module")
def fitted():
    return season.fit(machine(6), "E_D")


@pytest.fixture(scope="module")
def model(fitted):
    return fitted.error_model(machine(6))


@pytest.fixture(scope="module")
def table(model):
    return compile_model(model, CompileOptions())


def test_outside_the_box_the_table_says_what_the_model_says(fitted, model, table):
    one = machine(2, seed=9, rows=40)
    hot = Recording(one.manifest, one.frame.assign(**{n: one.array(n) + 20.0 for n in SENSORS}))
    output = table_values(table, model, hot)["E_D"]
    assert np.abs(output).max() > 1.0
    assert_allclose(output, fitted.values(hot), atol=1e-9)


def test_the_table_has_no_box_of_its_own_and_still_fades_where_a_sensor_is_lost(model, table):
    assert not model.validity.fades and model.validity.ranges
    assert all(i.valid is None and i.fade_on_default for i in table.inputs)
    assert not any(p.keep for p in table.pairs)
    one = machine(1, seed=9, rows=40)
    lost = Recording(one.manifest, one.frame.assign(T_bed=np.nan))
    assert_allclose(table_values(table, model, lost)["E_D"], 0.0, atol=1e-12)


def test_a_table_with_its_model_in_the_same_folder_has_the_models_intervals(fitted, model, table, tmp_path):
    one = machine(2, seed=9, rows=40)
    manifest_folder.write(one, tmp_path / "rows")
    ect.write(table, tmp_path / "table.ect")
    alone = predict(tmp_path / "table.ect", tmp_path / "rows", tmp_path / "alone.csv")
    assert "a table contains the deviation only" in alone["intervals"]
    assert pd.read_csv(tmp_path / "alone.csv")["E_D_lower"].isna().all()
    jsonfile.write(tmp_path / _artefacts.MODEL, _artefacts.model_json(model))
    both = predict(tmp_path / "table.ect", tmp_path / "rows", tmp_path / "both.csv")
    assert "intervals" not in both
    pair, own = pd.read_csv(tmp_path / "both.csv"), fitted.predict(one)
    assert_allclose(pair["E_D_upper"] - pair["E_D_lower"], own.upper - own.lower, rtol=1e-6)
    assert_allclose(pair["E_D_predicted"], own.predicted, atol=1e-6)
