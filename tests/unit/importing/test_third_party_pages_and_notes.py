"""Printed pages, passes, states of a compensation, and what notes beside a table say of its sign, zero and time."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from tests.unit.importing.known_test import TARGETS, deviation, imported, long_rows, prepared

HEAD = "Run;Target X (mm);Dir;Deviation (um)"
START = datetime(2026, 5, 3, 23, 30)


def lines(head: str = HEAD, times: float = 1.0) -> list[str]:
    return [head, *(f"{run};{x};{side:+.0f};{times * d:.1f}" for run, x, side, d in long_rows())]


def one_way(times: float = 1.0) -> list[str]:
    """A test from one side: nothing in its readings shows their sign."""
    return ["Target X (mm);Deviation (um)", *(f"{x};{times * d:.1f}" for _, x, side, d in long_rows() if side > 0)]


def written(file: Path, rows: list[str], encoding: str = "utf-8") -> Path:
    file.write_text("\n".join(rows) + "\n", encoding=encoding)
    return file


def is_the_known_test(recording: Recording, error: str = "Deviation") -> None:
    position, side = (recording.array(str(recording.name(role))) for role in ("position", "direction"))
    codes = recording.run_codes()
    assert np.unique(codes).size == 3
    for run in (1, 2, 3):
        for way in (1.0, -1.0):
            of = (codes == run - 1) & (side == way)
            order = np.argsort(position[of])
            assert position[of][order] == pytest.approx(TARGETS)
            assert recording.array(error)[of][order] == pytest.approx(deviation(run, way))


@pytest.mark.parametrize("title", ["\fLASER   Page {} of 3", "\fPrüfprotokoll, Seite: {}"])
def test_pages_are_one_table_and_a_remark_below_leaves_the_directions(tmp_path: Path, title: str) -> None:
    out = []
    for i, (_, x, side, d) in enumerate(long_rows()):
        if i % 30 == 0:
            out += [title.format(1 + i // 30), f"{'Target X mm':>14}{'Dir':>6}{'Dev um':>12}"]
        out.append(f"{x:14.3f}{'+' if side > 0 else '-':>6}{d:12.2f}")
    file = written(tmp_path / "f.txt", [*out, "; door open in run 2", "Checked: 12.05.2026  B. Meyer"])
    is_the_known_test(imported(tmp_path, file), "Dev")


def test_a_force_beside_a_position_of_another_axis_has_its_own_letter(tmp_path: Path) -> None:
    rows = [f"{-100.0};{f};{0.02 * f + 0.3:.2f}" for f in range(-400, 401, 100)]
    file = written(tmp_path / "f.csv", ["Z [mm];Fx [N];dX [um]", *rows])
    recording = imported(tmp_path, file)
    assert next(c.axis for c in recording.manifest.columns.values() if c.role == "force") == "X"


def test_a_column_of_passes_beside_runs_is_the_direction(tmp_path: Path) -> None:
    rows = [f"{run};{-x};{'Forward' if side > 0 else 'Return'};{-d}" for run, x, side, d in long_rows()]
    recording = imported(tmp_path, written(tmp_path / "f.csv", [HEAD.replace("Dir", "Pass"), *rows]))
    side, out = recording.array(str(recording.name("direction"))), recording.array("Deviation")
    assert out[side < 0] == pytest.approx([-d for _, _, way, d in long_rows() if way > 0])  # forward falls


def test_a_row_of_units_may_begin_with_a_number_sign(tmp_path: Path) -> None:
    rows = ["Run;Target X;Dir;Deviation", "#;mm;-;0.1 um", *lines(times=10.0)[1:]]
    is_the_known_test(imported(tmp_path, written(tmp_path / "f.csv", rows)))


def test_the_newest_row_may_come_first(tmp_path: Path) -> None:
    rows = [f"{START + timedelta(seconds=20 * i):%Y-%m-%d %H:%M:%S};{row}" for i, row in enumerate(lines()[1:])]
    head = "Timestamp;" + HEAD
    file = written(tmp_path / "f.csv", [head, *rows[::-1]])
    recording = imported(tmp_path, file)
    is_the_known_test(recording)
    assert np.all(np.diff(recording.array(str(recording.name("time")))) > 0)


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M", "%H:%M:%S"])
def test_the_newest_row_may_come_first_by_a_coarse_clock_or_one_without_a_date(tmp_path: Path, form: str) -> None:
    stamps = [START.replace(hour=8) + timedelta(seconds=30 * i) for i in range(len(long_rows()))]
    rows = [f"{t.strftime(form)};{row}" for t, row in zip(stamps, lines()[1:], strict=True)]
    recording = imported(tmp_path, written(tmp_path / "f.csv", ["Timestamp;" + HEAD, *rows[::-1]]))
    is_the_known_test(recording)
    assert np.all(np.diff(recording.array(str(recording.name("time")))) >= 0)


def test_days_of_whole_runs_leave_the_order_of_the_rows(tmp_path: Path) -> None:
    days = [f"2026-05-{9 - int(run):02d};{x};{d:.1f}" for run, x, _, d in long_rows()]  # the last run first
    proposal, _ = prepared([written(tmp_path / "f.csv", ["Date;Target X (mm);Deviation (um)", *days])])
    assert proposal.data["Deviation"] == pytest.approx([d for *_, d in long_rows()], abs=0.06)
    assert not any("reversed" in note for note in proposal.notes)


def test_dates_that_fall_are_read_in_the_order_of_day_and_month_that_is_shorter(tmp_path: Path) -> None:
    rows = [f"{day:02d}/02/2026 08:00:00;{day / 2}" for day in range(9, 0, -1)]
    file = written(tmp_path / "f.csv", ["Time;Z growth (um)", *rows])
    proposal, _ = prepared([file], component="E_Z")
    assert np.ptp(proposal.data["t"]) == pytest.approx(8 * 86400.0)


@pytest.mark.parametrize(("header", "labels"), [("Comp", ("off", "on")), ("State", ("before comp.", "after comp."))])
def test_rows_with_and_without_compensation_are_asked_about(
    tmp_path: Path, header: str, labels: tuple[str, str]
) -> None:
    rows = [f"{labels[i]};{row}" for i, k in enumerate((1.0, 0.4)) for row in lines(times=k)[1:]]
    file = written(tmp_path / "f.csv", [f"{header};{HEAD}", *rows])
    with pytest.raises(DataError, match=f"{header!r} contains .*: states of the machine"):
        prepared([file])
    prepared([file], sets=[f"{header}.role=ignore"])


def test_three_states_of_a_compensation_are_asked_about(tmp_path: Path) -> None:
    rows = [f"{state};{row}" for state in ("off", "on", "on + temp") for row in lines()[1:]]
    with pytest.raises(DataError, match="'Comp' contains off and on and on \\+ temp"):
        prepared([written(tmp_path / "f.csv", [f"Comp;{HEAD}", *rows])])


@pytest.mark.parametrize(
    ("header", "labels"),
    [("Comment", ("ok", "cable corr.")), ("Air comp.", ("manual", "auto")), ("Tool comp", ("G41", "G42"))],
)
def test_remarks_and_other_compensations_are_not_states(tmp_path: Path, header: str, labels: tuple[str, str]) -> None:
    rows = [f"{labels[i == 3]};{row}" for i, row in enumerate(lines()[1:])]
    is_the_known_test(imported(tmp_path, written(tmp_path / "f.csv", [f"{header};{HEAD}", *rows])))


def test_a_line_on_diameter_programming_is_asked_about(tmp_path: Path) -> None:
    file = written(tmp_path / "f.csv", ["Lathe, X programmed in diameter", *lines()])
    with pytest.raises(DataError, match="a line above says diameters"):
        prepared([file])


def test_a_readme_that_states_the_sign_is_asked_about(tmp_path: Path) -> None:
    folder = tmp_path / "X axis"
    folder.mkdir()
    written(folder / "laser.csv", one_way(-1.0))
    notes = written(folder / "README.txt", ["Night shift.", "Deviations are measured minus commanded."])
    prepared([folder])
    written(notes, ["Night shift.", "Deviations are commanded minus measured."])
    with pytest.raises(DataError, match=r"README\.txt states 'Deviations are commanded minus measured\.'"):
        prepared([folder])
    prepared([folder], sign="commanded-minus-actual")


def test_a_licence_and_prose_beside_a_table_state_no_sign(tmp_path: Path) -> None:
    folder = tmp_path / "X axis"
    folder.mkdir()
    written(folder / "laser.csv", one_way())
    written(folder / "LICENSE", ["your employer, if any, to sign a copyright disclaimer", "times -1 of the values"])
    written(folder / "README.md", ["# Laser test", "To see the data please sign in at the portal."])
    prepared([folder])
    written(folder / "README.md", ["# Laser test", "The sign of the readings is inverted."])
    with pytest.raises(DataError, match=r"README\.md states 'The sign of the readings is inverted"):
        prepared([folder])


def test_a_sheet_of_notes_that_states_the_sign_is_asked_about(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    book.active.title = "Info"
    book.active.append(["Machine", "VMC 3"])
    book.active.append(["Deviation", "nominal minus actual"])
    data = book.create_sheet("Data")
    for row in one_way(-1.0):
        data.append([float(c) if c[-1].isdigit() else c for c in row.split(";")])
    book.save(tmp_path / "f.xlsx")
    with pytest.raises(DataError, match="Info states 'Deviation nominal minus actual'"):
        prepared([tmp_path / "f.xlsx"])


@pytest.mark.parametrize("header", ["Deviation x100 (um)", "Deviation (um), 100:1"])
def test_multiplied_readings_are_asked_about(tmp_path: Path, header: str) -> None:
    file = written(tmp_path / "f.csv", lines(HEAD.replace("Deviation (um)", header), 100.0))
    with pytest.raises(DataError, match=r"are its readings multiplied .*unit=0\.01 um' for um times 100"):
        prepared([file])


def test_the_factor_of_multiplied_readings_is_that_of_the_header(tmp_path: Path) -> None:
    file = written(tmp_path / "f.csv", lines(HEAD.replace("Deviation", "Deviation x1000"), 1000.0))
    with pytest.raises(DataError, match=r"unit=0\.001 um' for um times 1000"):
        prepared([file])
    is_the_known_test(imported(tmp_path, file, sets=["Deviation x1000.unit=0.001 um"]), "Deviation_x1000")


def test_a_mean_of_ten_readings_is_not_multiplied(tmp_path: Path) -> None:
    file = written(tmp_path / "f.csv", lines(HEAD.replace("Deviation", "Deviation, mean of 10 x")))
    is_the_known_test(imported(tmp_path, file), "Deviation_mean_of_10_x")


def test_a_row_of_means_and_a_line_of_the_unit_leave_runs_and_sides_of_a_table_across(tmp_path: Path) -> None:
    def row(name: str, values: np.ndarray) -> str:
        return ";".join([name, *(f"{v:.1f}" for v in values)])

    rows = [row(f"Passe {r} {'→' if s > 0 else '←'}", deviation(r, s)) for r in (1, 2, 3) for s in (1.0, -1.0)]
    mean = row("Moyenne →", np.mean([deviation(r, 1.0) for r in (1, 2, 3)], axis=0))
    head = ";".join(["Axe X", *(f"{x:g} mm" for x in TARGETS)])
    is_the_known_test(imported(tmp_path, written(tmp_path / "f.csv", [head, *rows, mean, "Unité: µm"])), "error")


def test_a_clock_that_passes_midnight_on_the_date_of_the_start_is_asked_about(tmp_path: Path) -> None:
    clocks = [START + timedelta(minutes=i) for i in range(60)]
    dated = [f"{t:%Y-%m-%d};{t:%I:%M %p};{i / 2}" for i, t in enumerate(clocks)]
    head = "Date;Time;Z growth (um)"
    recording = imported(tmp_path, written(tmp_path / "f.csv", [head, *dated]), component="E_Z")
    assert recording.array(str(recording.name("time"))) == pytest.approx(60.0 * np.arange(60))
    of_the_start = [f"2026-05-03;{row.partition(';')[2]}" for row in dated]
    with pytest.raises(DataError, match="passes midnight, and the date does not change"):
        prepared([written(tmp_path / "f.csv", [head, *of_the_start])], component="E_Z")


def test_a_series_of_days_that_starts_again_does_not_pass_midnight(tmp_path: Path) -> None:
    rows = [f"2026-05-{day:02d};{x};{x / 40}" for x in range(0, 320, 80) for day in (3, 4, 5)]
    prepared([written(tmp_path / "f.csv", ["Date;Target X (mm);Deviation (um)", *rows])])


@pytest.mark.parametrize(
    ("line", "header", "question"),
    [
        (
            "Gauge: 1 div = 0.001 mm",
            "Reading (div)",
            r"'Reading_div' is in divisions, of 0\.001 mm .*Reading_div.unit=",
        ),
        ("1 Teilstrich = 0,01 mm", "Deviation", r"'Deviation' states no unit, .* a division of 0\.01 mm: --unit"),
    ],
)
def test_the_scale_of_a_gauge_is_asked_about(tmp_path: Path, line: str, header: str, question: str) -> None:
    file = written(tmp_path / "f.csv", [line, *lines(HEAD.replace("Deviation (um)", header))])
    with pytest.raises(DataError, match=question):
        prepared([file])
    stated = lines()
    prepared([written(tmp_path / "f.csv", [line, *stated])])


def test_an_axis_of_the_command_line_that_a_line_contradicts_is_named(tmp_path: Path) -> None:
    file = written(tmp_path / "f.csv", ["Achse X", *lines(HEAD.replace("Target X", "Target"))])
    proposal, _ = prepared([file], axis="Y")
    assert "the axis is Y, by --axis; 'Achse X' states X" in proposal.notes
    proposal, _ = prepared([file], axis="X")
    assert not any("by --axis" in note for note in proposal.notes)
