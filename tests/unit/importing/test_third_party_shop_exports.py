"""Exports of shops: one file a sensor, clocks in digits, marks of a workbook, row names of R, passes with letters."""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from openpyxl.comments import Comment
from openpyxl.styles import Font

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.importing.readers import _workbook_marks
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, prepared

START = datetime(2025, 3, 12, 9)
HEADER = ["Run", "Target X (mm)", "Dir", "Deviation (um)"]


def written(path: Path, lines: list[str], encoding: str = "utf-8") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


def sign(side: float) -> str:
    return "+" if side > 0 else "-"


def stamp(seconds: float, form: str = "%Y-%m-%d %H:%M:%S") -> str:
    return (START + timedelta(seconds=seconds)).strftime(form)


def a_test(folder: Path) -> Path:
    rows = [f"{stamp(20 * k)};{r};{x};{sign(s)};{d}" for k, (r, x, s, d) in enumerate(long_rows())]
    return written(folder / "laser.csv", [f"Time;{';'.join(HEADER)}", *rows])


def a_log(
    path: Path, first: float, step: int, header: str = "Time;Value (°C)", period: tuple[int, int] = (-120, 1800)
) -> Path:
    lines = [f"{stamp(s)};{first + 0.001 * s:.3f};45" for s in range(*period, step)]
    return written(path, [header, *(line if "%" in header else line[:-3] for line in lines)])


def warmth(recording: Recording, of: str) -> np.ndarray:
    (name,) = [n for n in recording.names("temperature") if of in n]
    return recording.array(name)


def a_drift(tmp_path: Path, header: str, times: list[str]) -> np.ndarray:
    """Times in s of a drift, with a row for each text of a time."""
    lines = [f"{t},{k % 7}" for k, t in enumerate(times)]
    file = written(tmp_path / "drift.csv", [f"{header},Z growth (um)", *lines])
    recording = imported(tmp_path, file, component="E_Z", sign="actual-minus-commanded")
    time = recording.name("time")
    assert time is not None
    return recording.array(time) - recording.array(time)[0]


def test_logs_of_one_layout_and_period_are_two_sensors(tmp_path: Path) -> None:
    files = [a_test(tmp_path), a_log(tmp_path / "nut.csv", 20.0, 10), a_log(tmp_path / "bed.csv", 21.0, 60)]
    recording = imported(tmp_path, files)
    holds_the_truth(recording)
    seconds = 20.0 * np.arange(len(long_rows()))
    assert warmth(recording, "nut") == pytest.approx(20.0 + 0.001 * seconds, abs=0.01)
    assert warmth(recording, "bed") == pytest.approx(21.0 + 0.001 * seconds, abs=0.06)
    assert "bed" in str(recording.manifest.columns[next(n for n in recording.names("temperature") if "bed" in n)])


@pytest.mark.parametrize("names", [("bed_1", "nut_1", "nut_2", "bed_2"), ("bed_1", "nut_2", "bed_2", "nut_1")])
def test_the_files_of_two_loggers_are_told_apart_by_their_names(tmp_path: Path, names: tuple[str, ...]) -> None:
    first, half = {"bed": 20.0, "nut": 30.0}, {"1": (-120, 800), "2": (800, 1800)}
    logs = [a_log(tmp_path / f"{n}.csv", first[n[:3]], 10, period=half[n[-1]]) for n in names]
    recording = imported(tmp_path, [a_test(tmp_path), *logs])
    for name, start in first.items():
        assert warmth(recording, name) == pytest.approx(start + 0.02 * np.arange(78), abs=0.01)
    one_day = imported(tmp_path / "b", [a_test(tmp_path), *(log for log in logs if log.stem != "bed_2")])
    assert warmth(one_day, "bed")[-1] != pytest.approx(31.5, abs=1.0)


def test_a_file_that_may_be_of_either_logger_is_asked(tmp_path: Path) -> None:
    day_1 = [a_log(tmp_path / f"LOG{k}.csv", 10.0 + k, 10, period=(-120, 800)) for k in (1, 2)]
    with pytest.raises(DataError, match=r"LOG3: does it go on LOG1 or LOG2.*Name the files by their device"):
        prepared([a_test(tmp_path), *day_1, a_log(tmp_path / "LOG3.csv", 12.0, 10, period=(800, 1800))])


