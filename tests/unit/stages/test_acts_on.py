"""A component without an axis of its own, such as a diameter, says which axis corrects it and by what factor."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.recording import ActsOn, Column, Manifest, Recording
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.errors import GateError, UsageError
from errpipe.models.rises import Rises
from errpipe.simulation import spindle_drift
from errpipe.stages import targets as stage
from errpipe.stages._compile import CompileOptions, _acts_on, compile_model
from errpipe.targets import TARGETS, _sample

SENSOR = TableInput(name="T", kind="sensor", unit="degC", low=-40, high=100, default=20, valid=(15, 35), margin=5)


def diameter(**acts_on):
    """2 um of diameter per kelvin above 20 degC: at 25 degC pieces are 10 um too large."""
    source = tables.ComponentSource("E_D", "um", (Lowered(d.Affine(weights=(2.0,), of=(d.above("T", 20.0),))),))
    stated = _acts_on({name: ActsOn(**on) for name, on in acts_on.items()}, None, ["E_D"])
    return tables.compile_table([source], inputs=[SENSOR], outputs=tables.outputs_of([source], stated))


@pytest.mark.parametrize(("factor", "along"), [(None, -5.0), (0.5, -5.0), (1.0, -10.0), (-0.5, 5.0)])
def test_a_diameter_too_large_moves_x_inwards(factor, along):
    """Ten too large: X, in radius, goes five less; counted in diameter ten less; from behind the spindle five more."""
    table = diameter(E_D={"axis": "X", "factor": factor})
    moved = _sample.corrections(table, "X", {"T": np.array([25.0])}, np.ones(1))
    assert 1e3 * float(moved[0]) == pytest.approx(along, abs=1e-6)


def test_a_control_that_holds_the_whole_table_takes_it_and_its_checklist_says_the_sign(tmp_path):
    (target,) = [t for t in TARGETS if t.controller == "LinuxCNC" and "temperature" in t.holds]
    with pytest.raises(GateError, match="moves an axis"):
        target.write(diameter())
    stage.write_targets(diameter(E_D={"axis": "X"}), [target.name], tmp_path)
    output = (tmp_path / target.name / stage.CHECKLIST).read_text()
    assert "+10 um corresponds to +5 um along X: X is commanded 5 um less" in output


def test_the_recording_may_say_it_and_the_export_wins():
    columns = {
        "T": Column(role="temperature", unit="degC"),
        "d": Column(role="error", component="E_D", unit="um", acts_on=ActsOn(axis="X")),
    }
    manifest = Manifest(recording=1, tables=("a.csv",), columns=columns)
    recording = Recording(manifest, pd.DataFrame({"T": [20.0], "d": [0.0]}))
    assert _acts_on({}, recording, ["E_D"]) == {"E_D": ("X", 0.5)}
    assert _acts_on({"E_D": ActsOn(axis="U", factor=-0.5)}, recording, ["E_D"]) == {"E_D": ("U", -0.5)}
    assert _acts_on({}, recording, ["EXX"]) == {}
    with pytest.raises(ValueError, match="acts_on belongs to a column of role error"):
        Column(role="temperature", unit="degC", acts_on=ActsOn(axis="X"))


def test_what_is_stated_of_nothing_or_by_nothing_is_refused():
    with pytest.raises(UsageError, match="'E_B' is not exported"):
        diameter(E_B={"axis": "X"})
    with pytest.raises(UsageError, match="corrects nothing"):
        diameter(E_D={"axis": "X", "factor": 0.0})
    with pytest.raises(ValueError, match="pattern"):
        ActsOn(axis="../x")
    angle = tables.ComponentSource("EBX", "urad", (Lowered(d.Constant(value=1.0)),))
    with pytest.raises(GateError, match="urad"):
        tables.outputs_of([angle], {"EBX": ("X", 1.0)})
    with pytest.raises(GateError, match="E_D is in um: it cannot act on axis B in deg"):
        diameter(E_D={"axis": "B"})


def test_what_the_table_says_of_the_diameter_stays_the_diameter():
    """Proofs and predictions compare components: the factor belongs to the axis, not to the model."""
    from errpipe.tables import batch

    table = diameter(E_D={"axis": "X"})
    columns, time = {"T": np.array([20.0, 25.0])}, np.array([0.0, 1.0])
    said = batch.evaluate(tables.by_component(table), columns, time, np.zeros(2, dtype=int)).deviation
    assert said["E_D"][1] == pytest.approx(10.0, abs=1e-6)


def test_the_drift_of_an_angle_at_the_tool_is_in_urad_and_turns_no_axis():
    """Under the unit of a length, a rotary axis A would get it as thousandths of a degree: 17 times too much."""
    recording, _ = spindle_drift.simulate(2)
    angle = {"E_A": Column(role="error", component="E_A", unit="urad")}
    recording = recording.with_columns({"E_A": recording.array("E_Z")}, angle)
    model = Rises.model_validate({"family": "rises", "component": "E_A"}).fit(recording).model
    (output,) = compile_model(model, CompileOptions(), recording=recording).outputs
    assert (model.components[0].unit, output.unit, output.correction_unit, output.axis) == ("urad", "urad", "urad", "")
