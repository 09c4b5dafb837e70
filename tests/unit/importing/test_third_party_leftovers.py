"""First imports of third-party files: constant sensors, units that are not stated, devices by name, axes in words."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.errors import DataError
from errpipe.importing import dates
from errpipe.importing.layout import RawColumn
from errpipe.importing.other_tests import TESTS
from errpipe.importing.proposed import ImportOptions
from errpipe.importing.resolve import unit_by_size
from errpipe.importing.sheet import Cell, ReaderOptions
from errpipe.verbs import import_files
from tests.unit.importing.known_test import imported, prepared

TARGETS = np.linspace(0, 600, 11)


def laser_export(runs: int, air: str = "20.0") -> str:
    """A laser's table with its weather station, which shows one value in every row."""
    lines = ["Run;X [mm];Direction;Error [um];Air temp [°C];Humidity [%];Pressure [hPa];Material temp [°C]"]
    for run in range(1, runs + 1):
        for side in (1, -1):
            for x in TARGETS[::side]:
                error = x / 60 + 3 * np.sin(x / 80) - 2 * side + 0.1 * run
                lines.append(f"{run};{x:g};{'+' if side > 0 else '-'};{error:.1f};{air};50;1013;20.1")
    return "\n".join(lines) + "\n"


def started(tmp_path: Path, runs: int) -> Path:
    """The pipeline of `init` for the imported export."""
    (tmp_path / "laser.csv").write_text(laser_export(runs), encoding="utf-8")
    recording = tmp_path / "recording"
    assert main(["import", str(tmp_path / "laser.csv"), "--out", str(recording), "--yes"]) == 0
    assert main(["init", "--template", "laser-iso230", str(tmp_path / "work"), "--recording", str(recording)]) == 0
    return tmp_path / "work" / "pipeline.yaml"


