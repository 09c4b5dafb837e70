"""Third-party result sheets: merged cells, sides in a column, words for signs in more languages, several machines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError, UsageError
from errpipe.importing import words
from errpipe.importing.sheet import ReaderOptions
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows
from tests.unit.importing.test_first_hour import RUNS, SIDES, de, long


def written(tmp_path: Path, text: str) -> Path:
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    return tmp_path / "f.csv"


def test_a_row_of_run_numbers_between_groups_and_units(tmp_path: Path) -> None:
    """As a spreadsheet has it: two merged cells, the runs, the units, the readings, figures over the runs."""
    head = ["Soll X;vorwärts;;;rückwärts;;", ";1;2;3;1;2;3", "mm;µm;µm;µm;µm;µm;µm"]
    columns = [deviation(r, s) for s in SIDES for r in RUNS]
    rows = [";".join([de(x), *(de(c[i]) for c in columns)]) for i, x in enumerate(TARGETS)]
    holds_the_truth(
        imported(tmp_path, written(tmp_path, "\n".join([*head, *rows, "Mittelwert;1,1;1,2;1,3;1,1;1,2;1,3"])))
    )


@pytest.mark.parametrize("merged", [True, False])
@pytest.mark.parametrize("header", ["i;Target X [mm];Dir;1 [um];2 [um];3 [um];Mean;s", "i;Target X [mm];Dir;Dev [um]"])
def test_a_row_for_each_side_of_a_target(tmp_path: Path, header: str, merged: bool) -> None:
    """The side stands in a column; of a target in a merged cell only the row of the way up has it."""
    runs = RUNS if "Mean" in header else (1,)
    lines = [header]
    for i, x in enumerate(TARGETS):
        for s, arrow in zip(SIDES, "↑↓", strict=True):
            place = ["", ""] if merged and s < 0 else [str(i + 1), f"{x:g}"]
            figures = ["1.0", "0.5"] if len(runs) > 1 else []
            lines.append(";".join([*place, arrow, *(str(deviation(r, s)[i]) for r in runs), *figures]))
    recording = imported(tmp_path, written(tmp_path, "\n".join(lines)))
    if len(runs) > 1:
        holds_the_truth(recording)
    held = {(x, s): d for x, s, d in zip(*(recording.array(n) for n in map(name_of(recording), ROLES)), strict=True)}
    assert len(held) == 2 * TARGETS.size
    assert all(np.sign(held[x, 1.0] - held[x, -1.0]) == -1 for x in TARGETS)


ROLES = ("position", "direction", "error")


def name_of(recording: object):  # type: ignore[no-untyped-def]
    return lambda role: recording.names(role)[0]  # type: ignore[attr-defined]


def test_readings_without_a_target_are_asked_about(tmp_path: Path) -> None:
    """No column says the sides: the second of two rows would be left out, and backlash with it."""
    lines = ["Target X [mm];Deviation [um]"]
    for i, x in enumerate(TARGETS):
        lines += [f"{x:g};{deviation(1, 1.0)[i]}", f";{deviation(1, -1.0)[i]}"]
    with pytest.raises(DataError, match="12 rows contain readings but no"):
        imported(tmp_path, written(tmp_path, "\n".join(lines)))


def test_a_column_of_one_side_is_kept(tmp_path: Path) -> None:
    rows = [f"{r};-;{x:g};{d}" for r, x, s, d in long_rows() if s < 0]
    recording = imported(tmp_path, written(tmp_path, "\n".join(["Run;Dir;X [mm];Deviation [um]", *rows])))
    assert set(recording.array("Dir")) == {-1.0}
    text = "\n".join(["Run;Dir;X [mm];Deviation [um]", *(row.replace("-;", "fwd;", 1) for row in rows)])
    with pytest.raises(DataError, match="a forward or return pass"):
        imported(tmp_path, written(tmp_path, text))


CORRECTIONS = [
    "Compensazione",
    "Compensación",
    "Correctif",
    "修正值",
    "Nachstellung",
    "Korekcja",
    "보정",
    "Pitch error comp",
]


@pytest.mark.parametrize("header", CORRECTIONS)
def test_corrections_in_more_languages(tmp_path: Path, header: str) -> None:
    text = long(f"Run;Dir;X [mm];{header} [um]", lambda r, x, s, d: f"{r};{'+' if s > 0 else '-'};{x:g};{-d}")
    holds_the_truth(imported(tmp_path, written(tmp_path, text)))


ERRORS = ["Odchyłka", "Błąd", "Odchylka", "Afwijking", "Desvio", "Avvikelse", "Sapma", "Отклонение", "오차"]


@pytest.mark.parametrize("header", ERRORS)
def test_deviations_in_more_languages(header: str) -> None:
    assert words.kind_by_name(header) == "error"


@pytest.mark.parametrize(
    "header",
    ["-Error", "neg. error", "Inverted error", "Compensation error", "Fehlbetrag", "Soll/Ist Differenz", "CAL"],
)
def test_a_header_that_may_say_the_other_sign_is_asked_about(tmp_path: Path, header: str) -> None:
    text = long(f"Run;Dir;X [mm];{header} [um]", lambda r, x, s, d: f"{r};{'+' if s > 0 else '-'};{x:g};{d}")
    with pytest.raises(DataError, match="--sign actual-minus-commanded"):
        imported(tmp_path, written(tmp_path, text))
    holds_the_truth(imported(tmp_path, written(tmp_path, text), sign="actual-minus-commanded"))


@pytest.mark.parametrize(("unit", "per_um"), [("um", 1.0), ("µin", 1 / 0.0254)])
def test_a_micrometre_an_inch_is_no_absolute_reading(tmp_path: Path, unit: str, per_um: float) -> None:
    """Numbers that rise one for one with the position, in another unit: an axis 39 um/m too long."""
    rows = [f"{x / 25.4:.6f};{x / 25.4 * per_um:.6f}" for x in TARGETS]
    recording = imported(tmp_path, written(tmp_path, "\n".join([f"X [in];Deviation [{unit}]", *rows])))
    assert recording.array("Deviation") == pytest.approx(TARGETS / 25.4, abs=1e-4)


def test_rows_of_two_machines_are_two_recordings(tmp_path: Path) -> None:
    line = "{m};{r};{w};{x:g};{d}"
    rows = [
        line.format(m=m, r=r, w="+" if s > 0 else "-", x=x, d=k * d)
        for m, k in (("M7", 1), ("M9", 3))
        for r, x, s, d in long_rows()
    ]
    for header in ("Machine", "Serial no."):
        file = written(tmp_path, "\n".join([f"{header};Run;Dir;X [mm];Deviation [um]", *rows]))
        with pytest.raises(DataError, match=r"several machines \(M7, M9\)"):
            imported(tmp_path, file)
        holds_the_truth(imported(tmp_path, file, machine="M7"))
        both = imported(tmp_path, file, sets=[f"{header}.role=group"])
        assert len(both) == 2 * len(long_rows())


def test_a_recording_that_was_changed_is_not_overwritten(tmp_path: Path) -> None:
    file = written(
        tmp_path, long("Run;Dir;X [mm];Deviation [um]", lambda r, x, s, d: f"{r};{'+' if s > 0 else '-'};{x:g};{d}")
    )
    manifest, table = (tmp_path / "rec" / name for name in ("recording.yaml", "recording.csv"))
    imported(tmp_path, file)
    imported(tmp_path, file, title="again")  # as an import wrote it: nothing of a person is lost
    for changed in (manifest, table):
        before = changed.read_text("utf-8")
        changed.write_text(
            before.replace("-1.9", "-1.8") if changed is table else before.replace("unit: um", "unit: nm")
        )
        assert changed.read_text("utf-8") != before
        with pytest.raises(UsageError, match="changed since it was imported"):
            imported(tmp_path, file)
        changed.write_text(before, "utf-8")
    manifest.write_text("recording: 1\n", "utf-8")
    with pytest.raises(UsageError, match="--overwrite"):
        imported(tmp_path, file)
    assert manifest.read_text("utf-8") == "recording: 1\n"


def test_swapped_names_of_positions_are_asked_about(tmp_path: Path) -> None:
    """The targets come back to the last digit; where the `actual` ones do, the sign would be turned."""
    line = "{r};{w};{x:.4f};{y:.4f}"
    rows = [line.format(r=r, w="+" if s > 0 else "-", x=x + d / 1e3, y=x) for r, x, s, d in long_rows()]
    file = written(tmp_path, "\n".join(["Run;Dir;Target X [mm];Actual X [mm]", *rows]))
    with pytest.raises(DataError, match="names swapped"):
        imported(tmp_path, file)
    holds_the_truth(imported(tmp_path, file, sets=["Target_X.role=actual", "Actual_X.role=command"]))


def test_a_reversal_called_u_names_no_axis(tmp_path: Path) -> None:
    """VDI/DGQ 3441 as Heidenhain writes it: means and reversal (U) beside the runs."""
    head = "Achse: X\n\nPosition [mm];" + ";".join(f"{w} {r}" for r in RUNS for w in "+-") + ";MW+;MW-;MW;U"
    columns = [deviation(r, s) / 1e3 for r in RUNS for s in SIDES]
    rows = [";".join([de(x), *(de(c[i], 4) for c in columns), *["0,0010"] * 4]) for i, x in enumerate(TARGETS)]
    holds_the_truth(imported(tmp_path, written(tmp_path, "\n".join([head, *rows]))))


def test_an_actual_angle_that_passed_zero_before_its_command(tmp_path: Path) -> None:
    """C at 0 deg reads 359.9994: 10 urad short, not a turn too far."""
    commanded, error = np.arange(0.0, 360.0, 30.0), 10.0 * np.sin(np.radians(np.arange(0.0, 360.0, 30.0))) - 10.0
    rows = [f"{c:g};{(c + np.degrees(e * 1e-6)) % 360.0:.7f}" for c, e in zip(commanded, error, strict=True)]
    recording = imported(tmp_path, written(tmp_path, "\n".join(["C cmd [deg];C act [deg]", *rows])))
    assert recording.array("ECC") == pytest.approx(error, abs=0.01)


def test_three_readings_with_moving_axes_are_asked_about(tmp_path: Path) -> None:
    """An R-test holds deviations of the tool point; each alone would become the positioning of its axis."""
    t = np.radians(np.arange(0.0, 360.0, 30.0))
    rows = [f"1;{100 * np.cos(a):.4f};{100 * np.sin(a):.4f};{9 * np.cos(a):.2f};{9 * np.sin(a):.2f}" for a in t]
    file = written(tmp_path, "\n".join(["Run;X [mm];Y [mm];dX [um];dY [um]", *rows]))
    with pytest.raises(DataError, match="deviations of the tool point"):
        imported(tmp_path, file)
    recording = imported(tmp_path, file, sets=["dX.component=E_X", "dY.component=E_Y"])
    assert set(recording.components()) == {"E_X", "E_Y"}


def across(targets: str, sides: str) -> str:
    lines = [f"Target position Pi (mm);{targets}", f"Approach direction;{sides}"]
    for r in RUNS:
        pairs = zip(deviation(r, 1.0), deviation(r, -1.0), strict=True)
        lines.append(f"j={r};" + ";".join(f"{up};{down}" for up, down in pairs))
    return "\n".join(["Axis X, deviations in um", *lines, "Mean (um);" + ";".join(["1.0;2.0"] * TARGETS.size)])


@pytest.mark.parametrize("form", ["{x:g};", "{x:g};{x:g}"])
def test_targets_across_for_each_side(tmp_path: Path, form: str) -> None:
    """The sheet of ISO 230-2, Annex A: a target over the columns of both sides, merged or written twice."""
    text = across(";".join(form.format(x=x) for x in TARGETS), ";".join(["↑;↓"] * TARGETS.size))
    holds_the_truth(imported(tmp_path, written(tmp_path, text)))


def test_figures_over_the_runs_are_no_readings_and_no_axis(tmp_path: Path) -> None:
    head = "Axis: X\n\nPos [mm];" + ";".join(f"{w}{r} [um]" for r in RUNS for w in ("Fwd", "Bwd"))
    columns = [deviation(r, s) for r in RUNS for s in SIDES]
    rows = [";".join([f"{x:g}", *(str(c[i]) for c in columns), "1;2;-8;0.3"]) for i, x in enumerate(TARGETS)]
    text = "\n".join([f"{head};xi fwd;xi bwd;Bi;si fwd", *rows])
    holds_the_truth(imported(tmp_path, written(tmp_path, text)))


def test_means_as_bars_over_letters(tmp_path: Path) -> None:
    """Of a report that holds only the figures of ISO 230-2: the means of both sides, along Y."""
    rows = [f"{x:g};{deviation(1, 1.0)[i]};{deviation(1, -1.0)[i]};1;-8;9;9" for i, x in enumerate(TARGETS)]
    text = "\n".join(["Axis: Y", "Unit: um", "", "Pos;x̄↑;x̄↓;x̄;B;x̄↑+2s↑;x̄↓-2s↓", *rows])
    recording = imported(tmp_path, written(tmp_path, text))
    assert recording.components() == ("EYY",)
    side = recording.array(recording.names("direction")[0])
    assert recording.array("EYY")[side > 0] == pytest.approx(deviation(1, 1.0))
    assert sorted(recording.array("EYY")[side < 0]) == pytest.approx(sorted(deviation(1, -1.0)))


def pass_of(run: int, side: float, turned: bool = False) -> str:
    rows = [f"{x:g};{d}" for x, d in zip(TARGETS, deviation(run, side), strict=True)]
    return "\n".join(["X [mm];Deviation [um]", *(rows[::-1] if turned else rows)])


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("names", [("up", "down"), ("Hinweg", "Rückweg"), ("fwd", "rev")])
def test_the_sides_of_files_stand_in_their_names(tmp_path: Path, names: tuple[str, str], turned: bool) -> None:
    """A file for each pass: without its side the lost motion is scatter between runs, and nothing corrects it."""
    files = []
    for r in RUNS:
        for s, name in zip(SIDES, names, strict=True):
            files.append(tmp_path / f"X_run{r}_{name}.csv")
            files[-1].write_text(pass_of(r, s, turned and s < 0), encoding="utf-8")
    holds_the_truth(imported(tmp_path, files))


def test_names_that_do_not_all_say_a_side_say_none(tmp_path: Path) -> None:
    files = [tmp_path / f"{name}.csv" for name in ("2025-03-01", "2025-03-02 up")]
    for r, file in enumerate(files, 1):
        file.write_text(pass_of(r, 1.0), encoding="utf-8")
    recording = imported(tmp_path, files)
    assert recording.names("direction") == () and len(set(recording.run_labels())) == 2


@pytest.mark.parametrize(
    ("line", "side"),
    [
        ("Direction: backward", -1.0),
        ("Richtung;rückwärts", -1.0),
        ("Approach: from below", 1.0),
        ("Direction: X+", None),
    ],
)
def test_a_line_above_says_the_side_of_all_readings(tmp_path: Path, line: str, side: float | None) -> None:
    recording = imported(tmp_path, written(tmp_path, f"{line}\n{pass_of(1, side or 1.0)}"))
    sides = [set(recording.array(n)) for n in recording.names("direction")]
    assert sides == ([] if side is None else [{side}])
    place = recording.array(recording.names("position")[0])
    assert (np.diff(place) * (side or 1.0) > 0).all()


def test_forward_of_an_axis_that_goes_down_is_asked_about(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="and the positions fall"):
        imported(tmp_path, written(tmp_path, f"Direction: forward\n{pass_of(1, 1.0, turned=True)}"))


@pytest.mark.parametrize(
    ("names", "joined"),
    [
        (["Lauf 1", "Lauf 2", "Lauf 3"], True),
        (["X run 1", "X run 2", "X run 3"], True),
        (["Messung 1 vor Komp", "Messung 2 nach Komp", "Messung 3 nach Komp"], False),
        (["Tabelle1", "Tabelle2", "Tabelle3"], False),
        (["2024", "2025", "2026"], False),
    ],
)
def test_sheets_that_are_runs_are_joined(tmp_path: Path, names: list[str], joined: bool) -> None:
    """Only the first of three runs was imported; sheets that may be of something else are asked about."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for run, name in enumerate(names, 1):
        sheet = book.create_sheet(name)
        for row in [["Dir", "X [mm]", "Deviation [um]"], *rows_of_run(run)]:
            sheet.append(row)
    book.save(tmp_path / "f.xlsx")
    if joined:
        holds_the_truth(imported(tmp_path, tmp_path / "f.xlsx"))
        return
    with pytest.raises(DataError, match=r"which one is meant|several states"):
        imported(tmp_path, tmp_path / "f.xlsx")
    assert len(imported(tmp_path, tmp_path / "f.xlsx", ReaderOptions(sheet=names[1]))) == 2 * TARGETS.size


