"""`predict` says what the C runtime does, in a season that the table was not fitted in: deviation and state word."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe import jsonfile
from errpipe.domain.recording import Recording
from errpipe.formats import manifest_folder
from errpipe.guard import learn
from errpipe.models.lagged import Lagged
from errpipe.stages import _artefacts
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.stages.predict import predict
from errpipe.tables import batch, ect
from tests.unit.guard import simulated_sensors
from tests.unit.stages.test_guarded import nine
from tests.unit.targets.c.test_c_runtime import COMPILERS, Library, build

CYCLE, TIMES = 10.0, 6  # s; cycles per row of the recording, which repeat its reading


@pytest.fixture(scope="module")
def compiled():
    """With its model: six sensors compared, three kept; it never fades by a range."""
    rows = nine(8, 5)
    model = Lagged.model_validate({"family": "lagged", "component": "E_Z"}).fit(rows).model
    guard = learn.learn(rows, simulated_sensors.NAMES, ("T_7", "T_8", "T_9"))
    return compile_model(model, CompileOptions(position_cycle=CYCLE, thermal_cycle=CYCLE), guard, rows), model


def season(seed: int, warmer: float) -> Recording:
    """One day, a row per cycle, every sensor warmer by some kelvin."""
    day = nine(1, seed)
    frame = day.frame.loc[day.frame.index.repeat(TIMES)].reset_index(drop=True)
    frame = frame.assign(t=CYCLE * np.arange(len(frame)))
    names = [n for n in frame if n.startswith("T_")]
    return Recording(day.manifest, frame.assign(**{n: frame[n] + warmer for n in names}))


def predicted(table, model, day: Recording, tmp_path) -> pd.DataFrame:
    jsonfile.write(tmp_path / _artefacts.MODEL, _artefacts.model_json(model))
    (tmp_path / "table.ect").write_bytes(ect.dumps(table))
    manifest_folder.write(day, tmp_path / "day")
    predict(tmp_path / "table.ect", tmp_path / "day", tmp_path / "out.csv")
    return pd.read_csv(tmp_path / "out.csv")


@pytest.mark.toolchain
@pytest.mark.skipif(not COMPILERS, reason="no C compiler")
@pytest.mark.parametrize(("warmer", "fades"), [(-4.0, True), (0.0, True), (15.0, False)])
def test_predict_is_what_c_computes(compiled, tmp_path, warmer, fades):
    """All rows but the first one, in which a controller still waits for readings that stay.

    fades: from 25 to 45 degC of any sensor; else 15 K above all that was recorded is not outside.
    """
    table, model = compiled
    if fades:
        inputs = tuple(i.model_copy(update={"valid": (10.0, 25.0), "margin": 20.0}) for i in table.inputs)
        table = table.model_copy(update={"inputs": inputs, "fade_s": CYCLE})
    day = season(6, warmer)
    frame = predicted(table, model, day, tmp_path)
    readings = np.column_stack([day.array(i.name) for i in table.inputs])
    ones = np.ones(readings.shape, np.uint8)
    deviation, _, status = Library(build(tmp_path)).stream(table, readings, ones, ones[:, 0].copy())
    outside = (status & batch._OUTSIDE) != 0
    np.testing.assert_array_equal(frame["E_Z_predicted"], deviation[:, 0])
    np.testing.assert_array_equal(frame["E_Z_outside"][1:], outside[1:])
    assert outside[1:].any() == fades and np.ptp(deviation) > 5.0
