"""A run whose temperatures and deviations were logged an hour apart: validation says which, and by how much."""

import json

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting.judging import HeldOut
from errpipe.formats import manifest_folder
from errpipe.validation import clocks

RUNS, ROWS = 6, 540  # of nine hours, a reading a minute


def warmed(seed: int) -> np.ndarray:
    """Growth by loads of some ten minutes each and a time constant of an hour, um, (runs, rows)."""
    load = np.repeat(np.random.default_rng(seed).uniform(0.0, 40.0, (RUNS, ROWS // 30)), 30, axis=1)
    out = np.zeros((RUNS, ROWS))
    for k in range(1, ROWS):
        out[:, k] = out[:, k - 1] + (load[:, k] - out[:, k - 1]) / 60.0
    return out


def found(predicted: np.ndarray, seed: int = 0, late: int = 0, **position: np.ndarray) -> list[dict]:
    """late: minutes by which the model is late in every run."""
    run = np.repeat(np.arange(RUNS), ROWS)
    columns = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    columns |= {"E_Z": Column(role="error", component="E_Z", unit="um")}
    columns |= {name: Column(role="position", axis="X", unit="mm") for name in position}
    truth = warmed(seed) + 0.5 * np.random.default_rng(seed + 1000).standard_normal((RUNS, ROWS))
    frame = pd.DataFrame({"run": run.astype(str), "t": np.tile(60.0 * np.arange(ROWS), RUNS), "E_Z": truth.ravel()})
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame.assign(**position))
    left = truth - np.roll(predicted, late, axis=1)
    folds = [HeldOut(str(k), np.flatnonzero(run == k), e, left[k], np.zeros(ROWS), 0.0) for k, e in enumerate(truth)]
    return clocks.shifted_runs(recording, folds)


@pytest.mark.parametrize("minutes", [60, -60, 90])
def test_a_run_an_hour_off_is_found_with_its_shift(minutes):
    predicted = warmed(0)
    predicted[3] = np.roll(predicted[3], minutes)
    (run,) = found(predicted)
    assert run["run"] == "3" and run["shift"] == pytest.approx(60.0 * minutes, abs=300.0) and run["left"] < 0.5
    assert f"3 by {abs(minutes)} min" in clocks.in_words({"component": "E_Z", "clocks": [run]}).replace("about ", "")
    assert found(predicted, X=np.tile(np.arange(ROWS), RUNS)) == []


def test_sound_runs_and_a_model_that_is_late_or_wrong_in_all_of_them_are_none():
    for seed in range(20):
        assert found(warmed(seed), seed) == []
        assert found(warmed(seed), seed, late=30) == []  # a lag that the model lacks
        assert found(0.5 * warmed(seed), seed) == []
        assert found(warmed(seed + 1), seed) == []  # nothing to do with what happened


def test_a_run_of_another_clock_is_reported_in_the_summary_and_in_the_report(tmp_path, capsys):
    growth = warmed(0)
    growth[2] = np.roll(growth[2], 60)
    run = np.repeat(np.arange(1, RUNS + 1), ROWS).astype(str)
    columns = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    columns |= {"E_Z": Column(role="error", component="E_Z", unit="um"), "T": Column(role="temperature", unit="degC")}
    noise = np.random.default_rng(1).standard_normal((2, run.size))
    frame = pd.DataFrame({"run": run, "t": 60.0 * np.arange(run.size), "E_Z": growth.ravel() + 0.3 * noise[0]})
    frame["T"] = 20.0 + warmed(0).ravel() / 4.0 + 0.02 * noise[1]
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)
    manifest_folder.write(recording, tmp_path / "recording")
    (tmp_path / "p.yaml").write_text(
        "pipeline: 1\nstages:\n  - {kind: ingest, recording: recording}\n"
        "  - {kind: fit, family: rises, component: E_Z}\n  - {kind: validate}\n  - {kind: report}\n"
    )
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 0
    (figures,) = json.loads((tmp_path / "out/validate/validation.json").read_text())["components"]
    assert [c["run"] for c in figures["clocks"]] == ["3"]
    assert "logged by clocks that differ" in " ".join(capsys.readouterr().out.split())
    assert "logged by clocks that differ" in (tmp_path / "out/report/report.html").read_text()