def rows_of_run(run: int) -> list[list[object]]:
    return [["+" if s > 0 else "-", float(x), float(d)] for r, x, s, d in long_rows() if r == str(run)]


def test_blocks_below_a_header_with_a_row_of_units(tmp_path: Path) -> None:
    """`Run 1 backward` above each block says run and side, although its targets are listed as they rise."""
    words = dict(zip(SIDES, ("forward", "backward"), strict=True))
    text = "".join(
        f"Run {r} {words[s]}\nPos;Err\nmm;um\n"
        + "".join(f"{x:g};{d}\n" for x, d in zip(TARGETS, deviation(r, s), strict=True))
        for r in RUNS
        for s in SIDES
    )
    holds_the_truth(imported(tmp_path, written(tmp_path, f"Axis X\n{text}")))


def test_decimal_commas_between_blanks_with_other_words(tmp_path: Path) -> None:
    rows = [f"{r}  {'+' if s > 0 else '-'}  {de(x)}  {de(d)}" for r, x, s, d in long_rows()]
    holds_the_truth(imported(tmp_path, written(tmp_path, "\n".join(["Run  Dir  X[mm]  Dev[um]", *rows]))))


def test_a_mean_behind_each_target_is_no_reading_without_one(tmp_path: Path) -> None:
    lines = ["No;Target X [mm];Dir;Deviation [um]"]
    for i, x in enumerate(TARGETS):
        lines += [f"{i + 1};{x:g};{'+' if s > 0 else '-'};{deviation(r, s)[i]}" for r in RUNS for s in SIDES]
        lines.append(f"Mean;;;{i}.5")
    recording = imported(tmp_path, written(tmp_path, "\n".join(lines)))
    assert len(recording) == 6 * TARGETS.size


