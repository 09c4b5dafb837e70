"""Terms, formats, targets, refusals, the doctor and `show`: what people look up is there, within 80 columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.simulation import folder, sample_recordings
from errpipe.tables import ect
from errpipe.validation.codes import EXPLANATIONS
from errpipe.verbs import show
from tests.unit.targets.machines import too_long_at_plus_x


def said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(list(words)) == 0
    return capsys.readouterr().out


def test_terms_and_one_term(capsys: pytest.CaptureFixture[str]) -> None:
    page = said(capsys, "terms")
    assert "backlash " in page and page.rstrip().endswith(".")  # whole sentences
    assert all(word in page for word in ("the larger the shift", "zero at rest"))
    page = said(capsys, "terms", "backlash")
    assert "deviation(d) = -lost_motion / 2 * d" in page and "2 … 20" in page
    assert main(["terms", "backlsh"]) == 2
    assert "Did you mean backlash?" in capsys.readouterr().err


def test_formats_and_targets(capsys: pytest.CaptureFixture[str]) -> None:
    page = said(capsys, "formats")
    assert all(name in page for name in ("ecmc_dat", "Excel", "TDMS", "HDF5", "MTConnect", "halsampler"))
    assert "Sign" in said(capsys, "targets", "linuxcnc_screw")


@pytest.mark.parametrize("code", [*EXPLANATIONS, *"0123456", "GateError", "ConfigError", "DataError", "VerifyError"])
def test_everything_that_is_refused_is_explained(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(capsys, "explain", code).startswith(f"{code}: ")


def test_the_doctor(capsys: pytest.CaptureFixture[str]) -> None:
    page = said(capsys, "doctor")
    assert all(word in page for word in ("errpipe", "numpy", "C compiler", "cache folder", "threads", "extra excel"))


def test_show_plots_a_recording_and_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder.write(tmp_path / "rec", sample_recordings.laser())
    page = said(capsys, "show", str(tmp_path / "rec"))
    assert "EXX in um over x" in page and "kind: recording" in page
    ect.write(too_long_at_plus_x(), tmp_path / "table.ect")
    page = said(capsys, "show", str(tmp_path / "table.ect"))
    assert "correction of X in um over X" in page and "-10 |" in page


def test_show_says_what_every_file_of_a_run_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Lock, report, a controller's file in its folder and alone, and a file that the import opens."""
    from errpipe.reporting.run_report import RunReport, render
    from errpipe.targets import TARGETS

    (target,) = (t for t in TARGETS if t.name == "linuxcnc_screw")
    name = "x.comp"
    text = target.write(too_long_at_plus_x())[name]
    (tmp_path / name).write_text(text)
    (tmp_path / target.name).mkdir()
    (tmp_path / target.name / name).write_text(text)
    (tmp_path / "errpipe.lock").write_text('{"errpipe_lock": 1, "stages": {"ingest": {}}}')
    (tmp_path / "report.html").write_text(render(RunReport("A & B", "VMC", "0.1.0", "abc")))
    (tmp_path / "log.csv").write_text("target,error\n0,1\n10,2\n")
    assert "kind: lock of a run" in said(capsys, "show", str(tmp_path / "errpipe.lock"))
    assert "title: A & B" in said(capsys, "show", str(tmp_path / "report.html"))
    assert "next: errpipe import" in said(capsys, "show", str(tmp_path / "log.csv"))
    for file in (tmp_path / name, tmp_path / target.name / name):
        page = said(capsys, "show", str(file))
        assert "kind: controller file" in page and "linuxcnc_screw (LinuxCNC)" in page
        assert "correction of X in um over X" in page and "-10 |" in page


def test_a_plot_fits_eighty_columns() -> None:
    lines = show.plot([("+", np.arange(500.0), np.sin(np.arange(500.0) / 30)), ("-", [np.nan], [1.0])])
    assert max(map(len, lines)) <= 80
    assert show.plot([("+", [], [])]) == ["(no values)"]


def test_python_dash_m() -> None:
    import subprocess
    import sys

    run = subprocess.run([sys.executable, "-m", "errpipe", "--version"], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("errpipe ")
