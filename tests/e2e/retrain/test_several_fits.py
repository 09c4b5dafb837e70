"""A pipeline with a fit for each component, as `errpipe init` writes them: all of them are judged, none is left out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.error_model import ErrorModel
from errpipe.verbs import fleet_processes
from tests.e2e.retrain.test_retrain import MANIFEST, record

FIT = """
  - kind: fit
    name: fit_{0}
    components:
      - component: {0}
        terms:
          - {{term: offset}}
          - {{term: chebyshev, axis: X, degree: 2}}
          - {{term: scale_expansion, axis: X, sensor: T_nut}}
          - {{term: scale_expansion, axis: X, sensor: T_bed}}
    holdout: {{scheme: batches, blocks: 4}}
  - {{kind: validate, name: validate_{0}}}"""
PIPELINE = "pipeline: 1\ntitle: two fits\nstages:\n  - {kind: ingest, recording: recording}"


def recorded(folder: Path, days: int, straightness: Callable[[pd.DataFrame], pd.Series]) -> None:
    """A recording of EXX and of EYX, which is a function of the recorded columns."""
    record(folder, days)
    rows = pd.read_csv(folder / "recording.csv")
    rows.assign(EYX=straightness(rows)).to_csv(folder / "recording.csv", index=False)
    column = "  EYX: {role: error, component: EYX, unit: um}\n"
    (folder / "recording.yaml").write_text(MANIFEST + column, encoding="utf-8")


@pytest.mark.slow
def test_every_fit_is_judged_by_the_new_runs_and_its_change_is_named(tmp_path: Path) -> None:
    """The level of the first fit's response moves on night 12, the second's is as before."""
    pipeline = tmp_path / "axis.yaml"
    pipeline.write_text(PIPELINE + "".join(map(FIT.format, ("EYX", "EXX"))) + "\n", encoding="utf-8")
    recorded(tmp_path / "recording", 12, lambda rows: rows["EXX"] / 2)
    champion, out = tmp_path / "champion", tmp_path / "out"
    assert main(["run", str(pipeline), "--out", str(champion)]) == 0
    recorded(tmp_path / "recording", 20, lambda rows: rows["EXX"] / 2 + 15.0 * (rows["t"] >= 86400 * 12))
    main(["retrain", str(pipeline), "--champion", str(champion), "--out", str(out)])
    document = json.loads((out / "retrain.json").read_text(encoding="utf-8"))
    assert {s["component"] for s in document["runs"]} == {"EYX", "EXX"} == set(document["change"])
    assert {g["name"] for g in document["gates"]} >= {"coverage of EYX", "coverage of EXX"}
    assert [c["component"] for c in document["drift"]["changes"]] == ["EYX"]


def test_a_fleet_reports_every_fit_and_pools_and_borrows_for_each(tmp_path: Path, monkeypatch: Any) -> None:
    """The sensors of machine m4 read the same: it borrows their gains, for both components."""
    monkeypatch.setattr(
        fleet_processes, "in_processes", lambda tasks, jobs: (fleet_processes.run_machine(*task) for task in tasks)
    )
    (tmp_path / "axis.yaml").write_text(PIPELINE + "".join(map(FIT.format, ("EYX", "EXX"))) + "\n", encoding="utf-8")
    recorded(tmp_path / "all/m0", 4, lambda rows: rows["EXX"] / 2)
    rows = pd.read_csv(tmp_path / "all/m0/recording.csv")
    for k in range(1, 5):
        shutil.copytree(tmp_path / "all/m0", tmp_path / f"all/m{k}")
        own = rows.assign(EXX=rows["EXX"] * (1 + k / 20), EYX=rows["EYX"] * (1 - k / 20))
        (own.assign(T_bed=own["T_nut"]) if k == 4 else own).to_csv(tmp_path / f"all/m{k}/recording.csv", index=False)
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text("fleet: 1\npipeline: axis.yaml\nrecordings: all\npool: true\n", encoding="utf-8")
    assert main(["fleet", str(fleet), "--out", str(tmp_path / "out")]) == 0
    document = json.loads((tmp_path / "out/fleet.json").read_text(encoding="utf-8"))
    assert [set(r["responses"]) for r in document["machines"]] == [{"EYX", "EXX"}] * 5
    assert set(document["types"][0]["responses"]) == {"EYX", "EXX"}
    assert [r["name"] for r in document["machines"] if r["borrows"]] == ["m4"]
    for k in range(5):
        pooled = ErrorModel.model_validate_json((tmp_path / f"out/pooled/m{k}/error_model.json").read_text())
        assert [c.component for c in pooled.components] == ["EYX", "EXX"]


DRIFT = """
  - kind: fit
    name: fit_EYX
    components: [{component: EYX, terms: [{term: offset}, {term: thermal_drift, sensor: T_nut}]}]
    holdout: {scheme: batches, blocks: 4}
  - {kind: validate, name: validate_EYX}"""
EXPORT = "\n  - {{kind: export, name: export_{0}, from: {{error_model: fit_{0}}}, ungated: true}}"


def straight(rows: pd.DataFrame) -> pd.Series:
    """A straightness error that follows the nut, and from night 12 on by half as much again."""
    growth = 1.0 + 0.5 * (rows["t"] >= 86400 * 12)
    return 2.0 * (rows["T_nut"] - 20.0) * growth + np.sin(7.3 * rows.index)


def with_champion(folder: Path, *parts: str) -> Path:
    """A pipeline, and its champion of twelve nights."""
    (folder / "axis.yaml").write_text("".join([PIPELINE, *parts, "\n"]), encoding="utf-8")
    recorded(folder / "recording", 12, straight)
    assert main(["run", str(folder / "axis.yaml"), "--out", str(folder / "champion")]) == 0
    return folder / "axis.yaml"


def test_fits_with_an_export_each_are_all_judged_and_their_evidence_is_kept_from_night_to_night(tmp_path: Path) -> None:
    """One of the fits reads the axis, the other does not; neither export reads both."""
    both = FIT.format("EXX"), EXPORT.format("EXX"), DRIFT, EXPORT.format("EYX")
    pipeline, looks = with_champion(tmp_path, *both), []
    for nights in (14, 14, 16):
        recorded(tmp_path / "recording", nights, straight)
        main(["retrain", str(pipeline), "--champion", str(tmp_path / "champion"), "--out", str(tmp_path / "out")])
        looks.append(json.loads((tmp_path / "out/retrain.json").read_text(encoding="utf-8")))
    first, again, last = ([(s["component"], s["run"], s["challenger"]) for s in look["runs"]] for look in looks)
    assert {component for component, *_ in first} == {"EXX", "EYX"} and len(first) == 4
    assert again == first and looks[1]["e_value"] == looks[0]["e_value"]
    assert last[:4] == first and len(last) == 8


def test_fits_that_make_no_common_table_are_refused_with_what_to_do(tmp_path: Path, capsys: Any) -> None:
    from_start = (
        FIT.format("EYX")
        .replace("          - {term: offset}\n", "")
        .replace("fit_EYX", "fit_EYX\n    datum: run_start")
    )
    pipeline = with_champion(tmp_path, FIT.format("EXX"), from_start)
    capsys.readouterr()
    code = main(["retrain", str(pipeline), "--champion", str(tmp_path / "champion"), "--out", str(tmp_path / "out")])
    says = " ".join(capsys.readouterr().err.split())
    assert code == 2 and "differ in zero" in says and "a pipeline and a champion of its own" in says
