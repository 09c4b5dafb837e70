"""Folders of files, and signs that a line states in words of other languages."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, prepared

COMMANDED_FIRST = [
    "Nota: scostamento = quota nominale meno quota misurata",
    "desvio = posição alvo menos posição medida",
    "Écart = cote visée moins cote mesurée",
    "Desviación = posición teórica - posición real",
    "odchyłka = pozycja zadana minus pozycja zmierzona",
    "Not: sapma = hedef konum eksi ölçülen konum",
    "отклонение = заданное положение минус измеренное положение",
    "afwijking = gewenste positie - gemeten positie",
    "说明：误差＝理论值－测量值",
    "편차 = 목표위치 - 실측위치",
    "Abweichung: Soll abzüglich Ist",
]
ACTUAL_FIRST = [
    "scostamento = posizione misurata - posizione nominale",
    "Desvio = valor medido - valor nominal",
    "Odchyłka = wartość zmierzona - wartość zadana",
    "Sapma: ölçülen değer - hedef değer",
    "avvik = målt verdi - nominell verdi",
]
UNKNOWN = [
    "Errore: differenza tra quota nominale e quota reale",
    "Note: deviation = nominal value subtracted from actual value",
    "Odchyłka = odczyt - wzorzec",
    "Nota: desvio = A menos B",
]


def stating(tmp_path: Path, line: str) -> Path:
    """One run from below, so that no lost motion contradicts a wrong sign."""
    rows = [f"{x:g};{d:g}" for x, d in zip(TARGETS, deviation(1, 1.0), strict=True)]
    (tmp_path / "f.csv").write_text("\n".join([line, "Target X [mm];Deviation [um]", *rows]), encoding="utf-8")
    return tmp_path / "f.csv"


@pytest.mark.parametrize("sign, line", [*((-1.0, t) for t in COMMANDED_FIRST), *((1.0, t) for t in ACTUAL_FIRST)])
def test_a_sign_in_words_of_another_language(tmp_path: Path, sign: float, line: str) -> None:
    """Nouns before adjectives were not read: `quota nominale meno quota misurata` kept the opposite sign."""
    recording = imported(tmp_path, stating(tmp_path, line))
    (error,) = recording.names("error", component="EXX")
    assert np.allclose(recording.array(error), sign * deviation(1, 1.0))


@pytest.mark.parametrize("line", UNKNOWN)
def test_a_definition_of_unknown_quantities_is_asked_for(tmp_path: Path, line: str) -> None:
    with pytest.raises(DataError, match=r"--sign"):
        imported(tmp_path, stating(tmp_path, line))


@pytest.mark.parametrize("line", ["Deviation = 3 - 5 um", "Compensation: none", "Error: X axis - forward"])
def test_other_lines_about_deviations_ask_nothing(tmp_path: Path, line: str) -> None:
    recording = imported(tmp_path, stating(tmp_path, line))
    assert np.allclose(recording.array(recording.names("error")[0]), deviation(1, 1.0))


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def of_run(run: int, side: float | None = None, scale: float = 1.0) -> str:
    """A run with the column of sides; or one side of it without that column."""
    rows = [row for row in long_rows() if row[0] == str(run) and side in (None, row[2])]
    cells = [f"{x};{s:g};{d * scale}" if side is None else f"{x};{d * scale}" for _, x, s, d in rows]
    return "\n".join(["Target [mm];Direction;Deviation [um]" if side is None else "Target [mm];Deviation [um]", *cells])


@pytest.mark.parametrize("where", ["{r}/laser-{r}.csv", "2024-05-0{r}_X_run{r}.csv", "day {r}/run {r}.csv"])
def test_each_file_of_a_folder_is_a_run(tmp_path: Path, where: str) -> None:
    files = {where.format(r=r): of_run(r) for r in (1, 2, 3)} | {
        "README.txt": "VMC 3",
        "IMG_1.JPG": "x",
        ".old.csv": "x",
    }
    folder = written(tmp_path / "laser", files)
    holds_the_truth(imported(tmp_path, folder))
    (note,) = [note for note in prepared([folder])[0].notes if "no measurements" in note]
    assert "README.txt" in note and "IMG_1.JPG" in note


@pytest.mark.parametrize(
    "where", ["forward:reverse/run{r}.csv", "fwd:rev/f{r}.csv", "X+:X-_{r}.csv", "+X:-X/run{r}.csv"]
)
def test_sides_in_the_names_of_folders(tmp_path: Path, where: str) -> None:
    (up, _, rest), files = where.partition(":"), {}
    down, end = rest[: rest.index("/" if "/" in rest else "_")], rest[rest.index("/" if "/" in rest else "_") :]
    for r in (1, 2, 3):
        files |= {f"{up}{end}".format(r=r): of_run(r, 1.0), f"{down}{end}".format(r=r): of_run(r, -1.0)}
    holds_the_truth(imported(tmp_path, written(tmp_path / "X axis", files)))


def test_a_zip_in_a_folder_is_unpacked_beside_its_files(tmp_path: Path) -> None:
    folder = written(tmp_path / "X", {f"2024-05-0{r}/laser.csv": of_run(r) for r in (1, 2)})
    with zipfile.ZipFile(folder / "2024-05-03.zip", "w") as archive:
        archive.writestr("laser.csv", of_run(3))
    recording = imported(tmp_path, folder)
    assert [*dict.fromkeys(recording.run_labels())] == [f"2024-05-0{r}_laser" for r in (1, 2, 3)]
    assert np.allclose(recording.array(recording.names("error")[0]), [d for *_, d in long_rows()])


@pytest.mark.parametrize("where", ["{a}/run{r}.csv", "{a}_run{r}.csv", "2024 {a} axis/laser_{r}.csv"])
def test_axes_in_the_names_of_folders_are_selected(tmp_path: Path, where: str) -> None:
    """Folders of several axes became runs of one."""
    files = {where.format(a=a, r=r): of_run(r, scale=s) for a, s in (("X", 1.0), ("Y", 2.0)) for r in (1, 2, 3)}
    folder = written(tmp_path / "laser", files)
    with pytest.raises(DataError, match=r"several axes \(X, Y\): declare it with --axis X"):
        prepared([folder])
    holds_the_truth(imported(tmp_path, folder, axis="X"))


@pytest.mark.parametrize("before, after", [("vorher", "nachher"), ("before", "after"), ("comp off", "comp on")])
def test_states_in_the_names_of_folders_are_no_runs(tmp_path: Path, before: str, after: str) -> None:
    """`before/x1.csv after/x2.csv` were two runs: only the names of files were read."""
    folder = written(tmp_path / "X", {f"{before}/x1.csv": of_run(1), f"{after}/x2.csv": of_run(2)})
    for files in ([folder], [folder / before / "x1.csv", folder / after / "x2.csv"]):
        with pytest.raises(DataError, match="several states of the machine"):
            prepared(files, axis="X")


@pytest.mark.parametrize(
    "names", [("18C", "23C", "28C"), ("T18 °C", "T23 °C", "T28 °C"), ("x_18degC", "y_23degC", "z_28degC")]
)
def test_temperatures_in_the_names_of_folders_are_a_column(tmp_path: Path, names: tuple[str, ...]) -> None:
    folder = written(tmp_path / "X", {f"{name}/laser.csv": of_run(r) for r, name in enumerate(names, 1)})
    recording = imported(tmp_path, folder)
    assert [*dict.fromkeys(recording.array("temperature"))] == [18.0, 23.0, 28.0]
    (folder / names[2]).rename(folder / "other")
    assert "temperature" not in prepared([folder])[0].entries


def test_numbers_of_machines_in_the_names_of_folders_are_no_temperatures(tmp_path: Path) -> None:
    folder = written(tmp_path / "X", {f"DMU {size}C/laser.csv": of_run(r) for r, size in ((1, 60), (2, 80))})
    assert "temperature" not in prepared([folder])[0].entries


def test_a_recording_in_a_folder_is_left_out(tmp_path: Path) -> None:
    folder = written(tmp_path / "X", {f"run{r}.csv": of_run(r) for r in (1, 2, 3)})
    written(folder / "recording", {"recording.yaml": "recording: 1", "recording.csv": of_run(1)})
    holds_the_truth(imported(tmp_path, folder))
    assert any("already a recording" in note for note in prepared([folder])[0].notes)


@pytest.mark.parametrize("word", ["Średnia", "Ortalama", "平均値", "Среднее", "Průměr", "Gemiddelde", "Medel"])
@pytest.mark.parametrize("blocks", [1, 3])
def test_rows_of_a_mean_in_another_language_are_no_run(tmp_path: Path, word: str, blocks: int) -> None:
    """Below runs 1 to 3, each mean was a reading, of a run without a name."""
    rows = [f"{r};{x};{s:+g};{d}" for r, x, s, d in long_rows()]
    rows += [f"{word};{x};{s:+g};{9 * s}" for r, x, s, _ in long_rows() if r == "1"] * blocks
    (tmp_path / "f.csv").write_text("\n".join(["Run;Target X [mm];Direction;Deviation [um]", *rows]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert len(recording) == len(long_rows())
    holds_the_truth(recording)


@pytest.mark.parametrize("word", ["Średnia", "Ortalama", "平均値", "Среднее", "Mean"])
def test_numbers_of_runs_above_units(tmp_path: Path, word: str) -> None:
    """`Target;1;2;3;Mean` above `mm;um;um;um;um`: the row of units was the header, and the mean a run."""
    rows = [f"{x};{';'.join(str(deviation(r, 1.0)[i]) for r in (1, 2, 3))};9" for i, x in enumerate(TARGETS)]
    (tmp_path / "f.csv").write_text("\n".join([f"Target X [mm];1;2;3;{word}", ";um;um;um;um", *rows]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert [*dict.fromkeys(recording.run_labels())] == ["1", "2", "3"]
    assert np.allclose(recording.array("EXX"), np.concatenate([deviation(r, 1.0) for r in (1, 2, 3)]))


@pytest.mark.parametrize(
    "line",
    [
        "Uwaga: wartości są poprawkami",
        "注：表中数值为补偿值",
        "注: 数値は補正値",
        "Nota: os valores são correções",
        "Nota: i valori sono correzioni",
        "Note: les valeurs sont des corrections",
        "Not: değerler düzeltmedir",
        "İşaret: artı = eksen az gidiyor",
    ],
)
def test_a_line_that_calls_the_readings_corrections_is_asked_for(tmp_path: Path, line: str) -> None:
    """Below such a line, readings under `Deviation` kept the opposite sign."""
    with pytest.raises(DataError, match=r"a line states the sign.*--sign"):
        imported(tmp_path, stating(tmp_path, line))


ZONES = [
    ("Time (CEST)", "Time (UTC)"),
    ("Time [UTC+2]", "time_utc"),
    ("Zeit (MESZ)", "Zeit (GMT)"),
    ("t UTC+02:00", "UTC"),
]


def clocks(tmp_path: Path, of_deviations: str, of_log: str) -> list[Path]:
    """Deviations from 9:00 on, one a minute; a log of the whole day, 7:00 at the same moment, in K one each hour."""
    rows = [f"2024-05-03 09:{i:02d}:00;{x:g};{deviation(1, 1.0)[i]}" for i, x in enumerate(TARGETS)]
    (tmp_path / "d.csv").write_text("\n".join([f"{of_deviations};Target X [mm];Deviation [um]", *rows]), "utf-8")
    rows = [f"2024-05-03 {i // 60:02d}:{i % 60:02d}:00;{10 + i // 60}" for i in range(1440)]
    (tmp_path / "t.csv").write_text("\n".join([f"{of_log};T nut [degC]", *rows]), "utf-8")
    return [tmp_path / "d.csv", tmp_path / "t.csv"]


@pytest.mark.parametrize("of_deviations, of_log", ZONES)
def test_zones_in_the_headers_of_two_clocks(tmp_path: Path, of_deviations: str, of_log: str) -> None:
    """`Time (CEST)` beside `Time (UTC)` took temperatures of two hours later."""
    recording = imported(tmp_path, clocks(tmp_path, of_deviations, of_log))
    assert np.array_equal(recording.array(recording.names("temperature")[0]), np.full(13, 17.0))
    assert any(note.startswith("t: its clock") for note in prepared([tmp_path / "d.csv", tmp_path / "t.csv"])[0].notes)


def test_a_zone_in_the_header_of_one_clock_is_asked_for(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="have a time zone"):
        imported(tmp_path, clocks(tmp_path, "Local time", "Time (UTC)"))
