"""First imports of third-party files: lists side by side, pivot tables, tolerances, marks of the writing direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.errors import DataError
from tests.unit.importing.known_test import imported, long_rows

X = np.arange(0.0, 500.0, 50.0)
ERROR = np.round(0.02 * X + 3.0 * np.sin(X / 70.0), 2)


def written(folder: Path, *lines: str, name: str = "lab.csv") -> Path:
    """A text file of these lines."""
    (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / name


def unequal_lists(folder: Path) -> Path:
    """Ten targets of X, seven of Y."""
    rows = [
        f"{x:g},{e:g}," + (f"{x:g},{-e:g}" if k < 7 else ",") for k, (x, e) in enumerate(zip(X, ERROR, strict=True))
    ]
    return written(folder, "X target (mm),X dev (um),Y target (mm),Y dev (um)", *rows)


def test_lists_of_several_axes_of_unequal_length_are_a_question(tmp_path: Path) -> None:
    """The rows that only the longer list has were excluded as comments."""
    with pytest.raises(DataError, match=r"side by side \(rows: X 10, Y 7\): select one with --axis X"):
        imported(tmp_path, unequal_lists(tmp_path))


@pytest.mark.parametrize(("axis", "sign", "count"), [("X", 1.0, 10), ("Y", -1.0, 7)])
def test_the_list_of_the_stated_axis_is_whole(tmp_path: Path, axis: str, sign: float, count: int) -> None:
    recording = imported(tmp_path, unequal_lists(tmp_path), axis=axis)
    assert np.allclose(recording.array(f"{axis}_target"), X[:count])
    assert np.allclose(recording.array(f"{axis}_dev"), sign * ERROR[:count])
    assert len(recording.manifest.columns) == 2 + ("direction" in recording.manifest.columns)


def test_the_title_of_a_pivot_table_is_no_unit_of_its_targets(tmp_path: Path) -> None:
    """`Average of Deviation (um)` stands above `Row Labels`: targets of 50 mm were read as 50 um."""
    rows = [f"{x:g},{e:g},{e + 0.4:g},{e + 0.2:g}" for x, e in zip(X, ERROR, strict=True)]
    total = "Grand Total,1.5,1.9,1.7"
    file = written(tmp_path, "Average of Deviation (um),Column Labels", "Row Labels,1,2,Grand Total", *rows, total)
    recording = imported(tmp_path, file, axis="X")
    assert np.allclose(recording.array("target"), np.tile(X, 2))
    assert np.allclose(recording.array("EXX"), [*ERROR, *(ERROR + 0.4)])


def test_tolerances_with_signs_are_no_readings_of_two_sides(tmp_path: Path) -> None:
    rows = [f"{x:.3f},{x + e / 1000:.5f},{e / 1000:.5f},0.005,-0.005,PASS" for x, e in zip(X, ERROR, strict=True)]
    recording = imported(tmp_path, written(tmp_path, "Nominal X,Actual X,Dev,Tol+,Tol-,P/F", "mm,mm,mm,mm,mm,-", *rows))
    assert np.allclose(recording.array("Dev"), ERROR)


def test_marks_of_the_writing_direction_are_no_part_of_a_number(tmp_path: Path) -> None:
    rows = [f"\u200e{x:g}\u200f;\u200e{e:g}\u200f" for x, e in zip(X, ERROR, strict=True)]
    file = written(tmp_path, "\u200ePosition X (mm)\u200f;\u200eDeviation (um)\u200f", *rows)
    assert np.allclose(imported(tmp_path, file).array("Deviation"), ERROR)


def test_a_stamp_of_three_parts_between_commas_is_one_cell(tmp_path: Path) -> None:
    """A trend of Rockwell: `Data,05/12/2024;14:30:00;010,...`; the semicolons were taken for separators."""
    rows = [
        f"Data,05/12/2024;14:30:00;{10 * k:03d},{x:.3f},{x + e / 1000:.5f}"
        for k, (x, e) in enumerate(zip(X, ERROR, strict=True))
    ]
    recording = imported(tmp_path, written(tmp_path, "Header:,Time,X.CmdPos (mm),X.ActPos (mm)", *rows))
    assert np.allclose(recording.array("t"), 0.01 * np.arange(X.size))


def test_a_straightness_next_to_an_unknown_length_asks_for_the_position(tmp_path: Path) -> None:
    """It was recorded as a drift, without any position."""
    rows = [f"{x:g},{e:g}" for x, e in zip(X, ERROR, strict=True)]
    file = written(tmp_path, "Straightness, axis X", "Station (mm),Vert (um)", *rows)
    with pytest.raises(DataError, match=r"'Station' .* is unknown, and no position is recorded"):
        imported(tmp_path, file, component="EZX", sign="actual-minus-commanded")


def test_thousandths_of_an_inch_are_readings(tmp_path: Path) -> None:
    rows = [f"{x / 25.4:.4f},{e:g}" for x, e in zip(X, ERROR, strict=True)]
    file = written(tmp_path, "Dist (in),Vert (thou)", *rows)
    recording = imported(tmp_path, file, axis="X", component="EZX", sign="actual-minus-commanded")
    assert np.allclose(recording.array("Vert"), 25.4 * ERROR)
    assert np.allclose(recording.array("Dist"), X, atol=0.002)


def test_netcdf_3_is_refused_with_its_conversion(tmp_path: Path) -> None:
    (tmp_path / "lab.nc").write_bytes(b"CDF\x01" + bytes(60))
    with pytest.raises(DataError, match=r"nccopy -k nc4 lab\.nc lab_4\.nc"):
        imported(tmp_path, tmp_path / "lab.nc")


def test_a_folder_that_cannot_be_read_names_what_can(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "day"
    folder.mkdir()
    assert main(["import", str(folder), "--out", str(tmp_path / "r"), "--yes"]) == 3
    assert "a folder without a file of measurements" in capsys.readouterr().err
    written(folder, "G0 X0", name="part.nc")  # an NC program, with the file name ending of netCDF
    written(folder, "X,Gauge", name="a.csv")
    assert main(["import", str(folder), "--out", str(tmp_path / "r"), "--yes"]) == 3
    assert f"name only the files that are meant: {folder}/*.csv" in capsys.readouterr().err
    assert main(["check", str(folder)]) == 2
    assert f"errpipe import {folder} --out recording" in capsys.readouterr().err
    assert main(["init", str(folder)]) == 2
    assert f"become a recording first: errpipe import {folder} --out" in capsys.readouterr().err
    assert not (folder / "pipeline.yaml").exists()
    written(folder, "recording: 1", name="recording.yaml")
    assert main(["import", str(folder), "--out", str(tmp_path / "r"), "--yes"]) == 3
    assert f"errpipe init axis --recording {folder}" in capsys.readouterr().err


def test_init_of_a_misspelt_file_makes_no_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    written(tmp_path, "X,Gauge", name="positions.csv")
    assert main(["init", str(tmp_path / "positons.csv")]) == 2
    assert f"Did you mean {tmp_path / 'positions.csv'}?" in capsys.readouterr().err
    assert not (tmp_path / "positons.csv").exists()


def test_a_point_without_one_reading_keeps_the_columns_of_all_axes(tmp_path: Path) -> None:
    """The positions of a cloud of points are complete: its axes are no lists of their own."""
    rows = [
        f"{x:g},{e:g},{x / 2:g}," + ("" if k == 4 else f"{-e:g}") for k, (x, e) in enumerate(zip(X, ERROR, strict=True))
    ]
    file = written(tmp_path, "X pos (mm),E_X (um),Y pos (mm),E_Y (um)", *rows)
    assert {"E_X", "E_Y"} <= {*imported(tmp_path, file, axis="X").names("error")}


@pytest.mark.parametrize(("header", "first"), [("JD", 2460433.875), ("MJD (d)", 60433.375)])
def test_julian_days_are_times(tmp_path: Path, header: str, first: float) -> None:
    """Days of a spreadsheet begin in 1899, modified Julian days in 1858; 2024-05-03 09:00 UTC is both of these."""
    rows = [f"{first + k / 96:.6f},{e:g},{20 + k}" for k, e in enumerate(ERROR)]
    recording = imported(tmp_path, written(tmp_path, f"{header},Z drift (um),Bed (degC)", *rows))
    (time,) = recording.names("time")
    assert np.allclose(recording.array(time), 900.0 * np.arange(X.size), atol=0.1)
    assert str(recording.manifest.columns[time].epoch).startswith("2024-05-03T09:00")


def test_rows_of_devices_below_complete_names_are_no_names(tmp_path: Path) -> None:
    """An export of catman: names with units, then the amplifier and the starting time of each channel."""
    rows = [f"{k / 2:.3f}\t{20 + k}\t{e:g}" for k, e in enumerate(ERROR)]
    head = [
        "Zeit [s]\tT_Bett [degC]\tE_Z [um]",
        "MX840B\tKanal 1\tKanal 2",
        "Startzeit\t03.05.2024 09:00:00\t03.05.2024 09:00:00",
    ]
    recording = imported(tmp_path, written(tmp_path, "EXPORTED AS: ASCII", *head, *rows), sign="actual-minus-commanded")
    assert np.allclose(recording.array("E_Z"), ERROR) and recording.names("temperature") == ("T_Bett",)


def test_rows_below_complete_names_that_state_a_side_or_a_sign_are_kept(tmp_path: Path) -> None:
    """Runs with units, and below them the side of each run; a channel with its unit, and below it its quantity."""
    rows = [f"{100 * k},{e:g},{e + 3:g}" for k, e in enumerate(ERROR)]
    table = written(tmp_path, "Position [mm],Run 1 [um],Run 2 [um]", ",up,down", *rows)
    recording = imported(tmp_path, table, sign="actual-minus-commanded", axis="X")
    side = recording.array(recording.names("direction")[0])
    assert sorted(recording.array("EXX")[side < 0]) == pytest.approx(sorted(ERROR + 3))
    rows = [f"{100 * k},{e:g}" for k, e in enumerate(ERROR)]
    recording = imported(tmp_path, written(tmp_path, "X [mm],Ch 1 [um]", "commanded,correction", *rows))
    assert recording.array(recording.name("error", component="EXX")) == pytest.approx(-ERROR)


def test_points_of_which_some_lack_a_position_are_no_lists(tmp_path: Path) -> None:
    """With their components stated, the rows with both positions are points; else a question."""
    rows = [f"{x:g},{x if k else ''},{e:g},{-e:g}" for k, (x, e) in enumerate(zip(X, ERROR, strict=True))]
    file = written(tmp_path, "X (mm),Y (mm),dX (um),dY (um)", *rows)
    points = ["dX.component=E_X", "dY.component=E_Y"]
    recording = imported(tmp_path, file, sets=points, sign="actual-minus-commanded")
    assert recording.array("dX") == pytest.approx(ERROR[1:]) and recording.components() == ("E_X", "E_Y")
    with pytest.raises(DataError, match=r"'dX\.component=E_X'"):
        imported(tmp_path, file)


def test_a_distance_is_a_position_only_where_there_is_no_other(tmp_path: Path) -> None:
    rows = [f"{x:g},12.5,{e:g}" for x, e in zip(X, ERROR, strict=True)]
    recording = imported(tmp_path, written(tmp_path, "X (mm),Dist (mm),Deviation (um)", *rows))
    assert np.allclose(recording.array("X"), X) and recording.names("position") == ("X",)
    rows = [f"{x:g},{e:g}" for x, e in zip(X, ERROR, strict=True)]
    recording = imported(tmp_path, written(tmp_path, "Dist (mm),Deviation (um)", *rows), axis="X")
    assert np.allclose(recording.array("Dist"), X)


def of_a_gantry(tmp_path: Path, names: tuple[str, ...]) -> Path:
    header = ",".join(["run", "dir", *(f"{n} target mm,{n} error um" for n in names)])
    rows = [",".join([r, f"{s:+g}", *(f"{x},{d}" for _ in names)]) for r, x, s, d in long_rows()]
    (tmp_path / "gantry.csv").write_text("\n".join([header, *rows]))
    return tmp_path / "gantry.csv"


def test_the_first_of_two_drives_keeps_its_number_if_the_axis_is_stated(tmp_path: Path) -> None:
    """The direction became one of X1 and the position one of X: every turn looked like a new zero of the laser."""
    recording = imported(tmp_path, of_a_gantry(tmp_path, ("X1",)), axis="X1")
    assert recording.components() == ("EXX1",)
    assert {c.axis for c in recording.manifest.columns.values() if c.axis} == {"X1"}
    assert imported(tmp_path, of_a_gantry(tmp_path, ("X1",))).components() == ("EXX",)  # a control's only X


def test_both_drives_of_a_gantry_in_one_file_are_two_axes(tmp_path: Path) -> None:
    file = of_a_gantry(tmp_path, ("X1", "X2"))
    with pytest.raises(DataError, match=r"X1_error.component=E_X and so on, or .* X1_error.component=EXX1 and so on"):
        imported(tmp_path, file)
    sets = ["X1_error.component=EXX1", "X2_error.component=EXX2"]
    recording = imported(tmp_path, file, sets=sets)
    assert recording.components() == ("EXX1", "EXX2")
    assert [recording.manifest.columns[n].axis for n in recording.names("position")] == ["X1", "X2"]
