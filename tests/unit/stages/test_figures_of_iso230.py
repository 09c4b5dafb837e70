"""The stage `validate` beside a test that is none of ISO 230-2."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.formats import manifest_folder

PIPELINE = """
pipeline: 1
stages:
  - {kind: ingest, recording: rows}
  - {kind: fit, components: [{component: EXX, terms: [{term: offset}, {term: scale_error, axis: X}]}]}
  - {kind: validate, iso230_2: %s}
"""
COLUMNS = {
    "run": Column(role="run"),
    "x": Column(role="position", axis="X", unit="mm"),
    "side": Column(role="direction", axis="X"),
    "EXX": Column(role="error", component="EXX", unit="um"),
}


@pytest.mark.parametrize(("asked", "code"), [("true", 3), ("false", 0)])
def test_targets_that_jitter_are_judged_without_the_figures(tmp_path, monkeypatch, capsys, asked, code):
    rng = np.random.default_rng(1)
    x = np.concatenate([np.r_[np.arange(0.0, 200.0, 10.0), np.arange(190.0, -1.0, -10.0)]] * 3)
    x += rng.normal(0.0, 0.03, x.size)
    side = np.tile(np.repeat([1.0, -1.0], 20), 3)
    frame = pd.DataFrame(
        {"run": np.repeat([*"123"], 40), "x": x, "side": side, "EXX": x / 20 + rng.normal(0, 0.1, 120)}
    )
    recording = Recording(Manifest(recording=1, tables=("recording.parquet",), columns=COLUMNS), frame)
    manifest_folder.write(recording, tmp_path / "rows")
    (tmp_path / "p.yaml").write_text(PIPELINE % asked)
    monkeypatch.chdir(tmp_path)
    assert main(["run", "p.yaml", "--out", "out"]) == code
    assert ("With iso230_2: false" in capsys.readouterr().err) == bool(code)
