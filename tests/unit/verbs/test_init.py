"""`errpipe init --recording`: a template that fits what the recording lacks is refused before anything is written."""

from __future__ import annotations

from pathlib import Path

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
    assert "{rule: stuck_sensors}" in (tmp_path / "work" / "pipeline.yaml").read_text()


def test_a_sensor_that_cleaning_set_aside_is_named_with_the_reason(tmp_path: Path, capsys) -> None:
    """Before: "the recording has no such column ... Did you mean bed_t?"."""
    made = sample_recordings.gantry()
    kelvin = made.frame.assign(frame_t=made.frame["frame_t"] + 273.15)
    recording_folder.write(tmp_path / "recording", Recording(made.manifest, kelvin))
    init(tmp_path / "work", "gantry", tmp_path / "recording")
    assert main(["run", str(tmp_path / "work" / "pipeline.yaml"), "--out", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().err
    assert "frame_t: cleaning set it aside: reads" in said and "kelvin" in said and "Did you mean" not in said


def test_of_several_drifts_the_widest_is_modelled_and_the_others_are_named(tmp_path: Path) -> None:
    """Before: the first column, X of 5 um, and nothing said that Z of 50 um was left."""
    made = sample_recordings.gantry()
    (name,) = made.names("error")
    columns = {"small": made.manifest.columns[name].model_copy(update={"component": "E_X"}), **made.manifest.columns}
    manifest = made.manifest.model_copy(update={"columns": columns})
    frame = made.frame.assign(small=0.1 * made.frame[name])
    recording_folder.write(tmp_path / "recording", Recording(manifest, frame))
    init(tmp_path / "work", "spindle-drift", tmp_path / "recording")
    component = made.manifest.columns[name].component
    text = (tmp_path / "work" / "pipeline.yaml").read_text()
    assert f"component: {component}  # recorded too: E_X\n" in text and f"drift, {component}\n" in text