def test_targets_of_the_way_back_in_columns_of_their_own(tmp_path: Path) -> None:
    """Two tables side by side, each in the order of measuring: a row holds readings of two targets."""
    rows = []
    for i, x in enumerate(TARGETS):
        j = TARGETS.size - 1 - i
        there, back = ([deviation(r, s)[k] for r in RUNS] for s, k in zip(SIDES, (i, j), strict=True))
        rows.append(";".join(map(str, [x, *there, "", TARGETS[j], *back])))
    head = ["Axis X", "Forward;;;;;Backward", "Pos [mm];1 [um];2 [um];3 [um];;Pos [mm];1 [um];2 [um];3 [um]"]
    holds_the_truth(imported(tmp_path, written(tmp_path, "\n".join([*head, *rows]))))


@pytest.mark.parametrize("letter", ["R", "D", "N", "P", "V"])
def test_a_letter_that_all_runs_share_is_no_side(tmp_path: Path, letter: str) -> None:
    """R1, R2, R3 are readings, or runs: they were taken as approached from above."""
    rows = [";".join([f"{x:g}", *(str(deviation(r, 1.0)[i]) for r in RUNS)]) for i, x in enumerate(TARGETS)]
    head = "X [mm];" + ";".join(f"{letter}{r} [um]" for r in RUNS)
    recording = imported(tmp_path, written(tmp_path, "\n".join([head, *rows])))
    assert recording.names("direction") == () and len(set(recording.run_labels())) == 3
