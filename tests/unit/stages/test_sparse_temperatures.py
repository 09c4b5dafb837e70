"""Temperatures that are logged every ten minutes beside rows of every minute: the table says what was judged."""

from __future__ import annotations

import json

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Recording
from errpipe.errors import GateError, VerifyError
from errpipe.formats import manifest_folder
from errpipe.models.rises import Rises
from errpipe.models.season import Season
from errpipe.models.terms import Terms
from errpipe.simulation import spindle_drift
from errpipe.stages import _verification
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.tables import batch, by_component, ect
from errpipe.thermal.arithmetic import short_gaps_held, since_start

SENSORS = ("T_front", "T_rear", "T_room")
DAYS = spindle_drift.DAYS[:1] + spindle_drift.DAYS[3:6]


def sparse(seed: int, sensors: tuple[str, ...] = SENSORS, every: int = 10) -> Recording:
    """Four simulated days; readings of `sensors` in every tenth row, the cells between them empty."""
    recording, _ = spindle_drift.simulate(seed, days=DAYS)
    row = recording.frame.groupby("run").cumcount()
    return Recording(
        recording.manifest, recording.frame.assign(**{n: recording.frame[n].where(row % every == 0) for n in sensors})
    )


def by_table(table, recording: Recording) -> np.ndarray:
    """Deviation that the table tells row by row, um, (rows,)."""
    columns = {i.name: recording.array(i.name) for i in table.inputs}
    runs = recording.run_codes()
    deviation = batch.evaluate(by_component(table), columns, recording.time(), runs).deviation["E_Z"]
    return since_start(deviation, runs, 3)[0]


READ = {"no_reading": Recording.each_run_alone, "held": short_gaps_held}
FAST = ((Rises, 1, "held"), (Season, len(SENSORS), "no_reading"))  # the others show the same of other pairs


@pytest.mark.parametrize(
    ("kind", "sensors", "read"),
    [
        pytest.param(kind, SENSORS[:count], READ[read], marks=() if (kind, count, read) in FAST else pytest.mark.slow)
        for kind in (Rises, Season)
        for count in (1, len(SENSORS))
        for read in READ
    ],
)
def test_a_held_out_run_by_the_table_has_the_judged_residual(kind, sensors, read):
    recording = sparse(3, sensors)
    family = kind.model_validate({"family": kind.family_name(), "component": "E_Z"})
    fold = family.folds(recording, "leave-one-run-out")[1][0]
    judged = family.validate_fold(recording, fold)["E_Z"]
    learnt_from, left_out = recording.take(fold.train), read(recording.take(fold.test))
    table = compile_model(family.fit(learnt_from).model, CompileOptions(), recording=learnt_from)
    residual = since_start(left_out.array("E_Z"), left_out.run_codes(), 3)[0] - by_table(table, left_out)
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(judged.rms(judged.after), rel=1e-3)


def test_terms_are_judged_on_the_rows_between_two_readings_too():
    """Rows that hold a reading alone are predicted 0.8 um off, all rows 1.3 um."""
    terms = [{"term": "offset"}, {"term": "thermal_drift", "sensor": "T_front"}]
    terms += [{"term": "thermal_lag", "sensor": "T_rear"}]
    family = Terms.model_validate({"components": [{"component": "E_Z", "terms": terms}]})
    recording = sparse(1)
    model, (fold, *_) = family.fit(recording).model, family.folds(recording, "leave-one-run-out")[1]
    table = compile_model(model, CompileOptions(), recording=recording)
    assert family.validate_fold(recording, fold)["E_Z"].rows.size == fold.test.sum()
    columns = {i.name: recording.array(i.name) for i in table.inputs}
    output = batch.evaluate(by_component(table), columns, recording.time(), recording.run_codes()).deviation["E_Z"]
    left = recording.array("E_Z") - output
    assert np.sqrt(np.mean(left**2)) == pytest.approx(model.components[0].rms_after, rel=1e-3)


@pytest.mark.parametrize("guard", [False, True])
def test_the_exported_table_is_the_model_on_its_own_recording(guard, tmp_path, capsys):
    recording = sparse(4)
    manifest_folder.write(recording, tmp_path / "recording")
    (tmp_path / "pipeline.yaml").write_text(
        "pipeline: 1\nstages:\n  - {kind: ingest, recording: recording}\n"
        "  - {kind: fit, family: season, component: E_Z}\n  - {kind: validate}\n"
        f"  - {{kind: export, guard: {str(guard).lower()}}}\n"
    )
    assert main(["run", str(tmp_path / "pipeline.yaml"), "--out", str(tmp_path / "out")]) == 0, capsys.readouterr().err
    (proof,) = json.loads((tmp_path / "out/export/export.json").read_text())["proof"]
    assert proof["largest_difference_um"] < 1e-6 and proof["rows_held_back"] == 0
    table = ect.read(tmp_path / "out/export/table.ect")
    assert {i.stale_after_s for i in table.inputs if i.kind == "sensor"} == {1800.0}
    empty, held = by_table(table, recording), by_table(table, short_gaps_held(recording))
    assert np.abs(empty - held).max() < 1e-9