def test_names_of_files_that_make_one_name_of_a_column(tmp_path: Path) -> None:
    logs = [a_log(tmp_path / f"bed{mark}1.csv", 20.0 + k, 10) for k, mark in enumerate("- ")]
    recording = imported(tmp_path, [a_test(tmp_path), *logs])
    assert sorted(recording.array(n)[0] for n in recording.names("temperature")) == [20.0, 21.0]


def test_a_log_that_was_exported_twice_is_one_sensor(tmp_path: Path) -> None:
    files = [a_test(tmp_path), a_log(tmp_path / "a.csv", 20.0, 10), a_log(tmp_path / "b.csv", 20.0, 20)]
    assert len(imported(tmp_path, files).names("temperature")) == 1


def test_a_log_whose_clock_shows_minutes_has_equal_times(tmp_path: Path) -> None:
    log = a_log(tmp_path / "bed.csv", 20.0, 10, "Time;Value (°C);Humidity (%)")
    lines = log.read_text(encoding="utf-8").splitlines()
    written(log, [lines[0], *(f"{line[:16]}{line[19:]}" for line in lines[1:])])
    recording = imported(tmp_path, [a_test(tmp_path), log])
    assert recording.array(recording.names("temperature")[0])[30] == pytest.approx(20.6, abs=0.07)


def test_a_log_without_a_header_has_the_name_of_its_file(tmp_path: Path) -> None:
    log = a_log(tmp_path / "temperature_bed.csv", 20.0, 10)
    written(log, log.read_text(encoding="utf-8").splitlines()[1:])
    recording = imported(tmp_path, [a_test(tmp_path), log])
    assert warmth(recording, "temperature_bed")[0] == pytest.approx(20.0)


def workbook(path: Path) -> tuple[openpyxl.Workbook, openpyxl.worksheet.worksheet.Worksheet]:
    book = openpyxl.Workbook()
    sheet = book.worksheets[0]
    sheet.append(HEADER)
    for run, x, side, d in long_rows():
        sheet.append([int(run), float(x), sign(side), float(d)])
    return book, sheet


def test_readings_that_are_struck_through_are_left_out(tmp_path: Path) -> None:
    book, sheet = workbook(tmp_path)
    sheet.append([3, float(TARGETS[0]), "-", 99.0])
    for cell in sheet[sheet.max_row]:
        cell.font = Font(strike=True)
    book.save(tmp_path / "x.xlsx")
    assert any(f"(the first: A{sheet.max_row})" in n for n in prepared([tmp_path / "x.xlsx"])[0].notes)
    holds_the_truth(imported(tmp_path, tmp_path / "x.xlsx"))


def test_struck_cells_are_found_wherever_a_block_of_the_sheet_ends(tmp_path: Path, monkeypatch) -> None:
    book, sheet = workbook(tmp_path)
    for cell in sheet[5]:
        cell.font = Font(strike=True)
    book.save(tmp_path / "x.xlsx")
    (expected,) = _workbook_marks.marks_of(tmp_path / "x.xlsx").values()
    assert expected.struck == [(4, column) for column in range(4)]
    monkeypatch.setattr(_workbook_marks, "_BLOCK", 17)
    (marks,) = _workbook_marks.marks_of(tmp_path / "x.xlsx").values()
    assert marks.struck == expected.struck


def test_a_workbook_whose_comments_unpack_without_end_is_refused(tmp_path: Path, monkeypatch) -> None:
    book, sheet = workbook(tmp_path)
    sheet["D1"].comment = Comment("0" * 9000, "Roth")
    book.save(tmp_path / "x.xlsx")
    monkeypatch.setattr(_workbook_marks, "MOST_PART_BYTES", 8000)
    with pytest.raises(DataError, match=r"comments/comment1\.xml unpacks to more than"):
        prepared([tmp_path / "x.xlsx"])


