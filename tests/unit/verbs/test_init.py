"""`errpipe init --recording`: a template that fits what the recording lacks is refused before anything is written."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Recording
from errpipe.errors import UsageError
from errpipe.simulation import folder as recording_folder
from errpipe.simulation import sample_recordings
from errpipe.verbs.init import init


@pytest.mark.parametrize(
    ("template", "lacks"), [("spindle-drift", "temperature or spindle_speed"), ("gantry", "temperature")]
)
def test_a_template_that_needs_what_the_recording_lacks_is_refused(tmp_path: Path, template: str, lacks: str) -> None:
    """Before: `spindle-drift` was written for a laser's positioning test, checked as fine, and ended at its fit."""
    recording_folder.write(tmp_path / "recording", sample_recordings.dial_gauge())
    with pytest.raises(UsageError, match=f"no column of role {lacks}, which template {template} needs"):
        init(tmp_path / "work", template, tmp_path / "recording")
    assert not (tmp_path / "work").exists()

    with pytest.raises(UsageError, match=r"no error of E_X, which template drilled-plate needs \(it has: EXX\)"):
        init(tmp_path / "work", "drilled-plate", tmp_path / "recording")
    assert not (tmp_path / "work").exists()


@pytest.mark.parametrize(("component", "figures"), [("EXX", "true"), ("EYX", "false")])
def test_figures_of_iso_230_2_are_asked_for_of_a_positioning_alone(
    tmp_path: Path, component: str, figures: str
) -> None:
    """A straightness has none: the pipeline of its template ended with exit code 2."""
    made = sample_recordings.laser()
    columns = dict(made.manifest.columns)
    columns["EXX"] = columns["EXX"].model_copy(update={"component": component})
    manifest = made.manifest.model_copy(update={"columns": columns})
    recording_folder.write(tmp_path / "recording", Recording(manifest, made.frame))
    init(tmp_path / "work", "laser-iso230", tmp_path / "recording")
    assert f"iso230_2: {figures}" in (tmp_path / "work" / "pipeline.yaml").read_text()


def test_figures_of_iso_230_2_are_not_asked_for_where_a_target_was_visited_once(tmp_path: Path) -> None:
    """They were wherever there were two runs, and the pipeline ended there."""
    made = sample_recordings.laser()
    place = made.name("command", axis="X") or made.name("position", axis="X")
    frame = made.frame.copy()
    frame.loc[frame.index[0], place] += 0.5
    recording_folder.write(tmp_path / "recording", Recording(made.manifest, frame))
    init(tmp_path / "work", "laser-iso230", tmp_path / "recording")
    assert "iso230_2: false" in (tmp_path / "work/pipeline.yaml").read_text()


def test_the_pipeline_of_a_drift_looks_for_sensors_that_stand_still(tmp_path: Path) -> None:
    """A sensor stuck from 60 % of the rows on and ever after: 2.9 um left of the next season, now 1.8; healthy 1.1."""
    recording_folder.write(tmp_path / "recording", sample_recordings.gantry())
    init(tmp_path / "work", "spindle-drift", tmp_path / "recording")
    assert "{rule: unit_slips}, {rule: stuck_sensors}" in (tmp_path / "work" / "pipeline.yaml").read_text()


def test_a_sensor_that_cleaning_set_aside_is_named_with_the_reason(tmp_path: Path, capsys) -> None:
    """Before: "the recording has no such column ... Did you mean bed_t?"."""
    made = sample_recordings.gantry()
    kelvin = made.frame.assign(frame_t=made.frame["frame_t"] + 273.15)
    recording_folder.write(tmp_path / "recording", Recording(made.manifest, kelvin))
    init(tmp_path / "work", "gantry", tmp_path / "recording")
    assert main(["run", str(tmp_path / "work" / "pipeline.yaml"), "--out", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().err
    assert "frame_t: cleaning set it aside: reads" in said and "kelvin" in said and "Did you mean" not in said


def _two_drifts(folder: Path, small: float) -> None:
    """The gantry's recording with E_X = small * E_Z before its E_Z."""
    sample = sample_recordings.gantry()
    made = sample.take(np.arange(len(sample)) % 4 == 0)
    columns = {"small": made.manifest.columns["E_Z"].model_copy(update={"component": "E_X"}), **made.manifest.columns}
    manifest = made.manifest.model_copy(update={"columns": columns})
    recording_folder.write(folder, Recording(manifest, made.frame.assign(small=small * made.frame["E_Z"])))


@pytest.mark.slow
@pytest.mark.parametrize("template", ["spindle-drift", "gantry"])
def test_every_drift_of_a_recording_is_fitted_and_exported(tmp_path: Path, template: str) -> None:
    """Before: the widest alone; X of 5 um was left as it was."""
    _two_drifts(tmp_path / "recording", 0.1)
    init(tmp_path / "work", template, tmp_path / "recording")
    pipeline = str(tmp_path / "work" / "pipeline.yaml")
    assert main(["run", pipeline, "--out", str(tmp_path / "out")]) == 0
    table = json.loads((tmp_path / "out/export/table.json").read_text())
    assert {o["name"] for o in table["outputs"]} == {"E_Z", "E_X"}
    gains = {c["component"]: c["gain"] for c in json.loads((tmp_path / "out/export/export.json").read_text())["judged"]}
    assert gains == {"E_Z": 1.0, "E_X": 1.0}


def test_a_drift_that_never_changes_gets_no_fit(tmp_path: Path) -> None:
    """Its fit would be refused, and with it the whole pipeline."""
    _two_drifts(tmp_path / "recording", 0.0)
    init(tmp_path / "work", "spindle-drift", tmp_path / "recording")
    text = (tmp_path / "work" / "pipeline.yaml").read_text()
    assert text.count("kind: fit") == 1 and "E_X" not in text and "drift, E_Z\n" in text


def test_other_errors_of_a_static_recording_are_named(tmp_path: Path) -> None:
    """They need a model of their own: a positioning is not a straightness."""
    made = sample_recordings.laser()
    columns = made.manifest.columns | {"EYX": made.manifest.columns["EXX"].model_copy(update={"component": "EYX"})}
    manifest = made.manifest.model_copy(update={"columns": columns})
    recording_folder.write(tmp_path / "recording", Recording(manifest, made.frame.assign(EYX=made.frame["EXX"])))
    init(tmp_path / "work", "laser-iso230", tmp_path / "recording")
    text = (tmp_path / "work" / "pipeline.yaml").read_text()
    assert "component: EXX  # recorded too: EYX\n" in text and text.count("component: E") == 1


def test_a_target_that_is_none_is_refused_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It stood in the pipeline, and was refused by the first run only."""
    assert main(["init", "--template", "dial-gauge", str(tmp_path / "mill"), "--target", "siemens"]) == 2
    assert "sinumerik_lec" in capsys.readouterr().err.split("Did you mean")[1]
    assert not (tmp_path / "mill").exists()
