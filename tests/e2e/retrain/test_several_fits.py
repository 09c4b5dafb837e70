"""A pipeline with a fit for each component, as `errpipe init` writes them: all of them are judged, none is left out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