def test_numbers_that_are_shown_divided_by_1000_are_refused(tmp_path: Path) -> None:
    book, sheet = workbook(tmp_path)
    for row in range(2, sheet.max_row + 1):
        sheet.cell(row, 4).number_format = "#,##0.0"
    book.save(tmp_path / "x.xlsx")
    holds_the_truth(imported(tmp_path, tmp_path / "x.xlsx"))
    for row in range(2, sheet.max_row + 1):
        sheet.cell(row, 4).number_format = '0.00,"k"'
    book.save(tmp_path / "x.xlsx")
    with pytest.raises(DataError, match=r"cell D2 is -1\.9 and shown as -0\.0019"):
        prepared([tmp_path / "x.xlsx"])


def test_a_comment_of_a_workbook_states_the_sign(tmp_path: Path) -> None:
    book, sheet = workbook(tmp_path)
    for row in range(2, sheet.max_row + 1):
        sheet.cell(row, 4).value *= -1
    sheet["D1"].comment = Comment("nominal - measured", "Roth")
    book.save(tmp_path / "x.xlsx")
    holds_the_truth(imported(tmp_path, tmp_path / "x.xlsx"))


@pytest.mark.parametrize("text", ["please sign here", "see Y axis report"])
def test_a_comment_of_a_workbook_on_anything_else_is_a_remark(tmp_path: Path, text: str) -> None:
    book, sheet = workbook(tmp_path)
    sheet["D1"].comment = Comment(text, "Roth")
    book.save(tmp_path / "x.xlsx")
    holds_the_truth(imported(tmp_path, tmp_path / "x.xlsx"))


@pytest.mark.parametrize("day", ["Day", "Tag", "day "])
def test_times_with_the_number_of_the_day(tmp_path: Path, day: str) -> None:
    minutes = np.arange(20 * 60, 30 * 60, 10)
    texts = [f"{day}{1 + m // 1440} {m // 60 % 24:02d}:{m % 60:02d}" for m in minutes]
    assert a_drift(tmp_path, "Time", texts) == pytest.approx(60.0 * (minutes - minutes[0]))


def test_clock_times_of_six_digits(tmp_path: Path) -> None:
    seconds = 90.0 * np.arange(60)
    texts = [stamp(s, "%H%M%S") for s in seconds]
    assert a_drift(tmp_path, "Time", texts) == pytest.approx(seconds)
    dated = [stamp(s, "%Y%m%d,%H%M%S") for s in seconds]
    assert a_drift(tmp_path, "Date,Time", dated) == pytest.approx(seconds)


def test_clock_times_of_four_digits_and_stamps_of_twelve(tmp_path: Path) -> None:
    seconds = 300.0 * np.arange(60)
    assert a_drift(tmp_path, "Time", [stamp(s, "%H%M") for s in seconds]) == pytest.approx(seconds)
    assert a_drift(tmp_path, "Timestamp", [stamp(s, "%Y%m%d%H%M") for s in seconds]) == pytest.approx(seconds)


def test_whole_numbers_that_count_seconds_stay_seconds(tmp_path: Path) -> None:
    for seconds in (100 * np.arange(12), 30 * np.arange(40), np.array([0, 120, 240, 300, 420, 540, 600, 720])):
        assert a_drift(tmp_path, "Time", [str(s) for s in seconds]) == pytest.approx(seconds.astype(float))


def test_a_clock_of_twelve_hours_passes_noon(tmp_path: Path) -> None:
    minutes = np.arange(10 * 60, 15 * 60, 5)
    texts = [f"{m // 60 % 12 or 12}:{m % 60:02d}" for m in minutes]
    assert a_drift(tmp_path, "Time", texts) == pytest.approx(60.0 * (minutes - minutes[0]))


def test_a_clock_of_twelve_hours_after_a_long_break_is_asked(tmp_path: Path) -> None:
    minutes = [*range(600, 720, 5), *range(810, 960, 5)]
    texts = [f"{m // 60 % 12 or 12}:{m % 60:02d}" for m in minutes]
    with pytest.raises(DataError, match="'1:30' follows '11:55': in the afternoon, or the next day"):
        a_drift(tmp_path, "Time", texts)


def test_runs_of_one_day_in_any_order_keep_their_dates(tmp_path: Path) -> None:
    hours = {"1": 11 * 3600, "2": 0, "3": 7200}
    rows = [f"{stamp(20 * k + hours[r])};{r};{x};{sign(s)};{d}" for k, (r, x, s, d) in enumerate(long_rows())]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", [f"Time;{';'.join(HEADER)}", *rows])))