def test_a_table_whose_guards_take_away_what_the_model_gains_is_refused():
    from errpipe.validation.gate import GatedModel

    proof = {"component": "E_Z", "unit": "um", "rows": 100, "largest_difference_um": 19.8, "rms_difference_um": 6.0}
    proof |= {"rms_model_um": 12.0, "bound_um": 0.01, "unguarded_difference_um": 0.01, "rows_held_back": 7}
    judged = {"component": "E_Z", "rms_before": 15.0, "rms_at_gain": 2.0}
    (said,) = _verification.remarks([proof], GatedModel(None, (), (judged,)))
    assert "7 of 100 rows" in said and "up to 19.8" in said and "max_rate" in said
    with pytest.raises(GateError, match="gains 5"):
        _verification.remarks([proof], GatedModel(None, (), (judged | {"rms_at_gain": 10.0},)))
    with pytest.raises(GateError, match="gains 5"):  # by whatever it differs
        _verification.remarks([proof | {"rows_held_back": 0}], GatedModel(None, (), (judged | {"rms_at_gain": 10.0},)))
    assert _verification.remarks([proof | {"rows_held_back": 0}], GatedModel(None, (), (judged,))) == []


def of_terms(recording: Recording):
    """Model of two terms, and its table."""
    terms = [{"term": "offset"}, {"term": "thermal_drift", "sensor": "T_front"}]
    model = Terms.model_validate({"components": [{"component": "E_Z", "terms": terms}]}).fit(recording).model
    return model, compile_model(model, CompileOptions(), recording=recording)


def test_a_step_that_a_table_of_terms_does_not_believe_is_reported():
    """Readings 30 K above their neighbours from one row on, in a model of which the table holds every term."""
    recording, _ = spindle_drift.simulate(2, days=DAYS)
    model, table = of_terms(recording)
    (same,) = _verification.compare(table, model, recording)
    jumped = recording.array("T_front").copy()
    jumped[500:] += 30.0
    (other,) = _verification.compare(table, model, recording.with_columns({"T_front": jumped}, {}))
    assert same["rows_held_back"] == 0 and other["rows_held_back"] > 100 and other["largest_difference_um"] > 1
    assert other["unguarded_difference_um"] < 1e-6 and other["not_compensated"] == []


def test_a_table_of_another_model_fails_the_run():
    """Every row of the table 1 % more than its model says."""
    from errpipe.validation.gate import GatedModel

    recording, _ = spindle_drift.simulate(2, days=DAYS)
    model, table = of_terms(recording)
    (component,) = model.components
    more = model.model_copy(update={"components": (component.model_copy(update={"gain": 1.01}),)})
    assert _verification.remarks(_verification.compare(table, model, recording), GatedModel(None, (), ())) == []
    with pytest.raises(VerifyError, match=r"differs from its model by .* its bound"):
        _verification.remarks(_verification.compare(table, more, recording), GatedModel(None, (), ()))


def test_a_table_that_gives_no_number_where_its_model_does_is_no_proof(monkeypatch):
    from errpipe.validation.gate import GatedModel

    recording, _ = spindle_drift.simulate(2, days=DAYS)
    model, table = of_terms(recording)
    monkeypatch.setattr(_verification, "table_values", lambda *_: {"E_Z": np.full(len(recording), np.nan)})
    with pytest.raises(VerifyError, match="differs from its model by inf"):
        _verification.remarks(_verification.compare(table, model, recording), GatedModel(None, (), ()))


def test_an_hour_without_one_of_two_sensors_of_a_lag_is_no_error_of_the_table():
    """The model holds the lagged sum, the table the one reading: they differ until the lag has settled."""
    from errpipe.validation.gate import GatedModel

    recording, _ = spindle_drift.simulate(3, days=DAYS)
    silent = recording.array("T_rear").copy()
    silent[120:180] = np.nan
    recording = recording.with_columns({"T_rear": silent}, {})
    family = Season.model_validate({"family": "season", "component": "E_Z"})
    model = family.fit(recording).model
    proof = _verification.compare(compile_model(model, CompileOptions(), recording=recording), model, recording)
    assert proof[0]["unguarded_difference_um"] < 1e-6
    assert _verification.remarks(proof, GatedModel(None, (), ())) is not None


def test_a_switched_coolant_logged_in_other_rows_than_the_temperatures_is_no_error_of_the_table():
    """Logs of two devices, merged: where one has a row, the flow and the speed of the other are empty.

    The heat that a flow removes is a product under a lag, which without a reading would be held as a whole.
    """
    from errpipe.models.lagged import Lagged

    recording, _ = spindle_drift.simulate(5, days=DAYS)
    row = np.arange(len(recording))
    flow = np.where(row % 2 == 0, (row // 60) % 2, np.nan)
    recording = recording.with_columns({"flow": flow}, {"flow": Column(role="coolant")})
    model = Lagged.model_validate({"family": "lagged", "component": "E_Z"}).fit(recording).model
    table = compile_model(model, CompileOptions(), recording=recording)
    assert "flow" in {i.name for i in table.inputs}
    (proof,) = _verification.compare(table, model, recording)
    assert proof["unguarded_difference_um"] < 1e-6 and proof["largest_difference_um"] < 1e-6
