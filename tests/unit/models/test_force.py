"""The force family: milling without an axis, separate structure and bodies, and what is refused."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting.components import evaluate
from errpipe.kinematics import beam
from errpipe.models.force import Force

PUSHED = {"sections": [{"length": 80.0, "diameter": 32.0}]}
SLENDER = {"sections": [{"length": 60.0, "diameter": 32.0}, {"length": 70.0, "diameter": 12.0}]}
STRUCTURE = 0.02  # um/N


def pushes(sign: float = 1.0) -> Recording:
    """A stiff test bar in a milling spindle, pushed with 0 to 400 N in three runs."""
    rng = np.random.default_rng(2)
    force = np.tile(np.linspace(0.0, 400.0, 9), 3)
    bar = float(beam.compliance([beam.Stretch(80.0, diameter=32.0)], np.array([80.0]))[0])
    columns = {
        "run": Column(role="run"),
        "F": Column(role="force", unit="N"),
        "E_Y": Column(role="error", component="E_Y", unit="um"),
    }
    value = sign * force * (STRUCTURE + bar) + np.repeat([0.0, 5.0, -3.0], 9) + rng.normal(0, 0.1, force.size)
    frame = pd.DataFrame({"run": np.repeat(["1", "2", "3"], 9), "F": force, "E_Y": value})
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)


def milling(**more) -> Force:
    return Force(configuration="milling", component="E_Y", force="F", pushed_tool=PUSHED, tool=SLENDER, **more)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_slender_milling_tool_takes_the_place_of_the_bar_that_was_pushed(sign):
    recording = pushes(sign)
    fitted = milling(sign=sign).fit(recording)
    tool = [beam.Stretch(60.0, diameter=32.0), beam.Stretch(70.0, diameter=12.0)]
    gives = STRUCTURE + float(beam.compliance(tool, np.array([130.0]))[0])
    said = evaluate(fitted.model, recording)["E_Y"]
    np.testing.assert_allclose(said, sign * recording.array("F") * gives, atol=0.3)


def test_a_force_column_that_is_not_there_is_named():
    with pytest.raises(DataError, match=r"no column .thrust. of role force .there are: F."):
        milling().model_copy(update={"force": "thrust"}).fit(pushes())


def test_turning_needs_the_axis_of_the_cut():
    with pytest.raises(ValidationError, match="turning needs the axis"):
        Force(force="F")
