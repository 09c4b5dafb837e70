"""What is exported is better over runs: a gain in rows alone, however many there are, is chance."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import ttest_rel

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.fitting.judging import HeldOut
from errpipe.formats import manifest_folder
from errpipe.models.terms import Terms
from errpipe.validation import significance
from tests.validation_document import held_out

ROWS = 200  # of a run
# Offsets of six runs, um: left out in turn, the mean of the others leaves less of all rows and more of every other run.
UNEVEN = (9.0, 1.0, 9.0, -2.0, 8.0, -1.0)
ALIKE = (4.0, 4.2, 3.9, 4.1, 3.8, 4.0)
OFFSET = {"component": "EXX", "terms": [{"term": "offset"}]}
PIPELINE = """pipeline: 1
stages:
  - {kind: ingest, recording: recording}
  - {kind: fit, components: [{component: EXX, terms: [{term: offset}]}]}
  - {kind: validate}
  - {kind: export}
"""


def recorded(offsets) -> Recording:
    n = ROWS * len(offsets)
    noise = np.random.default_rng(3).normal(0.0, 0.3, n)
    frame = pd.DataFrame(
        {
            "run": np.repeat(np.arange(len(offsets)), ROWS).astype(str),
            "t": np.arange(n, dtype=float),
            "x": np.resize(np.linspace(0.0, 500.0, 50), n),
            "EXX": np.repeat(offsets, ROWS) + noise,
        }
    )
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    constants = {"X": Constant(role="axis", kind="linear", travel=(0, 500), unit="mm")}
    return Recording(Manifest(recording=1, tables=("r.parquet",), columns=columns, constants=constants), frame)


def figures(recording: Recording) -> dict:
    (judged,) = held_out(recording, Terms.model_validate({"components": [OFFSET]}))["components"]
    return judged


def test_a_gain_in_rows_but_not_in_runs_is_none(monkeypatch):
    recording = recorded(UNEVEN)
    values = figures(recording)
    assert values["rms_after"] < 0.95 * values["rms_before"], "of all rows it leaves less"
    own = np.array(UNEVEN)
    left = own - (own.sum() - own) / (own.size - 1)
    assert ttest_rel(np.repeat(own**2, ROWS), np.repeat(left**2, ROWS), alternative="greater").pvalue < 1e-3
    assert values["runs"] == 6 and values["p_value"] > significance.LEVEL
    assert values["verdict"] == "do nothing" and values["gain"] == 0.0
    # Counted by rows, as the same figures would be without this rule, it would be exported.
    monkeypatch.setattr(significance, "_units", lambda recording, folds: np.concatenate([f.rows for f in folds]))
    assert figures(recording)["gain"] > 0.0


def test_a_gain_in_every_run_is_one():
    values = figures(recorded(ALIKE))
    assert values["p_value"] < 1e-4 and values["verdict"] == "model"


@pytest.mark.parametrize(("offsets", "code"), [(UNEVEN, 4), (ALIKE, 0)])
def test_what_runs_do_not_agree_on_is_not_exported(tmp_path: Path, offsets, code: int):
    manifest_folder.write(recorded(offsets), tmp_path / "recording")
    (tmp_path / "p.yaml").write_text(PIPELINE)
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == code
    exported = list((tmp_path / "out").rglob("*.ect"))
    assert bool(exported) == (code == 0)
    if code == 0:
        assert json.loads((tmp_path / "out" / "export" / "export.json").read_text())["judged"]


def halves(deviation: np.ndarray, sensor: np.ndarray) -> list[HeldOut]:
    """Six blocks of one run, each half predicted by the gain of the other one."""
    out, half = [], deviation.size // 2
    for rows, others in ((slice(0, half), slice(half, None)), (slice(half, None), slice(0, half))):
        gain = sensor[others] @ deviation[others] / (sensor[others] @ sensor[others])
        for block in np.array_split(np.arange(deviation.size)[rows], 3):
            left = deviation[block] - gain * sensor[block]
            out.append(HeldOut("", block, deviation[block], left, np.zeros(block.size), 0.0))
    return out


def test_two_independent_drifts_rarely_pass_as_halves_of_one_run() -> None:
    """Pairs of random walks; rows taken for independent, a third of them would pass."""
    rng, passed = np.random.default_rng(4), 0
    for _ in range(300):
        folds = halves(*np.cumsum(rng.normal(size=(2, 600)), axis=1))
        passed += significance.p_between_halves(folds, 1.0)[0] <= significance.HALVES_LEVEL
    assert passed <= 9


def test_the_error_of_a_runs_zero_does_not_pass_as_halves_of_one_run() -> None:
    """White noise counted from the mean of three readings, beside what rises: p was 7e-20, and it was exported."""
    rng, passed = np.random.default_rng(6), 0
    for _ in range(200):
        noise = rng.normal(0, 0.3, 2400)
        folds = halves(noise - noise[:3].mean(), 1.0 - np.exp(-np.linspace(0.01, 9.0, 2400)))
        passed += significance.p_between_halves(folds, 1.0)[0] <= significance.HALVES_LEVEL
    assert passed == 0


def test_a_sensor_that_shows_the_deviation_passes_as_halves_of_one_run() -> None:
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 1.0, 400)
    duty = np.repeat(rng.uniform(0.0, 1.0, 8), 50)
    warm = np.array([np.exp(-(t[k] - t[: k + 1]) / 0.08) @ duty[: k + 1] for k in range(400)])
    growth, shown = 2.0 * warm + rng.normal(0, 1.0, 400), warm + rng.normal(0, 0.3, 400)
    p, worth = significance.p_between_halves(halves(growth, shown), 1.0)
    assert p < 1e-6 and 2 < worth < 40
    assert significance.p_between_halves(halves(growth, rng.normal(0, 1.0, 400)), 1.0)[0] > 0.05


@pytest.mark.parametrize(("p", "left", "helps"), [(1e-5, 0.9, True), (1e-3, 0.05, True), (1e-3, 0.3, False)])
def test_halves_that_leave_it_open_are_joined_by_blocks_inside_the_run(p: float, left: float, helps: bool) -> None:
    assert significance.helps_between_halves(p, lambda: left) == helps
    assert not significance.helps_between_halves(
        0.05, lambda: pytest.fail("blocks are judged where halves leave it open")
    )
