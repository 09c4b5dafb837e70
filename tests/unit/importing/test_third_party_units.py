"""Units, dates and cells that were read silently wrong once: read right now, or asked about."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from tests.unit.importing.known_test import imported

TARGETS = [0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 350.0, 400.0]
INCH = 25.4


def um(x: float, run: int = 1) -> float:
    """The true deviation in um."""
    return round(0.02 * x + 3.3 * np.sin(x / 60 + 0.2 * run) + 0.7, 1)


def table(header: str, row: str, above: str = "", runs: int = 2, below: str = "") -> str:
    """A file with a row per reading. row: a format of x, e (um) and r."""
    lines = [row.format(x=x, e=um(x, r), r=r) for r in range(1, runs + 1) for x in TARGETS]
    return "\n".join([*([above] if above else []), header, *lines, *([below] if below else []), ""])


def read(tmp_path: Path, text: str, **said: object) -> tuple[np.ndarray, np.ndarray]:
    """Positions (mm) and errors (um) of the imported file."""
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv", **said)
    place = recording.name("command", axis="X") or recording.name("position", axis="X")
    return recording.array(place), recording.array(recording.names("error")[0])


def holds(found: tuple[np.ndarray, np.ndarray], within: float = 0.06) -> None:
    """Assert that the file was read as it was meant."""
    x, e = found
    assert x == pytest.approx(TARGETS * 2, abs=1e-3)
    assert e == pytest.approx([um(x, r) for r in (1, 2) for x in TARGETS], abs=within)


@pytest.mark.parametrize(
    "header, factor",
    [
        ("Error [0.1 µm]", 10),
        ("Error (x0.1um)", 10),
        ("Error [10^-4 mm]", 10),
        ("Error (1/100 mm)", 0.1),
        ('Error (0.0001")', 1 / 2.54),
        ('Error (.0001")', 1 / 2.54),  # its point was taken for the end of a sentence
        ("Error (microinches)", 1000 / INCH),
        ("Error (mil)", 1 / INCH),
    ],
)
def test_parts_of_units(tmp_path: Path, header: str, factor: float) -> None:
    rows = [f"{r},{x},{um(x, r) * factor:.5f}" for r in (1, 2) for x in TARGETS]
    holds(read(tmp_path, "\n".join([f"Run,Target [mm],{header}", *rows])))


def test_inches_in_quotation_marks(tmp_path: Path) -> None:
    rows = [f"{r},{x / INCH:.7f},{um(x, r) / INCH:.5f}" for r in (1, 2) for x in TARGETS]
    holds(read(tmp_path, "\n".join(['Run,Nominal "in",Error (mil)', *rows])))


@pytest.mark.parametrize(
    "header, row, words",
    [
        ("position,dial", "{x},{e:.0f}", "whole numbers"),
        ("Target [inch],Reading", "{x},0.000{r}", "may be inches"),
        ("Target [mm];|Error| [µm]", "{x};{r}.5", "without sign"),
        ("Target [mm];Error [mm]", "{x};{e} µm", "its name states mm"),
        ("Target [mm];Error [0.05 µm]", "{x};{e}", "not a known unit"),
        ("Target [mm];Laser 1 [mm];Laser 2 [mm]", "{x};{x}1;{x}2", "both contain actual"),
        ("siht [mm],error [um]", "{x},{e}", "no position is recorded"),
        ("X nom [mm],Y nom [mm],X act [mm],Y act [mm]", "{x},{x},{x}1,{x}2", "move together"),
    ],
)
def test_what_may_be_either_is_asked(tmp_path: Path, header: str, row: str, words: str) -> None:
    with pytest.raises(DataError, match=words.replace("|", r"\|")):
        read(tmp_path, table(header, row))


def test_a_narrow_axis_without_any_unit_may_be_in_inches(tmp_path: Path) -> None:
    text = "Target,Indicator\n" + "\n".join(f"{x},{0.0004 * x + 0.0002 * (x % 3):.4f}" for x in range(13))
    with pytest.raises(DataError, match="may be inches"):
        read(tmp_path, text)
    x, e = read(tmp_path, text, sets=["Target.unit=inch", "Indicator.unit=inch"])
    assert x[-1] == pytest.approx(12 * INCH) and e[-1] == pytest.approx(0.0048 * INCH * 1000)


def test_steps_of_a_gauge_that_a_person_names(tmp_path: Path) -> None:
    rows = "\n".join(f"{x},{um(x, r) * 10:.0f}" for r in (1, 2) for x in TARGETS)
    holds(read(tmp_path, f"position,dial\n{rows}", unit="0.1 um"))


def test_the_unit_of_the_targets_is_not_that_of_the_readings(tmp_path: Path) -> None:
    above = "Axis,X\nTarget units,mm\nError units,µm\n"
    runs = [f"{x:.4f},{um(x, 1)},{um(x, 2)}" for x in TARGETS]
    x, e = read(tmp_path, "\n".join([above, "Target,Run 1 (+),Run 2 (+)", *runs]))
    assert np.ptp(x) == 400 and np.abs(e).max() < 20


def test_the_shorter_of_two_orders_of_day_and_month(tmp_path: Path) -> None:
    rows = [f"0{3 + r}/04/2026 10:00:{i:02d},{r},{x},{um(x, r)}" for r in (1, 2) for i, x in enumerate(TARGETS)]
    (tmp_path / "f.csv").write_text("\n".join(["Date Time,Run,Target [mm],Error [um]", *rows]))
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.array("t")[-1] == 86408.0


def test_rows_copied_within_a_run_are_refused(tmp_path: Path) -> None:
    lines = table("Run,Target [mm],Error [um]", "{r},{x},{e}").splitlines()
    lines[7:7] = lines[4:7]
    with pytest.raises(DataError, match="rows 7 to 9 repeat the 3 rows above"):
        read(tmp_path, "\n".join(lines))


def test_a_number_that_stands_for_no_reading(tmp_path: Path) -> None:
    lines = table("Run,Target [mm],Error [um]", "{r},{x},{e}").splitlines()
    lines[5] = "1,200,-9999"
    assert np.isnan(read(tmp_path, "\n".join(lines))[1][4])
    lines[5] = "1,200,1.2.3"
    with pytest.raises(DataError, match="is not a number like the others"):
        read(tmp_path, "\n".join(lines))


def test_exponents_of_fortran_formulas_and_wide_digits(tmp_path: Path) -> None:
    fortran = [f" {x:.3E}  {um(x, r):.5E}" for r in (1, 2) for x in TARGETS]
    holds(read(tmp_path, "\n".join([" NOMINAL(MM)  ERROR(UM)", *fortran]).replace("E+", "D+").replace("E-", "D-")))
    holds(read(tmp_path, table("Target [mm],Error [um]", '="{x}",="{e}"')))
    wide = str.maketrans("0123456789.-", "０１２３４５６７８９．－")
    holds(read(tmp_path, table("Target [mm],Error [um]", "{x},{e}").translate(wide).replace("，", ",")))


def test_every_target_several_times_before_the_next(tmp_path: Path) -> None:
    rows = [f"{x},{s},{um(x, r)}" for x in TARGETS for r in (1, 2) for s in "+-"]
    (tmp_path / "f.csv").write_text("\n".join(["Target [mm],Approach,Error [um]", *rows]))
    assert imported(tmp_path, tmp_path / "f.csv").run_labels() == ("1", "2")


def test_merged_cells_of_directions_with_a_row_of_units(tmp_path: Path) -> None:
    rows = [f"{x};" + ";".join(str(um(x, r)) for r in (1, 2, 1, 2)) for x in TARGETS]
    text = "\n".join(["Soll;Vorwärts;;Rückwärts;", "[mm];[µm];[µm];[µm];[µm]", *rows])
    assert read(tmp_path, text)[0].size == 36


def test_a_remark_above_the_header_is_no_group_of_columns(tmp_path: Path) -> None:
    above = "# CNC router X, dial 0.01mm"
    holds(read(tmp_path, table("target_mm,error_um", "{x},{e}", above)))
    assert "target" in (tmp_path / "rec" / "recording.csv").read_text().splitlines()[0].split(",")


def test_the_axis_in_the_name_of_a_file(tmp_path: Path) -> None:
    text = table("Target [mm],Error [um]", "{x},{e}")
    for stem, axis in (("b1", "X"), ("laser_Y", "Y"), ("z-axis", "Z")):
        (tmp_path / f"{stem}.csv").write_text(text)
        recording = imported(tmp_path, tmp_path / f"{stem}.csv")
        assert recording.manifest.columns[recording.names("error")[0]].component == f"E{axis}{axis}"
    (tmp_path / "laser_X.csv").write_text(text + "0,1.5\n")
    with pytest.raises(DataError, match="of the axes X, Y"):
        imported(tmp_path, [tmp_path / "laser_X.csv", tmp_path / "laser_Y.csv"])


def test_a_clock_of_minutes_and_seconds(tmp_path: Path) -> None:
    rows = [f"{i // 3:02d}:{20 * (i % 3):02d},{x},{um(x)}" for i, x in enumerate(TARGETS)]
    (tmp_path / "f.csv").write_text("\n".join(["Elapsed mm:ss,Target [mm],Error [um]", *rows]))
    assert imported(tmp_path, tmp_path / "f.csv").array("t").tolist() == [20.0 * i for i in range(9)]


@pytest.mark.parametrize(
    "header, role, unit, canonical",
    [
        ("pressure [bar]", "pressure", "bar", 2000.0),
        ("air pressure (mmHg)", "pressure", "hPa", 2 * 1.333224),
        ("velocity [deg/s]", "velocity", "deg/s", 2.0),
        ("velocity [in/s]", "velocity", "mm/s", 50.8),
        ("torque [Ncm]", "torque", "N cm", 0.02),
        ("force [lbf]", "force", "N", 8.8964432),
        ("force (filtered)", "force", "N", 2.0),
        ("acceleration [g]", "acceleration", "m/s2", 19613.3),
        ("spindle speed [rad/s]", "spindle_speed", "rpm", 60 / np.pi),
        ("spindle speed [Hz]", "spindle_speed", "1/s", 120.0),
        ("depth of cut [inch]", "depth_of_cut", "mm", 50.8),
        ("overhang [cm]", "overhang", "mm", 20.0),
        ("cut length [ft]", "cut_length", "m", 0.6096),
        ("Werkstückmasse [kg]", "load", "kg", 2.0),
    ],
)
def test_a_unit_in_brackets_is_that_of_every_role(
    tmp_path: Path, header: str, role: str, unit: str, canonical: float
) -> None:
    """It was dropped where the reader did not know it, and the usual one taken: a pressure of 1 bar became 1 hPa."""
    (tmp_path / "f.csv").write_text(table(f"run,x [mm],error [um],{header}", "{r},{x},{e},2.0"), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    (name,) = recording.names(role)
    assert recording.array(name)[0] == pytest.approx(canonical)
    assert f"unit: {unit}" in (tmp_path / "rec" / "recording.yaml").read_text().replace('"', "")


@pytest.mark.parametrize("header", ["torque [%]", "feed [mm/rev]", "temperature [mV/V]"])
def test_a_column_in_a_unit_of_something_else_is_left_out(tmp_path: Path, header: str) -> None:
    (tmp_path / "f.csv").write_text(table(f"run,x [mm],error [um],{header}", "{r},{x},{e},2.0"), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert not any(recording.names(role) for role in ("torque", "feed", "temperature"))
    assert "is not a unit of role" in (tmp_path / "rec" / "recording.yaml").read_text()


def test_symbols_of_physics_are_no_axes(tmp_path: Path) -> None:
    """`v [mm/s]` was a position of the axis V in mm/s, `a_cmd [mm/s2]` one of A: the import ended in an error."""
    row = "{x},{e},{e},2.0"
    (tmp_path / "f.csv").write_text(table("x [mm],error [um],v [mm/s],a_cmd [mm/s2]", row, runs=1), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    for role in ("velocity", "acceleration"):
        (name,) = recording.names(role)
        assert recording.manifest.columns[name].axis == "X"


def test_the_travel_of_a_nano_stage_in_um_stands_with_its_deviations(tmp_path: Path) -> None:
    """Positions of less than a centimetre in um were taken for a second column of deviations, and asked about."""
    x, e = read(tmp_path, table("Run;X (µm);Deviation (nm)", "{r};{x};{e}"))
    assert x == pytest.approx(np.array(TARGETS * 2) / 1000.0)
    assert e == pytest.approx([um(x, r) / 1000.0 for r in (1, 2) for x in TARGETS])
    with pytest.raises(DataError, match="both deviations of EXX"):
        read(tmp_path, table("Run;X (µm);Deviation (µm)", "{r};{e};{e}"))