@pytest.mark.parametrize("marks", ["LR", " L R", "-a-b"])
def test_passes_named_by_letters_are_the_sides_of_one_run(tmp_path: Path, marks: str) -> None:
    up, down = marks[: len(marks) // 2], marks[len(marks) // 2 :]
    rows = [f"{r}{up if s > 0 else down};{x};{d}" for r, x, s, d in long_rows()]
    file = written(tmp_path / "x.csv", ["Cycle;Target X (mm);Deviation (um)", *rows])
    holds_the_truth(imported(tmp_path, file))


@pytest.mark.parametrize("run", ["", "Run "])
def test_targets_in_the_rows_of_the_first_run_only_are_refused(tmp_path: Path, run: str) -> None:
    rows = [f"{run}{r};{x if r == '1' else ''};{d}" for r, x, s, d in long_rows() if s > 0]
    file = written(tmp_path / "x.csv", ["Run;Target X (mm);Deviation (um)", *rows])
    with pytest.raises(DataError, match="26 rows contain readings but no 'Target X'"):
        prepared([file])


def test_a_number_of_a_target_is_not_its_position(tmp_path: Path) -> None:
    rows = [f"{r};{int(x / 50) + 1};{sign(s)};{d}" for r, x, s, d in long_rows()]
    for name in ("Target No.", "target_id", "Pos. Nr."):
        file = written(tmp_path / "x.csv", [f"Run;{name};Dir;Deviation (um)", *rows])
        with pytest.raises(DataError, match="the number of a target, not its position"):
            prepared([file], axis="X")


def test_a_table_that_r_wrote_with_its_row_names(tmp_path: Path) -> None:
    head = '"run" "target mm" "dir" "deviation um"'
    rows = [f'"{k}" "{r}" {x} "{sign(s)}" {d}' for k, (r, x, s, d) in enumerate(long_rows(), 1)]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.txt", [head, *rows])))
    comma = [head.replace('" "', '","'), *(row.replace(" ", ",") for row in rows)]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", comma)))
    remark = [line.replace('" "', '" "" "', 1) for line in rows]  # an empty text is a cell
    remark = [head.replace('" "', '" "remark" "', 1), *remark]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.txt", remark)))


def test_a_separator_behind_each_row_but_the_first_is_no_column(tmp_path: Path) -> None:
    rows = [f"{k};{r};{x};{sign(s)};{d};" for k, (r, x, s, d) in enumerate(long_rows(), 1)]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", [f"Nr;{';'.join(HEADER)}", *rows])))


def test_records_of_five_lines_in_a_long_file(tmp_path: Path) -> None:
    records = [
        ["--- record ---", f"X_SOLL={x}", f"DIR={'PLUS' if s > 0 else 'MINUS'}", f"DEV_UM={d}", f"RUN={r}{k}"]
        for k in range(13)  # 5070 lines, of which every tenth is one without a value
        for r, x, s, d in long_rows()
    ]
    file = written(tmp_path / "x.txt", [line for record in records for line in record])
    assert imported(tmp_path, file, axis="X").frame.shape == (len(records), 4)


def test_a_dataset_of_ignition(tmp_path: Path) -> None:
    rows = [f'"{stamp(20 * k)}.000","{r}","{x}","{sign(s)}","{d}"' for k, (r, x, s, d) in enumerate(long_rows())]
    head = ['"#NAMES"', '"t_stamp","run","target_mm","dir","deviation_um"', '"#TYPES"', '"date","S","D","S","D"']
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", [*head, f'"#ROWS","{len(rows)}"', *rows])))


def test_a_grid_table_of_a_text(tmp_path: Path) -> None:
    rule = "+-----+---------------+-----+----------------+"
    rows = [x for r, t, s, d in long_rows() for x in (f"| {r} | {t} | {sign(s)} | {d} |", rule)]
    lines = [rule, f"| {' | '.join(HEADER)} |", rule.replace("-", "="), *rows]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.rst", lines)))


def test_temperatures_with_f_behind_each_number(tmp_path: Path) -> None:
    rows = [f"{r};{x};{sign(s)};{d};{68 + 0.1 * k:.1f} F" for k, (r, x, s, d) in enumerate(long_rows())]
    recording = imported(tmp_path, written(tmp_path / "x.csv", [f"{';'.join(HEADER)};Bed", *rows]))
    assert recording.array(recording.names("temperature")[0])[:2] == pytest.approx([20.0, 20.0 + 0.1 / 1.8])


def test_a_backlash_beside_deviations_is_no_deviation(tmp_path: Path) -> None:
    both = [*zip(TARGETS, deviation(1, 1.0), deviation(1, -1.0), strict=True)]
    rows = [f"{x};{up};{up - down:.1f}" for x, up, down in both]
    file = written(tmp_path / "x.csv", ["Target X (mm);Forward deviation (um);Backlash (um)", *rows])
    recording = imported(tmp_path, file)
    assert recording.array(recording.names("error")[0]) == pytest.approx(deviation(1, 1.0))
    rows = [f"{x};{up};{down};{up - down:.1f}".replace(".", ",") for x, up, down in both]
    head = "Soll X [mm];Abw. vorw. [µm];Abw. rückw. [µm];Umkehrspanne [µm]"
    recording = imported(tmp_path / "de", written(tmp_path / "german.csv", [head, *rows], "cp1252"))
    assert sorted(recording.array(recording.names("error")[0])) == pytest.approx(
        sorted([*deviation(1, 1.0), *deviation(1, -1.0)])
    )
    assert set(recording.array(recording.names("direction")[0])) == {1.0, -1.0}


@pytest.mark.parametrize(
    "name", ["Deviation (backlash comp off)", "Positioning error without backlash", "Abweichung ohne Umkehrspiel"]
)
def test_a_deviation_that_names_the_backlash_is_one(tmp_path: Path, name: str) -> None:
    rows = [f"{r};{x};{sign(s)};{d}" for r, x, s, d in long_rows()]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", [f"Run;Target X (mm);Dir;{name} (um)", *rows])))


@pytest.mark.parametrize(
    "header",
    [
        "Ajo;Kohdeasema (mm);Suunta;Poikkeama (µm)",
        "Прохід;Задане положення (мм);Напрямок;Відхилення (мкм)",
        "Κύκλος;Θέση στόχος (mm);Κατεύθυνση;Απόκλιση (μm)",
        "Ciclu;Poziție țintă (mm);Sens;Abatere (µm)",
    ],
)
def test_names_in_more_languages(tmp_path: Path, header: str) -> None:
    rows = [f"{r};{x};{sign(s)};{d}".replace(".", ",") for r, x, s, d in long_rows()]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", [header, *rows])))


def test_chinese_words_for_there_and_back(tmp_path: Path) -> None:
    head = "目标位置(mm)," + ",".join(f"{way}{run}(μm)" for run in (1, 2, 3) for way in ("去程", "回程"))
    values = [[deviation(run, side) for side in (1.0, -1.0)] for run in (1, 2, 3)]
    rows = [f"{x}," + ",".join(str(v[i]) for of_run in values for v in of_run) for i, x in enumerate(TARGETS)]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.csv", ["X轴", head, *rows], "gb18030")))


def test_a_unit_behind_the_names_of_a_text_is_that_of_the_readings(tmp_path: Path) -> None:
    lines = ["X axis positioning"]
    for title, side in (("FORWARD APPROACH", 1.0), ("REVERSE APPROACH", -1.0)):
        lines += ["", title, "Target(mm)  Run 1   Run 2   Run 3   (um)"]
        values = np.stack([TARGETS, *(deviation(run, side) for run in (1, 2, 3))], axis=1)
        lines += ["".join(f"{v:10.3f}" for v in row) for row in values[:: int(side)]]
    holds_the_truth(imported(tmp_path, written(tmp_path / "x.txt", lines)))


def test_what_a_file_without_a_table_states_is_repeated(tmp_path: Path) -> None:
    a_test(tmp_path / "laser")
    written(tmp_path / "laser" / "meta.json", ['{"axis": "X", "units": {"target": "in", "deviation": "thou"}}'])
    with pytest.raises(
        DataError, match=r"It states axis: X, units\.target: in, units\.deviation: thou.*only the files"
    ):
        prepared([tmp_path / "laser"])
