"""`errpipe init` adds terms of temperatures to the model of an axis where runs left out want them, and only there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe import jsonfile
from errpipe.cli.app import main
from errpipe.domain.recording import Column, Recording
from errpipe.simulation import folder as recording_folder
from errpipe.simulation import sample_recordings
from errpipe.verbs import _init_heat

STATES = (17.0, 19.0, 20.0, 23.0, 26.0)  # degC of the screw, one for each run of the sample
GROWTH = 11.0  # um/m/K


def _axis(grows: float, seed: int = 1, moves: float = 1.0) -> Recording:
    """10 um too long at the end of its 500 mm at 20 degC, longer when warm; T_2 has nothing to do with it."""
    rng, made = np.random.default_rng(seed), sample_recordings.laser()
    f, run = made.frame, made.run_codes()
    warm = 20.0 + moves * (np.asarray(STATES)[run] - 20.0)
    other = 20.0 + moves * np.asarray([4.0, -3.0, 5.0, -4.0, 2.0])[run]
    error = f.x * (10.0 / 500.0 + 1e-3 * grows * (warm - 20.0)) + 0.4 * rng.normal(size=len(f))
    read = {name: np.round(t + 0.05 * rng.normal(size=len(f)), 2) for name, t in {"T 1": warm, "T_2": other}.items()}
    read["T 1"][[7, 8, 100]] = np.nan  # a sensor that was not read now and then is still proposed
    columns = {**made.manifest.columns, **{name: Column(role="temperature", unit="degC") for name in read}}
    manifest = made.manifest.model_copy(update={"columns": columns})
    return Recording(manifest, pd.DataFrame({**f, "EXX": np.round(error, 2), **read}))


def _pipeline(tmp_path: Path, recording: Recording, *options: str) -> str:
    recording_folder.write(tmp_path / "recording", recording)
    assert main(["init", str(tmp_path / "work"), "--recording", str(tmp_path / "recording"), *options]) == 0
    return (tmp_path / "work" / "pipeline.yaml").read_text("utf-8")


@pytest.mark.slow
def test_a_screw_that_grows_is_exported_with_its_growth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Before: the mean curve of all states, or nothing. Both files are errors: positive, the axis goes too far."""
    text = _pipeline(tmp_path, _axis(GROWTH))
    assert "terms of heat: leave-one-run-out leaves" in text and "terms of heat" in capsys.readouterr().out
    assert '{term: scale_expansion, axis: X, sensor: "T 1"}' in text and "T_2" not in text and "@" not in text
    out = tmp_path / "out"
    assert main(["check", str(tmp_path / "work" / "pipeline.yaml")]) == 0
    assert main(["run", str(tmp_path / "work" / "pipeline.yaml"), "--out", str(out)]) == 0
    assert main(["verify", str(out / "export")]) == 0
    (screw,) = (out / "export/sinumerik_lec").glob("AX1*")
    points = [float(line.split("=")[1]) for line in screw.read_text().splitlines() if "ENC_COMP[0" in line]
    warm = (out / "export/sinumerik_temperature/TEMP_COMP.SPF").read_text().splitlines()
    facts = dict(word.split("=", 1) for word in warm[1].split() if "=" in word)
    at, per_kelvin = float(facts["T0"]), 1e3 * float(facts["TAN_BETA_PER_K"])  # um/mm/K
    assert per_kelvin == pytest.approx(1e-3 * GROWTH, rel=0.03)
    cold = 1e3 * (points[-1] - points[0]) - 500.0 * per_kelvin * (at - 20.0)
    assert cold == pytest.approx(10.0, abs=0.8)  # um at 20 degC
    losses = {f["file"].split("/")[0]: f.get("losses", ()) for f in jsonfile.read(out / "export/export.json")["files"]}
    assert losses["sinumerik_lec"][0]["rms_um"] > 5.0 and losses["linuxcnc_hal"][0]["rms_um"] < 0.1


@pytest.mark.parametrize(("grows", "moves"), [(0.0, 1.0), (GROWTH, 0.1)], ids=["no growth", "temperatures stand"])
def test_without_heat_the_proposal_is_as_ever(tmp_path: Path, grows: float, moves: float) -> None:
    text = _pipeline(tmp_path, _axis(grows, moves=moves))
    assert "sensor:" not in text and "heat" not in text and "@" not in text
    assert "targets: [sinumerik_lec, linuxcnc_screw, heidenhain_com]\n" in text


@pytest.mark.parametrize(
    ("seasons", "scheme"),
    [
        (3, "{scheme: leave-one-group-out, of: season}"),
        pytest.param(2, "{scheme: leave-one-run-out}", marks=pytest.mark.slow),
    ],
)
def test_seasons_are_left_out_whole(tmp_path: Path, seasons: int, scheme: str) -> None:
    """The coarsest groups of which there are three; of two seasons runs are left out instead."""
    made = _axis(GROWTH)
    label = [f"season {code % seasons}" for code in made.run_codes()]
    parted = made.with_columns({"season": np.array(label, dtype=object)}, {"season": Column(role="group", of="season")})
    assert f"holdout: {scheme}   # terms of heat" in _pipeline(tmp_path, parted)


def test_targets_of_the_user_are_the_only_ones(tmp_path: Path) -> None:
    text = _pipeline(tmp_path, _axis(GROWTH), "--target", "c_runtime")
    assert "term: scale_expansion" in text and text.count("targets: ") == 1 and "targets: [c_runtime]\n" in text


def test_sensors_that_rise_together_are_not_both_proposed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The screw has a third of one and two thirds of the other: a fit of both is refused, and the run ended there."""
    monkeypatch.setattr(_init_heat, "_chance", lambda *figures: 0.0)  # as of many runs
    made = _axis(6.0 * GROWTH)
    warm = np.asarray(STATES)[made.run_codes()]
    part = 0.3 * np.asarray([0.5, -0.5, 0.6, -0.4, -0.2])[made.run_codes()]  # K by which they part
    _pipeline(tmp_path, made.with_columns({"T 1": warm + part, "T_2": warm - part / 2.0}, {}))
    pipeline = str(tmp_path / "work" / "pipeline.yaml")
    assert main(["run", pipeline, "--out", str(tmp_path / "out"), "--to", "fit"]) == 0
