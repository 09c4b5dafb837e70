"""What stands above a table: that its readings are corrections, from which side its columns were approached."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, prepared

RUNS = (1, 2, 3)


def wide(headers: list[str], sign: float = 1.0, sides: tuple[float, ...] = (1.0, -1.0)) -> list[str]:
    """A row per target, a column per run and side."""
    rows = [";".join(["Target [mm]", *headers])]
    for i, x in enumerate(TARGETS):
        rows.append(";".join([f"{x:g}", *(f"{sign * deviation(r, s)[i]:.1f}" for s in sides for r in RUNS)]))
    return rows


@pytest.mark.parametrize(
    "title",
    [
        *("Correction [um]", "Korrekturwert [µm]", "Compensation value (um)", "Valore di compensazione [um]"),
        *("補正値 [um]", "修正值 [um]", "Поправка [um]", "Kompensacja [um]", "Correction to apply [um]"),
    ],
)
def test_a_title_says_that_readings_are_corrections(tmp_path: Path, title: str) -> None:
    """They were deviations: the machine would have been driven the wrong way."""
    lines = ["Axis X", title, *wide([f"{r}{mark}" for mark in "+-" for r in RUNS], -1.0)]
    (tmp_path / "f.csv").write_text("\n".join(lines), "utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


@pytest.mark.parametrize("title", ["Compensation: off", "Error after compensation [um]", "Temp. compensation [mm]"])
def test_a_title_on_a_compensation_turns_no_sign(tmp_path: Path, title: str) -> None:
    lines = ["Axis X", title, *wide([f"{r}{mark} [um]" for mark in "+-" for r in RUNS])]
    (tmp_path / "f.csv").write_text("\n".join(lines), "utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


@pytest.mark.parametrize(("up", "down"), [("+", "-"), ("avant", "arrière"), ("dodatni", "ujemny")])
@pytest.mark.parametrize("run", ["Run", "Messung Nr."])
def test_a_side_above_each_group_of_columns(tmp_path: Path, up: str, down: str, run: str) -> None:
    """`+` was asked about; below `Soll` and `- Messung`, the sign of all readings was turned."""
    block = ["Soll [mm]", *(f"{run} {r} [um]" for r in RUNS)]
    lines = ["Axis X", ";".join([up, *[""] * 4, down]), ";".join([*block, "", *block])]
    for i, x in enumerate(TARGETS):
        beside = [[f"{x:g}", *(f"{deviation(r, s)[i]:.1f}" for r in RUNS)] for s in (1.0, -1.0)]
        lines.append(";".join([*beside[0], "", *beside[1]]))
    (tmp_path / "f.csv").write_text("\n".join(lines), "utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


def test_a_word_that_all_names_share_is_no_side(tmp_path: Path) -> None:
    """`pos` of `pos_X_up` is a position: the sides of both files were lost."""
    for name, side in (("pos_X_up", 1.0), ("pos_X_down", -1.0)):
        lines = wide([f"Run {r} [um]" for r in RUNS], sides=(side,))
        (tmp_path / f"{name}.csv").write_text("\n".join(lines), "utf-8")
    recording = imported(tmp_path, [tmp_path / "pos_X_up.csv", tmp_path / "pos_X_down.csv"])
    sides, error = recording.array(recording.name("direction") or ""), recording.array("EXX")
    for way in (1.0, -1.0):
        assert sorted(error[sides == way]) == pytest.approx(sorted(np.ravel([deviation(r, way) for r in RUNS])))


def test_before_and_after_are_no_sides(tmp_path: Path) -> None:
    lines = ["Axe X", "Cote [mm];Écart avant [um];Écart après [um]", *(f"{x:g};{x / 60};0.1" for x in TARGETS)]
    (tmp_path / "f.csv").write_text("\n".join(lines), "utf-8")
    with pytest.raises(DataError, match="both"):
        prepared([tmp_path / "f.csv"])


BARE = [f"{w} {r} [um]" for w in ("Forward", "Backward") for r in RUNS]


@pytest.mark.parametrize(
    "title",
    [
        *("Correction", "Korrekturwert", "X axis correction", "Pitch error compensation X", "Value;Correction"),
        *("Type: correction", "Readings: corrections in um", "Correction à appliquer (µm)", "Following error X"),
    ],
)
def test_a_title_that_may_say_corrections_is_asked_about(tmp_path: Path, title: str) -> None:
    """They were taken as deviations, and doubled the error of the machine."""
    (tmp_path / "f.csv").write_text("\n".join([title, *wide(BARE, -1.0)]), encoding="utf-8")
    with pytest.raises(DataError, match=r"states .*--sign"):
        imported(tmp_path, tmp_path / "f.csv")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv", sign="commanded-minus-actual"))


@pytest.mark.parametrize(
    "title",
    [
        *(
            "Compensation: off",
            "Correction: none",
            "Temp. compensation",
            "After correction",
            "Correction factor 1.00027",
        ),
        *("Expansion correction 11.7 ppm/K", "Error compensation type: incremental", "Backlash compensation = 0"),
    ],
)
def test_a_setting_is_no_title_of_corrections(tmp_path: Path, title: str) -> None:
    (tmp_path / "f.csv").write_text("\n".join([title, *wide(BARE)]), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


def test_a_file_that_is_called_a_correction_is_asked_about(tmp_path: Path) -> None:
    (tmp_path / "X_corrections.csv").write_text("\n".join(wide(BARE, -1.0)), encoding="utf-8")
    with pytest.raises(DataError, match="'X corrections': are the readings"):
        imported(tmp_path, tmp_path / "X_corrections.csv")
    (tmp_path / "Korrekturtabelle X.csv").write_text("\n".join(wide(BARE, -1.0)), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "Korrekturtabelle X.csv"))


@pytest.mark.parametrize("unit", ["mm", "inch", "m"])
def test_absolute_readings_in_the_columns_of_the_runs(tmp_path: Path, unit: str) -> None:
    """In inch they were deviations of 400 mm: the readings alone had been converted."""
    per = {"mm": 1.0, "inch": 25.4, "m": 1000.0}[unit]
    columns = [TARGETS + deviation(r, s) / 1000 for s in (1.0, -1.0) for r in RUNS]
    rows = [";".join(f"{c[i] / per:.12f}" for c in (TARGETS, *columns)) for i in range(TARGETS.size)]
    head = ";".join([f"Target [{unit}]", *(h.replace("um", unit) for h in BARE)])
    (tmp_path / "f.csv").write_text("\n".join([head, *rows]), encoding="utf-8")
    read = imported(tmp_path, tmp_path / "f.csv")
    known = np.sort([d for *_, d in long_rows()])
    assert np.sort(read.array(read.names("error", component="EXX")[0])) == pytest.approx(known, abs=1e-4)