def test_a_weather_station_that_shows_one_value_stops_no_test(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`clean` refused it (exit code 3): four of four sensors would have been set aside."""
    pipeline = started(tmp_path, 3)
    text = pipeline.read_text("utf-8").replace("sinumerik_lec, linuxcnc_screw, heidenhain_com", "linuxcnc_screw")
    pipeline.write_text(text, "utf-8")
    assert main(["run", str(pipeline), "--out", str(tmp_path / "out"), "--to", "export"]) == 0
    assert "Air_temp set column aside: shows 20 in every row" in capsys.readouterr().out
    assert (tmp_path / "out" / "export" / "table.ect").exists()


def test_a_term_that_reads_a_sensor_which_stood_still_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipeline = started(tmp_path, 1)
    term = "          - {term: scale_expansion, axis: X, sensor: Air_temp}\n"
    text = pipeline.read_text("utf-8").replace("          - {term: backlash", term + "          - {term: backlash")
    pipeline.write_text(text, "utf-8")
    assert main(["run", str(pipeline), "--out", str(tmp_path / "out"), "--to", "fit"]) == 3
    assert "Air_temp: cleaning set it aside: shows 20 in every row" in capsys.readouterr().err


@pytest.mark.parametrize(
    "values, match",
    [
        ([0.012, 0.215, 0.433, 0.652], r"um or mm \(mm is likely, by their decimals\)\? Declare it with --unit mm"),
        ([0.1, 0.2, 0.4, 0.6], r"um or mm \(um is likely, by their decimal\)"),
        ([0.2, -2.3], r"um or mm \(um is likely"),  # a router, measured with a caliper
        ([0.012, 0.415, 0.833, 1.252], "um or mm"),
        ([0.11, 0.42, 2.31, 4.25], "um or mm"),
        ([0.5, 1.5, 3.0, 2.5], "whole numbers, or halves"),
    ],
)
def test_readings_that_may_be_um_or_mm_are_asked_about(values: list[float], match: str) -> None:
    """From 1 on they were um with a note: somebody's 1.252 mm would have been compensated by a thousandth."""
    with pytest.raises(DataError, match=match):
        unit_by_size(np.array(values))


def test_readings_that_can_be_only_one_of_them_are_taken() -> None:
    assert unit_by_size(np.array([0.0123, -0.0871])) == "mm"  # 0.09 um are no error of an axis
    assert unit_by_size(np.array([0.12, -7.31])) == "um"  # nor are 7 mm
    assert unit_by_size(np.array([2.5, 5.0, -222.5])) == "um"  # a step of 2.5 is no division of a dial


@pytest.mark.parametrize(("factor", "places", "unit"), [(1, "mm", "mm"), (1000, "mm", "um"), (1, "inch", "mm")])
def test_deviations_with_both_positions_have_their_unit_from_them(
    tmp_path: Path, factor: int, places: str, unit: str
) -> None:
    """Deviations in mm beside both positions were read as um."""
    off = TARGETS / 500
    rows = [f"{x:.4f};{x + e:.4f};{factor * e:.4f}" for x, e in zip(TARGETS, off, strict=True)]
    (tmp_path / "f.csv").write_text("\n".join([f"NOM X [{places}];ACT X [{places}];DEV", *rows]), encoding="utf-8")
    proposal, _ = prepared([tmp_path / "f.csv"])
    assert proposal.entries["DEV"]["unit"] == unit
    recording = imported(tmp_path, tmp_path / "f.csv")
    scale = 1000.0 * (25.4 if places == "inch" else 1.0)
    assert recording.array("DEV") == pytest.approx(scale * off, abs=0.06 * scale / 1000)


@pytest.mark.parametrize(
    "header",
    [
        "Error (temperature compensated) [um]",
        "Error (temp. comp.) [um]",
        "temp comp error [um]",
        "Fehler temperaturkompensiert [µm]",
        "Error (wavelength compensated) [um]",
    ],
)
def test_what_is_referred_to_20_degrees_is_no_correction(tmp_path: Path, header: str) -> None:
    """Asked for its sign, or turned (`temp. comp.`)."""
    rows = [f"{x};{x / 60:.2f}" for x in TARGETS]
    (tmp_path / "f.csv").write_text("\n".join([f"X [mm];{header}", *rows]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.array(recording.names("error")[0]) == pytest.approx(TARGETS / 60, abs=0.01)


@pytest.mark.parametrize(
    ("form", "epoch"),
    [
        ("24-03-{d:02d} {h:02d}:00:00", "2024-03-05T00:00:00"),
        ("24/03/{d:02d} {h:02d}:00:00", "2024-03-05T00:00:00"),
        ("{d:02d}-03-24 {h:02d}:00:00", "2024-03-05T00:00:00"),
        ("{d:02d}/03/24 {h:02d}:00:00", "2024-03-05T00:00:00"),
    ],
)
def test_dates_with_a_year_of_two_digits(form: str, epoch: str) -> None:
    """The order in which the time is shortest; `24-03-05` was no time that is understood."""
    cells: list[Cell] = [form.format(d=5 + i // 24, h=i % 24) for i in range(30)]
    since = dates.seconds(RawColumn("Time", None, cells, np.full(30, np.nan)))
    assert since is not None
    assert since[0].tolist() == [3600.0 * i for i in range(30)] and since[1] == epoch


OTHER = {
    "ball bar": ("Angle [deg];Radius dev [um]", lambda i: f"{10 * i};{i % 5 + 0.1}", "protocol ballbar_circle"),
    "Ballbar": ("Ballbar XY 150\nAngle [deg];Dev [um]", lambda i: f"{10 * i};{i % 5 + 0.1}", "protocol ballbar_circle"),
    "R-test": ("C [deg];X [mm];Y [mm];Z [mm]", lambda i: f"{10 * i};{0.01 * i:.3f};{0.003 * i:.3f};0.1", "r_test"),
    "dX": ("C [deg];dX [um];dY [um];dZ [um]", lambda i: f"{10 * i};{i * i};{i};{i % 3}", "COLUMN.component=E_X"),
    "KGM": ("KGM 182\nX [mm];Y [mm]", lambda i: f"{50 * np.cos(i):.4f};{50 * np.sin(i):.4f}", "protocol point_cloud"),
    "X, Y": ("X [mm];Y [mm]", lambda i: f"{50 * np.cos(i):.4f};{50 * np.sin(i):.4f}", "grid encoder"),
    "blocks": ("REPORT", lambda i: f"FEATURE {i}\nPOSN NOM ACT DEV\nX{i} 1.0 1.001 0.001", "own probe"),
    "POSN": ("POSN;NOM;ACT;DEV", lambda i: f"X;{50 * i};{50 * i + 0.01:.3f};0.01", "--sign commanded-minus-actual"),
}


@pytest.mark.parametrize("name", OTHER)
def test_a_test_of_another_kind_is_named_with_what_reads_it(tmp_path: Path, name: str) -> None:
    """A print of a machine's own probe was read as if a laser had measured: with the sign of its readings."""
    header, row, match = OTHER[name]
    (tmp_path / "f.csv").write_text("\n".join([header, *(row(i) for i in range(24))]), encoding="utf-8")
    with pytest.raises(DataError, match=match):
        prepared([tmp_path / "f.csv"])


def test_formats_lists_the_tests_that_are_written_by_hand(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["formats"]) == 0
    says = capsys.readouterr().out
    assert [name for name, *_ in TESTS if f"  {name} " not in says] == []


@pytest.mark.parametrize(
    "content", [b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(600), b"\t\0\4\0" + bytes(300)], ids=["OLE", "Excel 2"]
)
def test_an_old_workbook_says_what_to_do(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "f.xls").write_bytes(content)
    with pytest.raises(DataError, match=r"save it as \.xlsx or \.csv"):
        prepared([tmp_path / "f.xls"])


def test_a_quote_with_an_angle_is_an_arc_second(tmp_path: Path) -> None:
    """`inch of an angle` was a riddle."""
    (tmp_path / "f.csv").write_text("\n".join(['X [mm];Pitch ["]', *(f"{x};{x / 60}" for x in TARGETS)]), "utf-8")
    proposal, _ = prepared([tmp_path / "f.csv"])
    assert '" for an angle is arcsec' in proposal.guesses["Pitch"] and "inch" not in proposal.guesses["Pitch"]


def positions(header: str = "Target [mm];Error [um]", above: str = "") -> str:
    return "\n".join([*([above] if above else []), header, *(f"{x:g};{x / 60 + 1.03:.2f}" for x in TARGETS)])


IN_WORDS = [
    ("d.csv", "X-Achse", "X"),
    ("d.csv", "Linearachse Y", "Y"),
    ("d.csv", "Axis: 1 (X)", "X"),
    ("d.csv", "Achse Nr. 2: Y", "Y"),
    ("d.csv", "Achsbezeichnung: Z", "Z"),
    ("d.csv", "Axe linéaire Y", "Y"),
    ("d.csv", "Asse lineare X", "X"),
    ("d.csv", 'Axis,"Y"', "Y"),
    ("d.csv", "Axis [X]", "X"),
    ("d.csv", "X ekseni", "X"),
    ("d.csv", "X축", "X"),
    ("d.csv", "Positionierung Y", "Y"),
    ("X_axis_run1.csv", "", "X"),
    ("Achse-Y.csv", "", "Y"),
    ("axe_Z 2.csv", "", "Z"),
    ("laser_X_2024.csv", "", "X"),
    ("Linear_Y_bidirectional.csv", "", "Y"),
]


@pytest.mark.parametrize(("name", "above", "axis"), IN_WORDS)
def test_an_axis_in_words_is_taken_with_a_note(tmp_path: Path, name: str, above: str, axis: str) -> None:
    (tmp_path / name).write_text(positions(above=above), encoding="utf-8")
    proposal, _ = import_files.prepare([tmp_path / name], ReaderOptions(), ImportOptions())
    assert proposal.entries["Target"]["axis"] == axis
    assert any(note.startswith(f"the axis is {axis}, from ") for note in proposal.notes)


@pytest.mark.parametrize(
    ("name", "above"),
    [("max.csv", ""), ("X_Y.csv", ""), ("report_A.csv", ""), ("d.csv", "Machine VMC X500"), ("d.csv", "Axis 1")],
)
def test_where_nothing_names_an_axis_the_answer_is_a_command(
    tmp_path: Path, name: str, above: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The question named an option, and not what to type."""
    (tmp_path / name).write_text(positions(above=above), encoding="utf-8")
    command = ["import", str(tmp_path / name), "--out", str(tmp_path / "my rec"), "--yes"]
    assert main(command) == 3
    again = capsys.readouterr().err.strip().split("\n")[-1]
    assert again.startswith("again, where it is X: errpipe import ")
    assert main(shlex.split(again.partition(": errpipe ")[2])) == 0
    assert (tmp_path / "my rec" / "recording.yaml").exists()
