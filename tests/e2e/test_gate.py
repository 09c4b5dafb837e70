"""What may be exported: only what held-out runs were better with, at the gain judged there, inside what was covered."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe import jsonfile
from errpipe.cli.app import main
from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.errors import GateError
from errpipe.fitting.components import evaluate
from errpipe.fitting.lowering import lower
from errpipe.fitting.validity import covered
from errpipe.formats import manifest_folder
from errpipe.models.terms import Terms
from errpipe.stages import _artefacts
from errpipe.tables import ect
from errpipe.validation.gate import pass_gate
from tests.validation_document import held_out

KINDS = {
    "run": Column(role="run"),
    "t": Column(role="time", unit="s"),
    "x": Column(role="position", axis="X", unit="mm"),
    "T": Column(role="temperature", unit="degC", location="nut"),
    "EXX": Column(role="error", component="EXX", unit="um"),
}


def recorded(deviation, x, warm, runs: int) -> Recording:
    """An axis measured in some runs."""
    frame = {"run": np.repeat(np.arange(runs), x.size // runs).astype(str), "t": 10.0 * np.arange(x.size)}
    constants = {"X": Constant(role="axis", kind="linear", travel=(0, 500), unit="mm")}
    manifest = Manifest(recording=1, tables=("a.parquet",), columns=KINDS, constants=constants)
    return Recording(manifest, pd.DataFrame({**frame, "x": x, "T": warm, "EXX": deviation}))


def axis(seed: int, runs: int = 6, rows: int = 240, slope=11e-3, offsets: float = 0.0) -> Recording:
    """A screw that expands; each run may have an offset of its own, which no later run repeats."""
    rng = np.random.default_rng(seed)
    x, warm = rng.uniform(0, 500, rows), 20 + rng.uniform(0, 5, rows)
    own = np.repeat(rng.normal(0.0, offsets, runs), rows // runs)
    return recorded(slope * x * (warm - 20) + own + rng.normal(0, 0.3, rows), x, warm, runs)


def terms(*chosen) -> Terms:
    return Terms.model_validate({"components": [{"component": "EXX", "terms": list(chosen)}]})


EXPANSION = {"term": "scale_expansion", "axis": "X", "sensor": "T"}


def gated(recording: Recording, family: Terms):
    model = family.fit(recording).model
    return model, pass_gate(model, [held_out(recording, family)]).model


def test_random_offsets_by_run_export_nothing_harmful() -> None:
    """40 seeds: no exported model makes the runs to come worse than no compensation."""
    harmful = []
    for seed in range(40):
        try:
            _, model = gated(axis(seed, slope=0.0, offsets=5.0), terms({"term": "offset"}, EXPANSION))
        except GateError:
            continue
        fresh = axis(1000 + seed, runs=60, rows=1200, slope=0.0, offsets=5.0)
        y = fresh.array("EXX")
        after, before = (float(np.sqrt(np.mean(v**2))) for v in (y - evaluate(model, fresh)["EXX"], y))
        harmful += [(seed, before, after)] if after > 1.02 * before else []
    assert harmful == []


def test_what_is_there_is_exported_whole() -> None:
    for seed in range(5):
        whole, model = gated(axis(seed, runs=3), terms({"term": "offset"}, EXPANSION))
        assert model == whole


def test_the_gain_that_was_judged_is_the_gain_that_is_exported() -> None:
    """Slopes drawn anew in each run around a mean of half their size: all of the mean is too much."""
    recording = axis(2, runs=12, rows=960, slope=0.0)
    slope = np.repeat(np.tile([4.0, 0.5, 1.5, 0.5], 3), 80)
    recording = Recording(
        recording.manifest, recording.frame.assign(EXX=recording.array("EXX") + slope * (recording.array("T") - 20.0))
    )
    family = terms({"term": "thermal_drift", "sensor": "T"})
    model = family.fit(recording).model
    document = held_out(recording, family)
    (figures,) = document["components"]
    half = {**document, "components": [{**figures, "gain": 0.5, "half_width90_at_gain": 7.0}]}
    cut = pass_gate(model, [half]).model
    assert np.allclose(evaluate(cut, recording)["EXX"], 0.5 * evaluate(model, recording)["EXX"])
    assert cut.components[0].gain == 0.5 and cut.components[0].half_width90 == 7.0
    for stated, exported in ((3.0, 7.0), (9.0, 9.0)):  # an interval that follows the inputs is never narrower either
        follows = {"factor90": {"op": "constant", "value": 1.0}, "half_width90": stated}
        follows = model.model_copy(update={"components": (model.components[0].model_copy(update=follows),)})
        assert pass_gate(follows, [half]).model.components[0].half_width90 == exported
    from errpipe.drivers.evaluation import drive

    (pair,), (all_of_it,) = lower(cut)["EXX"], lower(model)["EXX"]
    assert np.allclose(drive(pair.driver, recording), 0.5 * drive(all_of_it.driver, recording))


PIPELINE = """pipeline: 1
title: Screw
stages:
  - {{kind: ingest, recording: recording}}
  - kind: fit
    components: [{{component: EXX, terms: [{{term: offset}}, {{term: scale_expansion, axis: X, sensor: T}}]}}]
{more}
"""


def run(tmp_path: Path, recording: Recording, more: str) -> int:
    manifest_folder.write(recording, tmp_path / "recording")
    (tmp_path / "p.yaml").write_text(PIPELINE.format(more=more))
    return main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")])


def test_no_export_without_a_judgement(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(tmp_path, axis(1), "  - {kind: export}") == 4
    assert "was not validated on held-out rows" in capsys.readouterr().err
    assert not (tmp_path / "out" / "export" / "table.ect").exists()


def test_the_judgement_of_another_model_does_not_count(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = """  - {kind: validate}
  - kind: fit
    name: other
    components: [{component: EXX, terms: [{term: offset}]}]
  - {kind: export%s}"""
    assert run(tmp_path, axis(1), other % ", from: {error_model: other}") == 4
    assert "this model (EXX) was not validated" in capsys.readouterr().err
    assert run(tmp_path, axis(1), other % "") == 2
    assert "several fits have EXX" in capsys.readouterr().err


STRAIGHT = """  - {{kind: validate}}
  - kind: fit
    name: across
    components:
      - {{component: EYX, terms: [{{term: offset}}, {{term: straightness, axis: X, low: 0, high: 500, order: 6}}]}}
  - {{kind: validate, name: second{of}}}
  - {{kind: export}}
  - {{kind: report}}"""


def test_components_of_several_fits_are_exported_and_reported_together(tmp_path, capsys) -> None:
    both = axis(1)
    across = 3.0 * np.sin(np.pi * both.array("x") / 500) + 0.1 * both.array("EXX")
    both = both.with_columns({"EYX": across}, {"EYX": Column(role="error", component="EYX", unit="um")})
    assert run(tmp_path, both, STRAIGHT.format(of="")) == 0
    out = tmp_path / "out"
    assert [c["component"] for c in jsonfile.read(out / "export" / "error_model.json")["components"]] == ["EXX", "EYX"]
    page = (out / "report" / "report.html").read_text()
    assert page.count("EYX") > 3 < page.count("EXX")
    assert (
        main(["predict", str(out / "export" / "table.ect"), str(tmp_path / "recording"), "--out", f"{out}/p.csv"]) == 0
    )
    predicted = pd.read_csv(out / "p.csv")
    for stage, name in (("fit", "EXX"), ("across", "EYX")):
        model = _artefacts.read_model(out / stage / "error_model.json")
        assert np.allclose(predicted[f"{name}_predicted"], evaluate(model, both)[name], atol=0.02)
    assert run(tmp_path, both, STRAIGHT.format(of=", from: {error_model: fit}")) == 4
    assert "this model (EYX) was not validated" in capsys.readouterr().err


def test_an_ungated_export_says_so_in_table_report_and_checklist(tmp_path: Path) -> None:
    noise = axis(1, slope=0.0)
    more = "  - {kind: validate}\n  - {kind: export, ungated: true, targets: [linuxcnc_screw]}\n  - {kind: report}"
    assert run(tmp_path, noise, more) == 0
    export = tmp_path / "out" / "export"
    assert ect.read(export / "table.ect").title.startswith("Ungated, not shown")
    assert "Ungated, not shown" in (export / "linuxcnc_screw" / "CHECKLIST.md").read_text()
    assert "Ungated, not shown" in (tmp_path / "out" / "report" / "report.html").read_text()
    assert json.loads((export / "export.json").read_text())["ungated"].startswith("Ungated")


def with_hot_rows(recording: Recording) -> Recording:
    """Three readings of 60 degC, as a loose plug gives them."""
    warm = recording.array("T").copy()
    warm[[100, 700, 1500]] = 60.0
    return Recording(recording.manifest, recording.frame.assign(T=warm))


def test_three_rows_of_60_degrees_do_not_widen_validity(tmp_path: Path) -> None:
    recording = axis(4, runs=6, rows=1770)
    hot = with_hot_rows(recording)
    model = terms({"term": "offset"}, EXPANSION).fit(hot).model
    assert model.validity.ranges["T"][1] < 25.1
    assert any("3 of 1770 rows (60 to 60 degC)" in note and "leverage" in note for note in model.notes)
    more = "  - {kind: export, ungated: true}"
    assert run(tmp_path, hot, more) == 0
    from errpipe.verbs.evaluate import evaluate as ask

    at = ask(tmp_path / "out/export/table.ect", {"x": 500.0, "T": 58.0})["deviation"]["EXX"]
    inside = ask(tmp_path / "out/export/table.ect", {"x": 500.0, "T": 25.0})["deviation"]["EXX"]
    assert abs(at) <= abs(inside) and abs(at) < 30.0


def test_every_target_of_a_short_test_is_covered() -> None:
    assert covered(np.tile(np.linspace(0.0, 500.0, 5), 20)) == (0.0, 500.0)
    assert covered(np.r_[np.linspace(18, 25, 1000), [60.0, 45.0, 33.0], [-20.0]]) == (18.0, 25.0)


def test_a_model_predicts_outside_validity_as_its_table_does(tmp_path: Path) -> None:
    assert run(tmp_path, axis(3), "  - {kind: validate}\n  - {kind: export}") == 0
    far = axis(9, runs=2, rows=40)
    # an hour a row: a reading that moves faster than its sensor can is held by the table, and not by the model
    slow = {"t": 3600.0 * np.arange(40.0), "T": np.linspace(20.0, 1000.0, 40)}
    far = Recording(far.manifest, far.frame.assign(**slow))
    manifest_folder.write(far, tmp_path / "far")
    export = tmp_path / "out" / "export"
    for source in (_artefacts.MODEL, _artefacts.TABLE):
        out = str(tmp_path / f"{source}.csv")
        assert main(["predict", str(export / source), str(tmp_path / "far"), "--out", out]) == 0
    files = (tmp_path / f"{source}.csv" for source in (_artefacts.MODEL, _artefacts.TABLE))
    by_model, by_table = (pd.read_csv(file)["EXX_predicted"] for file in files)
    assert np.allclose(by_model, by_table, atol=1e-9) and np.abs(by_model).max() < 60.0
