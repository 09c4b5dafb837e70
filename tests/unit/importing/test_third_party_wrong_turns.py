"""Wrong turns of the first five minutes: each ends in one line that names what was found and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from errpipe.cli.app import main
from tests.unit.importing.test_third_party_axes_and_sides import table

HEAD = "Run;Dir;Pos [mm];Deviation [um]"


def said(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    code = main([str(w) for w in words])
    out = capsys.readouterr()
    return code, " ".join((out.err + out.out).split())


def test_a_misspelt_file_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table(tmp_path / "positions.csv", HEAD, above="Axis X")
    (tmp_path / "pipeline.yaml").write_text("pipeline: 1\nstages: []\n", "utf-8")
    code, text = said(capsys, "import", tmp_path / "positions.cvs", "--out", tmp_path / "rec", "--yes")
    assert code == 3 and f"no such file. Did you mean {tmp_path / 'positions.csv'}?" in text
    code, text = said(capsys, "check", tmp_path / "pipelin.yaml")
    assert code == 2 and f"Did you mean {tmp_path / 'pipeline.yaml'}?" in text


def test_a_file_in_place_of_the_folder_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = table(tmp_path / "positions.csv", HEAD, above="Axis X")
    before = file.read_bytes()
    code, text = said(capsys, "import", file, "--out", file, "--yes")
    assert code == 2 and "is a file (a folder for the recording is needed)" in text and file.read_bytes() == before
    code, text = said(capsys, "verify", file)
    assert code == 3 and f"is no table (one, or the folder that an export wrote is needed: {tmp_path})" in text


def test_the_folder_of_a_pipeline_is_checked_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`check` looked for recording.yaml in it."""
    assert main(["init", "--template", "dial-gauge", str(tmp_path / "mill")]) == 0
    capsys.readouterr()
    assert said(capsys, "check", tmp_path / "mill")[0] == 0
    code, text = said(capsys, "run", tmp_path / "mill", "--out", tmp_path / "out")
    assert code == 2 and f"is a folder (a YAML file is needed: {tmp_path / 'mill' / 'pipeline.yaml'})" in text


def test_a_torn_file_is_no_test(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three rows, of which two hold a reading, were imported."""
    (tmp_path / "half.csv").write_text(f"Axis;X\n{HEAD}\n1;+;0;1\n1;+;60;2\n1;+;120", "utf-8")
    code, text = said(capsys, "import", tmp_path / "half.csv", "--out", tmp_path / "rec", "--yes")
    assert code == 3 and "2 rows with a reading" in text and not (tmp_path / "rec").exists()


def test_a_role_that_is_none_is_answered_with_the_roles(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = table(tmp_path / "positions.csv", HEAD, above="Axis X")
    code, text = said(capsys, "import", file, "--out", tmp_path / "rec", "--yes", "--set", "Deviation.role=banana")
    assert code == 2 and "no role 'banana' (allowed: run, group" in text
