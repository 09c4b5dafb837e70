"""Deviations measured with a table switched on: its sign, since which run, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.formats import manifest_folder
from errpipe.tables import ect
from tests.unit.tables.made import ten_um_too_long

PLACES = np.arange(0.0, 1001.0, 100.0)
MANIFEST = """recording: 1
tables: [recording.csv]
columns:
  run: {role: run}
  x: {role: position, axis: X, unit: mm}
  EXX: {role: error, component: EXX, unit: um}
"""
PIPELINE = """pipeline: 1
title: measured with the table on
stages:
  - {kind: ingest, recording: recording, compensated_by: table.ect%s}
"""


def ingested(where: Path, readings: dict[str, np.ndarray], since: str = "") -> tuple[int, np.ndarray]:
    """Exit code of the pipeline, and the deviations after ingest."""
    rows = [(run, x, e) for run, errors in readings.items() for x, e in zip(PLACES, errors, strict=True)]
    (where / "recording").mkdir()
    pd.DataFrame(rows, columns=["run", "x", "EXX"]).to_csv(where / "recording" / "recording.csv", index=False)
    (where / "recording" / "recording.yaml").write_text(MANIFEST, encoding="utf-8")
    ect.write(ten_um_too_long(), where / "table.ect")
    said = f", compensated_since: {since}" if since else ""
    (where / "p.yaml").write_text(PIPELINE % said, encoding="utf-8")
    code = main(["run", str(where / "p.yaml"), "--out", str(where / "out")])
    if code:
        return code, np.array([])
    return code, manifest_folder.read(where / "out" / "ingest").array("EXX")


def test_what_the_table_took_away_is_added(tmp_path: Path) -> None:
    """10 um too long at +X = 1000: with its table on nothing is left to measure, and the machine is still too long."""
    code, errors = ingested(tmp_path, {"on": 0.0 * PLACES})
    assert code == 0
    assert errors == pytest.approx(10.0 * PLACES / 1000.0, abs=0.01)


def test_only_runs_since_it_was_switched_on(tmp_path: Path) -> None:
    machine = 10.0 * PLACES / 1000.0
    code, errors = ingested(tmp_path, {"before": machine, "after": 0.0 * PLACES}, since="after")
    assert code == 0
    assert errors == pytest.approx(np.tile(machine, 2), abs=0.01)


def test_a_run_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _ = ingested(tmp_path, {"on": 0.0 * PLACES}, since="later")
    assert code == 3
    assert "compensated_since: no run 'later' (there are on)" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options, kept",
    [("since_run: b", ["b", "c"]), ("without_runs: [b, gone]", ["a", "c"]), ("since_run: b, without_runs: [c]", ["b"])],
)
def test_runs_before_one_or_by_name_are_left_out(tmp_path: Path, options: str, kept: list[str]) -> None:
    rows = [(run, x, 1.0) for run in "abc" for x in PLACES]
    (tmp_path / "recording").mkdir()
    pd.DataFrame(rows, columns=["run", "x", "EXX"]).to_csv(tmp_path / "recording/recording.csv", index=False)
    (tmp_path / "recording/recording.yaml").write_text(MANIFEST, encoding="utf-8")
    text = PIPELINE.replace("compensated_by: table.ect%s", options)
    (tmp_path / "p.yaml").write_text(text, encoding="utf-8")
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 0
    assert manifest_folder.read(tmp_path / "out" / "ingest").run_labels() == tuple(kept)


def test_a_first_run_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    test_runs_before_one_or_by_name_are_left_out(tmp_path, "since_run: b", ["b", "c"])
    (tmp_path / "p.yaml").write_text(PIPELINE.replace("compensated_by: table.ect%s", "since_run: d"), encoding="utf-8")
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 3
    assert "since_run: no run 'd'" in capsys.readouterr().err
