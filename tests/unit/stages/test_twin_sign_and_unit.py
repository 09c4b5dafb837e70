"""A simulation of the other sign or in another unit is reported before any missing physics; nothing is written over."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.diagnosis import Diagnosis
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.formats import manifest_folder
from errpipe.stages import diagnose as stage
from errpipe.stages.diagnose import sign_and_unit_warnings


def recording(factor: float) -> Recording:
    """30 places in 5 runs: a lead error that the simulation has, a backlash that it lacks; it is `factor` of itself."""
    x = np.tile(np.r_[np.arange(0.0, 500.0, 33.0), np.arange(495.0, 0.0, -33.0)], 5)
    side = np.tile(np.repeat([1.0, -1.0], 16), 5)[: x.size]
    noise = np.random.default_rng(5).normal(0.0, 0.3, x.size)
    frame = pd.DataFrame({"x": x, "dir": side, "E": 0.04 * x + 2.0 * side + noise, "S": factor * 0.04 * x})
    columns = {
        "x": Column(role="position", axis="X", unit="mm"),
        "dir": Column(role="direction", axis="X"),
        "E": Column(role="error", component="EXX", unit="um"),
        "S": Column(role="simulated", component="EXX", unit="um"),
    }
    return Recording(Manifest(recording=1, tables=("x.csv",), columns=columns), frame)


@pytest.mark.parametrize(
    ("factor", "output"),
    [(1.0, ""), (-1.0, "one of them has the other sign"), (1e-3, "one of them is probably not in um"), (0.0, "")],
)
def test_a_reversed_sign_and_another_unit_are_reported(factor: float, output: str) -> None:
    said = sign_and_unit_warnings(recording(factor))
    assert [output in s for s in said] == ([True] if output else [])


def test_what_is_missing_may_have_the_other_sign_than_what_is_simulated() -> None:
    """Physics that is missing outweighs what is simulated: its sign cannot be determined."""
    one = recording(1.0)
    assert sign_and_unit_warnings(one.with_columns({"E": one.array("E") - 0.2 * one.array("x")}, {})) == ()


def test_the_doubt_stands_first_in_the_answer_and_in_the_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stage, "judge", lambda recording, progress: (Diagnosis(responses=()), []))
    manifest_folder.write(recording(-1.0), tmp_path / "in")
    answer = stage.diagnose(tmp_path / "in", tmp_path / "out")
    assert "one of them has the other sign" in answer["says"][0]
    assert "one of them has the other sign" in (tmp_path / "out/report.html").read_text(encoding="utf-8")


def test_apply_replaces_no_recording(tmp_path: Path, capsys: Any) -> None:
    for name in ("in", "other"):
        manifest_folder.write(recording(1.0), tmp_path / name)
    before = (tmp_path / "other/recording.yaml").read_bytes()
    words = ["diagnose", str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--apply", str(tmp_path / "other")]
    assert main(words) == 2
    assert "contains a recording that is not a corrected simulation" in capsys.readouterr().err
    assert (tmp_path / "other/recording.yaml").read_bytes() == before and not (tmp_path / "out").exists()
