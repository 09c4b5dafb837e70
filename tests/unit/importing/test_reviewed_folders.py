"""What names of folders, of runs and of states must not do: reverse a sign, lose readings, or end in a crash."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, prepared


def of_run(run: int) -> str:
    return "X (mm);Error (um)\n" + "".join(f"{x};{d}\n" for x, d in zip(TARGETS, deviation(run, 1.0), strict=True))


def folder_of(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def of_lines(tmp_path: Path, header: str, above: str = "") -> Path:
    rows = [f"{r};{x};{s:+g};{d}" for r, x, s, d in long_rows()]
    file = tmp_path / "f.csv"
    file.write_text("\n".join([above, f"Run;Target X [mm];Direction;{header}", *rows]), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    "header",
    [
        "Errore dopo compensazione",
        "Errore senza correzione",
        "Desviación antes de la compensación",
        "Desvio sem compensação",
        "Afwijking zonder compensatie",
        "Odchylka po kompenzaci",
        "Odchyłka przed korekcją",
        "Avvikelse utan kompensering",
        "Отклонение до коррекции",
        "補正後偏差",
    ],
)
def test_deviations_after_or_without_a_compensation_keep_their_sign(tmp_path: Path, header: str) -> None:
    """Each was read as a correction, as only English, German and French words of a state were known."""
    holds_the_truth(imported(tmp_path, of_lines(tmp_path, f"{header} [um]")))


@pytest.mark.parametrize("line", ["Soll-Ist-Vergleich", "Target-actual comparison", "Error type = bi-directional"])
def test_a_title_that_states_no_sign_changes_none(tmp_path: Path, line: str) -> None:
    holds_the_truth(imported(tmp_path, of_lines(tmp_path, "Deviation [um]", line)))


@pytest.mark.parametrize(
    "line", ["Control - laser measurement", "Nominal positions - measured with XL-80", "Soll-Ist-Abweichung"]
)
def test_a_title_whose_dash_may_be_no_minus_is_asked_about(tmp_path: Path, line: str) -> None:
    """It reversed the sign of the readings."""
    with pytest.raises(DataError, match="states the sign as"):
        imported(tmp_path, of_lines(tmp_path, "Deviation [um]", line))


def test_a_folder_of_data_for_a_compensation_does_not_reverse_deviations(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "compensation data", {f"run{r}.csv": of_run(r) for r in (1, 2)})
    found = imported(tmp_path, folder).array("Error")
    assert np.allclose(found, np.concatenate([deviation(r, 1.0) for r in (1, 2)]))


@pytest.mark.parametrize(("one", "other"), [("with", "without"), ("con", "sin"), ("mit", "ohne")])
def test_with_and_without_compensation_are_no_runs_of_one_test(tmp_path: Path, one: str, other: str) -> None:
    names = {f"{one} compensation/1.csv": of_run(1), f"{other} compensation/1.csv": of_run(2)}
    with pytest.raises(DataError, match="several states of the machine"):
        prepared([folder_of(tmp_path / "X", names)])


@pytest.mark.parametrize("word", ["final", "last"])
def test_a_named_run_below_numbered_ones_is_asked_about(tmp_path: Path, word: str) -> None:
    """It was excluded, as a statistic over the runs."""
    file = of_lines(tmp_path, "Deviation [um]")
    file.write_text(file.read_text().replace("\n3;", f"\n{word};"))
    with pytest.raises(DataError, match=f"'{word}', below numbered ones: a run, or a statistic"):
        prepared([file])


@pytest.mark.parametrize(
    ("header", "zone"),
    [("Time, UTC + 2", "+02:00"), ("Time (CET, UTC+1)", "+01:00"), ("Time (CET/CEST)", ""), ("Time UTC+25", "")],
)
def test_zones_in_a_header(tmp_path: Path, header: str, zone: str) -> None:
    rows = [
        f"2024-05-01 10:{i:02d}:00;{x};{d}" for i, (x, d) in enumerate(zip(TARGETS, deviation(1, 1.0), strict=True))
    ]
    (tmp_path / "f.csv").write_text("\n".join([f"{header};X (mm);Error (um)", *rows]))
    proposal = prepared([tmp_path / "f.csv"])[0]
    assert proposal.entries["t"]["epoch"] == f"2024-05-01T10:00:00{zone}"


def test_names_that_are_not_utf_8_are_refused(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "X", {"run1.csv": of_run(1)})
    Path(os.fsdecode(os.fsencode(folder) + b"/L\xe4uf2.csv")).write_text(of_run(2))
    with pytest.raises(DataError, match="its name is not UTF-8"):
        prepared([folder])


def test_what_a_folder_cannot_give_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link to a folder and a folder that may not be read were left out without a word."""
    folder = folder_of(tmp_path / "X", {"run1.csv": of_run(1), "sub/run2.csv": of_run(2)})
    (folder / "link").symlink_to(folder)
    assert any("not followed: link" in note for note in prepared([folder])[0].notes)
    scan = os.scandir

    def denied(path: str) -> object:
        if str(path).endswith("sub"):
            raise PermissionError(13, "Permission denied", str(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", denied)
    with pytest.raises(DataError, match="sub: Permission denied"):
        prepared([folder])


def test_a_small_letter_as_the_name_of_a_folder_is_its_axis(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "x", {f"run{r}.csv": of_run(r).replace("X (mm)", "Target (mm)") for r in (1, 2)})
    assert prepared([folder])[0].entries["Error"]["component"] == "EXX"


def test_a_link_without_its_file_is_called_so(tmp_path: Path) -> None:
    """The message proposed the same path again."""
    (tmp_path / "run1.csv").symlink_to(tmp_path / "gone.csv")
    with pytest.raises(DataError, match=r"run1\.csv: a link to a file that is not there$"):
        prepared([tmp_path / "run1.csv"])
