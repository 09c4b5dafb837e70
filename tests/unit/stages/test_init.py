"""`errpipe init --recording`: a template that fits what the recording lacks is refused before anything is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from errpipe.domain.recording import Recording
from errpipe.errors import UsageError
from errpipe.simulation import folder as recording_folder
from errpipe.simulation import sample_recordings
from errpipe.stages.init import init


@pytest.mark.parametrize(
    ("template", "lacks"), [("spindle-drift", "temperature or spindle_speed"), ("gantry", "temperature")]
)
def test_a_template_that_needs_what_the_recording_lacks_is_refused(tmp_path: Path, template: str, lacks: str) -> None:
    """Before: `spindle-drift` was written for a laser's positioning test, checked as fine, and ended at its fit."""
    recording_folder.write(tmp_path / "recording", sample_recordings.dial_gauge())
    with pytest.raises(UsageError, match=f"no column of role {lacks}, which template {template} needs"):
        init(tmp_path / "work", template, tmp_path / "recording")
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
