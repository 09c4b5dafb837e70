"""`errpipe init` writes measured points in place of a polynomial where they leave clearly less in runs left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Recording
from errpipe.simulation import folder as recording_folder
from errpipe.simulation import sample_recordings
from errpipe.verbs import _init_curve, _init_heat


def _axis(local: float, seed: int = 1) -> Recording:
    """The sample of a laser, 10 um too long at the end of its travel, with a deviation of each target of its own."""
    rng, made = np.random.default_rng(seed), sample_recordings.laser()
    targets, at = np.unique(made.frame.x, return_inverse=True)
    curve = 10.0 * targets / targets.max() + local * rng.normal(size=targets.size)
    error = curve[at] - 1.5 * made.frame.dir + 0.4 * rng.normal(size=at.size)
    return Recording(made.manifest, pd.DataFrame({**made.frame, "EXX": np.round(error, 2)}))


def _pipeline(folder: Path, recording: Recording) -> str:
    recording_folder.write(folder / "recording", recording)
    assert main(["init", str(folder / "work"), "--recording", str(folder / "recording")]) == 0
    return (folder / "work" / "pipeline.yaml").read_text("utf-8")


@pytest.mark.parametrize("seed", range(2))
def test_a_screw_with_local_errors_gets_measured_points(
    tmp_path: Path, seed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    text = _pipeline(tmp_path, _axis(2.0, seed))
    assert "- {term: measured_points, axis: X}   # measured points: leave-one-run-out leaves" in text
    assert "chebyshev" not in text and "backlash" not in text and "term: offset" not in text
    assert "um with a polynomial" in " ".join(capsys.readouterr().out.split())
    assert main(["check", str(tmp_path / "work" / "pipeline.yaml")]) == 0


@pytest.mark.parametrize("seed", range(2))
def test_a_smooth_screw_keeps_its_polynomial(tmp_path: Path, seed: int) -> None:
    text = _pipeline(tmp_path, _axis(0.0, seed))
    assert "{term: chebyshev, axis: X, degree: 10}" in text and "{term: backlash, axis: X}" in text


def test_a_long_recording_is_judged_on_some_rows_of_every_target() -> None:
    once = _axis(2.0)
    often = Recording(once.manifest, pd.concat([once.frame] * 260, ignore_index=True))
    some = _init_curve.thinned(often)
    assert 0.98 * _init_heat.MAX_ROWS < len(some) < 1.02 * _init_heat.MAX_ROWS
    counts = some.frame.groupby(["x", "dir"]).size()
    assert counts.size == once.frame.groupby(["x", "dir"]).ngroups and counts.min() > 0.8 * counts.max()
    assert len(_init_curve.thinned(once)) == len(once)
