"""Readings now and then: one sign and one rule for `errpipe predict`, the input of the table, and its cycle."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe import jsonfile
from errpipe.domain.error_model import ComponentModel, DatumReadings, ErrorModel, FittedParameter, FittedTerm
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.formats import manifest_folder
from errpipe.stages import _artefacts
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.stages.predict import predict
from errpipe.tables import ect
from errpipe.tables.reference import Evaluator

STEP = 600.0
ROWS = 30


def model(**readings) -> ErrorModel:
    """2 um per kelvin along X; with keywords it takes readings."""
    term = FittedTerm(
        term={"term": "thermal_drift", "sensor": "T"},
        parameters=(FittedParameter(name="gain", value=2.0, unit="um/K"),),
    )
    taken = DatumReadings(**readings) if readings else None
    component = ComponentModel(component="E_X", terms=(term,), readings=taken)
    return ErrorModel(
        columns={"T": {"role": "temperature", "unit": "degC"}}, components=(component,), datum="run_start"
    )


TAKES = {"share": 1.0, "hold_s": 7200.0, "bound": 40.0}


@pytest.fixture
def recording() -> Recording:
    """Two runs on one clock; the machine is 10 um longer at +X than its temperature says."""
    t = np.concatenate([np.arange(ROWS) * STEP, 86400.0 + np.arange(ROWS) * STEP])
    warm = 20.0 + 3.0 * (1 - np.exp(-(t % 86400.0) / 5000.0))
    frame = pd.DataFrame({"run": ["a"] * ROWS + ["b"] * ROWS, "t": t, "T": warm, "x": 2.0 * (warm - 20.0) + 10.0})
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "T": Column(role="temperature", unit="degC"),
        "x": Column(role="error", component="E_X", unit="um"),
    }
    return Recording(Manifest(recording=1, tables=("x.csv",), columns=columns), frame)


@pytest.fixture
def run(recording, tmp_path):
    """Predict with a model, as model or as table, and readings as CSV text; values (rows,) and the answer."""
    manifest_folder.write(recording, tmp_path / "rows")

    def predicted(source: ErrorModel, text: str | None, as_table: bool = False):
        path = tmp_path / ("table.ect" if as_table else "error_model.json")
        jsonfile.write(tmp_path / "error_model.json", _artefacts.model_json(source))
        if as_table:
            ect.write(compile_model(source, CompileOptions()), path)
        file = None
        if text is not None:
            file = tmp_path / "readings.csv"
            file.write_text(text)
        answer = predict(path, tmp_path / "rows", tmp_path / "out.csv", file)
        return pd.read_csv(tmp_path / "out.csv")["x_predicted"].to_numpy(), answer

    return predicted


def reading(recording, *rows) -> str:
    return "time,x\n" + "".join(f"{float(recording.time()[r])!r},{float(recording.array('x')[r])!r}\n" for r in rows)


@pytest.mark.parametrize("as_table", [False, True], ids=["model", "table"])
def test_a_machine_10_um_too_long_is_predicted_10_um_longer_after_a_reading(run, recording, as_table):
    without, _ = run(model(**TAKES), None, as_table)
    output, answer = run(model(**TAKES), reading(recording, 8), as_table)
    assert answer["readings"] == {"E_X": {"used": 1, "not_believed": 0, "by": "datum_E_X"}}
    more = np.zeros(2 * ROWS)
    more[9:21] = 10.0  # after row 8, for 7200 s, in its own run
    assert_allclose(output - without, more, atol=1e-9)
    assert_allclose(output[9:21], recording.array("x")[9:21], atol=1e-3)


def test_a_share_of_the_reading_and_none_that_is_wild(run, recording):
    without, _ = run(model(**TAKES), None)
    half, _ = run(model(**TAKES | {"share": 0.5}), reading(recording, 8))
    assert half[9] - without[9] == pytest.approx(5.0)
    with pytest.raises(DataError, match="1 lie further than 9 from the prediction"):
        run(model(**TAKES | {"bound": 9.0}), reading(recording, 8))


def test_a_table_without_an_input_for_readings_is_corrected_outside_it(run, recording):
    without, _ = run(model(), None)
    output, answer = run(model(), reading(recording, 8, 40), as_table=True)
    assert "the table has no input" in answer["readings"]["E_X"]["by"]
    more = output - without
    assert (more[:9] == 0).all() and (more[ROWS : ROWS + 11] == 0).all()
    assert_allclose(np.r_[more[9:ROWS], more[ROWS + 11 :]], 10.0, atol=1e-9)


def test_later_readings_change_no_earlier_row(run, recording):
    one, _ = run(model(**TAKES), reading(recording, 4))
    two, _ = run(model(**TAKES), "time,x\n" + "9000,35\n" + reading(recording, 4).splitlines()[1] + "\n")
    assert (one[:16] == two[:16]).all() and (one[16:28] != two[16:28]).all()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time,y\n600,1\n", r":1  column 'y' \(allowed: time, run, E_X, t, x\)"),
        ("x\n1\n", r":1  found E_X \(needed, once each: time"),
        ("time,x\n600,1\nnoon,2\n", r":3  time: found 'noon' \(allowed: a number\)"),
        ("time,x\n600,1 um\n", r":2  E_X: found '1 um'"),
        ("time,x,run\n600,1,c\n", r":2  run: found 'c'"),
        ("time,x\n50000,1\n", "no reading of E_X is both accepted and within a run"),
        ("", "cannot be read as a table"),
    ],
)
def test_bad_files_are_refused_with_file_and_line(run, text, says):
    with pytest.raises(DataError, match=says):
        run(model(**TAKES), text)


def test_runs_that_overlap_in_time_need_their_name(recording):
    from errpipe.stages import _readings

    frame = recording.frame.assign(t=recording.time() % 86400.0)
    with pytest.raises(DataError, match="600 s lies in several runs"):
        _read(_readings, Recording(recording.manifest, frame), "time,x\n600,1\n")
    contents = _read(_readings, Recording(recording.manifest, frame), "time,run,x\n600,b,1\n")
    assert contents[["run", "time", "E_X"]].to_numpy().tolist() == [[1.0, 600.0, 1.0]]


def _read(module, recording, text):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "r.csv"
        file.write_text(text)
        return module.read(file, recording, ["E_X"])


def test_in_the_cycle_a_reading_of_10_um_too_long_moves_x_back_by_10_um():
    """Fed at one cycle only, as a probe does; after `hold_s` without another one the table is as without it."""
    table = compile_model(model(**TAKES | {"hold_s": 5.0}), CompileOptions(thermal_cycle=0.1, position_cycle=0.1))
    cycle = Evaluator(table)
    got = []
    for number in range(200):
        fed = {"T": 20.0} | ({"datum_E_X": 10.0} if number == 50 else {})
        got.append(cycle.cycle(fed))
    correction = np.array([c.correction["E_X"] for c in got])
    assert_allclose(correction[[49, 90, 199]], [0.0, -0.010, 0.0], atol=1e-9)
    assert all("fading" not in c.status_names() and "defaulted" not in c.status_names() for c in got)


def test_the_name_of_the_input_stands_in_the_model_and_the_model_without_readings_is_as_before():
    assert "readings" not in json.dumps(_artefacts.model_json(model()))
    assert [i.name for i in compile_model(model(), CompileOptions()).inputs] == ["T"]
    assert [i.name for i in compile_model(model(**TAKES), CompileOptions()).inputs] == ["T", "datum_E_X"]
