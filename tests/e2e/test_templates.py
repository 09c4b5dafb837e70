"""Every template of `errpipe init` runs at once, from an empty folder, and its files are proved."""

from __future__ import annotations

from pathlib import Path

import pytest

from errpipe import jsonfile
from errpipe.cli import init as verb
from errpipe.cli.app import main
from errpipe.domain.recording import Recording
from errpipe.verbs.init import TEMPLATES


def test_the_help_lists_every_template() -> None:
    assert ", ".join(TEMPLATES) == verb.NAMES


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_is_checked(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--template", name, "work ä"]) == 0
    assert main(["check", "work ä/pipeline.yaml"]) == 0
    assert (
        (tmp_path / "work ä/pipeline.yaml").read_text(encoding="utf-8").startswith("# yaml-language-server: $schema=")
    )
    assert "@" not in (tmp_path / "work ä/pipeline.yaml").read_text(encoding="utf-8")
    assert main(["init", "--template", name, "work ä"]) == 2


def test_a_refused_export_writes_the_report_with_its_reason(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--template", "laser-iso230", "work"]) == 0
    assert main(["run", "work/pipeline.yaml", "--out", "out", "--set", "export.limit=3 um"]) == 4
    page = (tmp_path / "out/report/report.html").read_text(encoding="utf-8")
    assert "Refused:" in page and "[beyond-limit]" in page and "What will happen" not in page
    assert not (tmp_path / "out/export").exists()
    assert main(["run", "work/pipeline.yaml", "--out", "out"]) == 0
    page = (tmp_path / "out/report/report.html").read_text(encoding="utf-8")
    assert "Refused:" not in page and "will be commanded" in page and "ISO 230-2 chart" in page


@pytest.mark.slow
@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_runs_end_to_end(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["init", "--template", name, "work"]) == 0
    assert main(["run", "work/pipeline.yaml", "--out", "out"]) == 0
    if name == "diagnose-log":
        (recording,) = jsonfile.read(tmp_path / "out/diagnose/diagnosis.json")["responses"]
        assert "following_error" in {f["effect"] for f in recording["findings"]}
        return
    folder = next(tmp_path.glob("out/export*"))
    assert main(["verify", str(folder)]) == 0
    if (tmp_path / "out/validate").is_dir():
        for c in jsonfile.read(tmp_path / "out/validate/validation.json")["components"]:
            assert c["rms_after"] < 0.5 * c["rms_before"], c["component"]
    assert main(["plan", "work/pipeline.yaml", "--out", "out", "--exit-code"]) == 0


def test_a_gantry_of_its_owner_has_its_own_sensors_and_hold_out(tmp_path, monkeypatch):
    """One run, three sensors by other names of which two rise together: blocks of time are held out, by ridge."""
    from errpipe.formats import manifest_folder
    from errpipe.simulation import sample_recordings

    monkeypatch.chdir(tmp_path)
    sample = sample_recordings.gantry()
    one = sample.take(sample.run_codes() == 0)
    kinds = {n: c for n, c in one.manifest.columns.items() if n != "run"}
    kinds |= {"lamp top": kinds["bed_t"].model_copy()}
    frame = one.frame.drop(columns="run").assign(**{"lamp top": one.frame["bed_t"] * 1.5})
    own = Recording(one.manifest.model_copy(update={"columns": kinds}), frame)
    manifest_folder.write(own, tmp_path / "own")
    assert main(["init", "--template", "gantry", "work", "--recording", "own"]) == 0
    text = (tmp_path / "work/pipeline.yaml").read_text()
    assert 'sensor: "lamp top"' in text and "scheme: blocks" in text and "method: ridge" in text
    assert main(["run", "work/pipeline.yaml", "--out", "out", "--to", "fit"]) == 0
