"""A probe that is knocked, or a datum that is set anew, within a run of a drift: validation says where."""

import json

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting.judging import HeldOut
from errpipe.formats import manifest_folder
from errpipe.simulation import spindle_drift
from errpipe.validation.steps import unexplained_steps

RUNS, ROWS = 6, 540  # of nine hours, a reading a minute


def residuals(seed: int) -> np.ndarray:
    """What a model leaves, um, (runs, rows): noise of 0.5 um on a random walk of 0.1 um a minute."""
    rng = np.random.default_rng(seed)
    return 0.5 * rng.standard_normal((RUNS, ROWS)) + np.cumsum(0.1 * rng.standard_normal((RUNS, ROWS)), axis=1)


def found(left: np.ndarray, **position: np.ndarray) -> list[dict]:
    run = np.repeat(np.arange(RUNS), ROWS)
    columns = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    columns |= {"E_Z": Column(role="error", component="E_Z", unit="um")}
    columns |= {name: Column(role="position", axis="X", unit="mm") for name in position}
    frame = pd.DataFrame({"run": run.astype(str), "t": np.tile(60.0 * np.arange(ROWS), RUNS), "E_Z": left.ravel()})
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame.assign(**position))
    folds = [HeldOut(str(k), np.flatnonzero(run == k), e, e, np.zeros(ROWS), 0.0) for k, e in enumerate(left)]
    return unexplained_steps(recording, "E_Z", folds)


def test_sound_runs_step_less_often_than_stated():
    """200 recordings of 54 h: 11 alarms expected at most at the stated rate."""
    assert sum(len(found(residuals(seed))) for seed in range(200)) <= 11


@pytest.mark.parametrize("size", [30.0, -5.0])
def test_a_step_is_found_in_its_row_and_with_its_size(size):
    left = residuals(7)
    left[3, 200:] += size
    (step,) = found(left)
    assert (step["run"], step["row"], step["t"]) == ("3", 3 * ROWS + 200, 12000.0)
    assert step["step"] == pytest.approx(size, abs=2.0)


def test_a_wrong_reading_a_warm_up_and_steps_over_a_position_are_none():
    wrong, warm = residuals(8), residuals(8)
    wrong[3, 200] += 30.0
    warm[3, 200:] += 30.0 * (1.0 - np.exp(-np.arange(ROWS - 200) / 20.0))
    assert found(wrong) == [] and found(warm) == []
    left = residuals(7)
    left[3, 200:] += 30.0
    assert found(left, X=np.tile(np.arange(ROWS), RUNS)) == []


def test_steps_that_a_model_often_leaves_are_not_attributed_to_the_probe():
    """Growth at high speed that no sensor shows: up and down again all day."""
    left = residuals(9) + 10.0 * (np.arange(ROWS) // 30 % 2)
    assert found(left) == []


def test_a_knocked_probe_is_reported_in_the_summary_and_in_the_report(tmp_path, capsys):
    recording, _ = spindle_drift.simulate(3)
    knocked = recording.array("E_Z").copy()
    rows = np.flatnonzero(recording.run_codes() == 2)
    knocked[rows[150:]] += 30.0
    manifest_folder.write(recording.with_columns({"E_Z": knocked}, {}), tmp_path / "recording")
    (tmp_path / "p.yaml").write_text(
        "pipeline: 1\nstages:\n  - {kind: ingest, recording: recording}\n"
        "  - {kind: fit, family: rises, component: E_Z}\n  - {kind: validate}\n  - {kind: report}\n"
    )
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 0
    said = f"in run {recording.run_labels()[2]} at t = "
    (figures,) = json.loads((tmp_path / "out/validate/validation.json").read_text())["components"]
    assert [s["row"] for s in figures["steps"]] == [rows[150]]
    assert "no input of the model explains" in " ".join(capsys.readouterr().out.split())
    assert said in (tmp_path / "out/report/report.html").read_text()
