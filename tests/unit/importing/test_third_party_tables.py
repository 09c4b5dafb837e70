"""Tables as reports and sheets hold them: blocks below one another, sides as arrows, levels, several axes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError, ErrpipeError
from errpipe.importing.sheet import ReaderOptions
from errpipe.importing.words import kind_by_name
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, prepared
from tests.unit.importing.test_first_hour import PAIRS, RUNS, SIDES, headers, long, mark, wide


def written(tmp_path: Path, text: str) -> Path:
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    return tmp_path / "f.csv"


ARROWS = ["⇑⇓", "⬆⬇", "▲▼", "↗↘", "⇒⇐", "⟶⟵", "►◄", "正负"]


@pytest.mark.parametrize("pair", [*ARROWS, "FB"])
def test_sides_as_signs_behind_the_run(tmp_path: Path, pair: str) -> None:
    """`Run 1 B` is the way back, not the reversal value B of ISO 230-2."""
    header = "Target X [mm];" + headers("Run {r} {w} [um]", *pair)
    holds_the_truth(imported(tmp_path, written(tmp_path, wide(header))))


def test_the_reversal_value_with_the_readings_names_no_axis(tmp_path: Path) -> None:
    header = "Axis X, deviations in um\nTarget [mm];" + headers("{r}{w}", "↑", "↓") + ";B"
    reversal = np.full(TARGETS.size, 4.0)
    holds_the_truth(imported(tmp_path, written(tmp_path, wide(header, [*PAIRS, reversal]))))


def block(title: str, side: float, runs: tuple[int, ...], header: str) -> str:
    columns = [deviation(r, side) for r in runs]
    rows = [";".join(map(str, row)) for row in zip(TARGETS, *columns, strict=True)]
    return "\n".join([title, header, *rows, "", ""])


@pytest.mark.parametrize("titles", [("Vorwärts", "Rückwärts"), ("Direction: +", "Direction: -"), ("up", "down")])
@pytest.mark.parametrize("header", ["X [mm];Run 1 [um];Run 2 [um];Run 3 [um]", "X [mm];1 [um];2 [um];3 [um]"])
def test_a_block_of_runs_for_each_side(tmp_path: Path, titles: tuple[str, str], header: str) -> None:
    text = "".join(block(title, side, RUNS, header) for title, side in zip(titles, SIDES, strict=True))
    holds_the_truth(imported(tmp_path, written(tmp_path, text)))


def test_a_block_for_each_run_and_side(tmp_path: Path) -> None:
    sides = (("Forward", 1.0), ("Reverse", -1.0))
    text = "".join(block(title, side, (r,), "X [mm];Dev [um]") for r in RUNS for title, side in sides)
    holds_the_truth(imported(tmp_path, written(tmp_path, text)))


@pytest.mark.parametrize("header", ["Soll [mm];Lauf 1 [um];Lauf 2 [um];Lauf 3 [um]", "Soll [mm];Abw [um]"])
def test_a_block_for_each_axis_is_asked_about(tmp_path: Path, header: str) -> None:
    """Two axes below one another would be two runs of one."""
    runs = RUNS[: header.count(";")]
    file = written(tmp_path, block("Achse X", 1.0, runs, header) + block("Achse Y", -1.0, runs, header))
    with pytest.raises(DataError, match=r"rows of several axes \(X, Y\): select one with --axis"):
        imported(tmp_path, file)
    for axis, side in (("X", 1.0), ("Y", -1.0)):
        found = imported(tmp_path, file, axis=axis)
        (error,) = found.names("error", component=f"E{axis}{axis}")
        truth = np.concatenate([deviation(r, side) for r in runs])
        np.testing.assert_allclose(found.array(error), truth)


@pytest.mark.parametrize("form", ["{:02d}.04.2024", "2024-04-{:02d}", "2024-{:02d}-30T00:00:00"])
def test_runs_that_are_called_by_their_days(tmp_path: Path, form: str) -> None:
    header = "Achse X, Abweichung in um\nSoll [mm];" + ";".join(form.format(r) for r in RUNS)
    found = imported(tmp_path, written(tmp_path, wide(header, [deviation(r, 1.0) for r in RUNS])))
    assert [*found.run_labels()] == [form.format(r) for r in RUNS]
    np.testing.assert_allclose(found.array(found.names("error")[0]), np.concatenate([deviation(r, 1.0) for r in RUNS]))


def of_one_run(tmp_path: Path, run: int, header: str, line: Callable[[float, float], str]) -> Path:
    rows = [line(x, d) for s in SIDES for x, d in [*zip(TARGETS, deviation(run, s), strict=True)][:: int(s)]]
    (tmp_path / f"{run}.csv").write_text("\n".join([header, *rows]), encoding="utf-8")
    return tmp_path / f"{run}.csv"


def test_files_in_several_units_become_one(tmp_path: Path) -> None:
    """A file in mm beside one in um was read as um."""
    first = of_one_run(tmp_path, 1, "X [mm];Abw [um]", lambda x, d: f"{x};{d}")
    in_mm = of_one_run(tmp_path, 2, "X [mm];Abw [mm]", lambda x, d: f"{x};{d / 1000:.6f}")
    in_m = of_one_run(tmp_path, 3, "X [m];Abw [um]", lambda x, d: f"{x / 1000};{d}")
    holds_the_truth(imported(tmp_path, [first, in_mm, in_m]))
    unsaid = of_one_run(tmp_path, 2, "X [mm];Abw", lambda x, d: f"{x};{d / 1000:.6f}")
    with pytest.raises(DataError, match="no unit is stated for 'Abw'"):
        imported(tmp_path, [first, unsaid])


def test_files_of_several_axes_are_no_runs_of_one(tmp_path: Path) -> None:
    files = [
        of_one_run(tmp_path, r, f"Axis: {axis}\nPos [mm];Abw [um]", lambda x, d: f"{x};{d}")
        for r, axis in ((1, "X"), (2, "Y"))
    ]
    with pytest.raises(DataError, match="axis of 'Pos' is Y, in 1 X: import them separately"):
        imported(tmp_path, files)


def test_a_header_that_is_repeated_without_titles(tmp_path: Path) -> None:
    header, *rows = long("X [mm];Dev [um]", lambda r, x, s, d: f"{x};{d}").splitlines()
    third = 2 * TARGETS.size  # rows of a run
    parts = ["\n".join([header, *rows[i : i + third]]) for i in range(0, len(rows), third)]
    holds_the_truth(imported(tmp_path, written(tmp_path, "\n".join(parts))))


@pytest.mark.parametrize(("there", "back"), [("forward", "reverse"), ("hin", "her"), ("vor", "zurück")])
def test_the_way_there_of_an_axis_that_goes_down(tmp_path: Path, there: str, back: str) -> None:
    """`forward` from 0 to -600: approached from above."""
    lines, sides, truth = ["Run;Direction;Z [mm];Dev [um]"], [], []
    for r, side in ((r, side) for r in RUNS for side in (-1.0, 1.0)):
        for x, d in [*zip(TARGETS - 600, deviation(r, side), strict=True)][:: int(side)]:
            lines.append(f"{r};{there if side < 0 else back};{x};{d}")
            sides.append(side)
            truth.append(d)
    found = imported(tmp_path, written(tmp_path, "\n".join(lines)))
    np.testing.assert_array_equal(found.array(found.names("direction")[0]), sides)
    np.testing.assert_allclose(found.array(found.names("error")[0]), truth)


def test_a_difference_with_both_positions(tmp_path: Path) -> None:
    assert kind_by_name("Soll-Ist [mm]") == "error"
    header = "Lauf;Soll X [mm];Ist X [mm];Soll-Ist [mm]"
    text = long(header, lambda r, x, s, d: f"{r};{x};{x + d / 1000:.6f};{-d / 1000:.6f}")
    holds_the_truth(imported(tmp_path, written(tmp_path, text)))


@pytest.mark.parametrize(("unit", "factor"), [("um/m", 1.0), ("µm/m", 1.0), ("mm/m", 1e3)])
@pytest.mark.parametrize("header", ["Pitch", "EBX", "Level"])
def test_a_level_says_micrometres_per_metre(tmp_path: Path, header: str, unit: str, factor: float) -> None:
    text = long(f"Run;Dir;X [mm];{header} [{unit}]", lambda r, x, s, d: f"{r};{mark(s)};{x};{d / factor:.6f}")
    component = {"component": "EBX"} if header == "Level" else {}
    found = imported(tmp_path, written(tmp_path, text), **component)
    (name,) = found.names("error", component="EBX")
    np.testing.assert_allclose(found.array(name), [d for *_, d in long_rows()], atol=1e-3)


ASKED = {
    "a level": (long("X [mm];Level [um/m]", lambda r, x, s, d: f"{x};{d}"), "--component"),
    "an error per length": (long("X [mm];Error [um/m]", lambda r, x, s, d: f"{x};{d}"), "per length"),
    "a diagonal": (long("X;Y;Z;Deviation [um]", lambda r, x, s, d: f"{x};{x};{x};{d}"), "X, Y, Z move"),
    "an ordinate": (long("X [mm];Y [um]", lambda r, x, s, d: f"{x};{d}"), "names Y, but 'X' has positions of X"),
    "a circle": ("Angle [deg];Radial deviation [um]\n0;1.5\n90;2.5\n180;1.5\n270;2.5\n", "angles of a circle"),
    "formulas": (long("Run;X [mm];Error [um]", lambda r, x, s, d: f"{r};{x};"), "columns without a value: 'Error'"),
}


@pytest.mark.parametrize("name", ASKED)
def test_what_is_no_positioning_is_asked_about(tmp_path: Path, name: str) -> None:
    text, words = ASKED[name]
    with pytest.raises(DataError, match=words):
        imported(tmp_path, written(tmp_path, text))


def test_deviations_of_a_radius_are_no_positioning_of_x(tmp_path: Path) -> None:
    turn = np.radians(np.arange(0, 360, 10))
    rows = [f"{150 * np.cos(a):.4f};{150 * np.sin(a):.4f};{5 * np.cos(2 * a):.3f}" for a in turn]
    found = imported(tmp_path, written(tmp_path, "\n".join(["X [mm];Y [mm];dR [um]", *rows, ""])))
    assert found.names("error", component="E_R")


def one_row(text: str, row: int, change: Callable[[list[str]], list[str]]) -> str:
    """A text with the cells of one line changed."""
    lines = text.split("\n")
    lines[row] = ";".join(change(lines[row].split(";")))
    return "\n".join(lines)


ACROSS = "\n".join(
    [
        "Axis X;Deviations in um",
        ";".join(["Target [mm]", *map(str, TARGETS)]),
        *(";".join([f"Run {r} {w}", *map(str, deviation(r, s))]) for r in RUNS for s, w in ((1, "up"), (-1, "down"))),
    ]
)
MATRICES = {
    "targets down": "Axis X, deviations in um\n" + wide("Target [mm];" + headers("{r}{w}", "↑", "↓")),
    "targets across": ACROSS,
}


@pytest.mark.parametrize("name", MATRICES)
@pytest.mark.parametrize("gone", [0, 2])
def test_a_row_that_lacks_a_cell_is_asked_about(tmp_path: Path, name: str, gone: int) -> None:
    """Its readings would move to the target, or to the run, beside theirs."""
    holds_the_truth(imported(tmp_path, written(tmp_path, MATRICES[name])))
    short = one_row(MATRICES[name], 5, lambda cells: cells[:gone] + cells[gone + 1 :])
    with pytest.raises(DataError, match=r"f.csv:6  \d+ cells, \d+ in the rows around it: which one is missing"):
        imported(tmp_path, written(tmp_path, short))


def test_a_target_that_is_missing_is_asked_about(tmp_path: Path) -> None:
    """Its readings would go to the target before it."""
    empty = one_row(ACROSS, 1, lambda cells: [*cells[:4], "", *cells[5:]])
    with pytest.raises(DataError, match="column 5: readings without a target"):
        imported(tmp_path, written(tmp_path, empty))


def test_one_row_with_another_decimal_mark(tmp_path: Path) -> None:
    """It was the end of the table, or what stands across was no row of targets."""
    marked = one_row(ACROSS, 1, lambda cells: [c.replace(".", ",") for c in cells])
    holds_the_truth(imported(tmp_path, written(tmp_path, marked)))
    file = written(tmp_path, long("X [mm];Dev [um]", lambda r, x, s, d: f"{x:.1f};{d}"))
    file.write_text(one_row(file.read_text(), 30, lambda cells: [c.replace(".", ",") for c in cells]))
    holds_the_truth(imported(tmp_path, file))


LONG = long("Run;Dir;X [mm];Dev [um]", lambda r, x, s, d: f"{r};{mark(s)};{x};{d}")
IN_VAIN = {
    "a column that is not there": ({"sets": ["Deviaton.unit=mm"]}, "no such column"),
    "a sheet of a text": ({"reader": ReaderOptions("X")}, "--sheet would be ignored"),
    "another unit than the file's": ({"unit": "mm"}, "is in um, but --unit states mm"),
    "another axis than the file's": ({"axis": "Y"}, "--axis Y: column 'X' names the axis X.*--set 'X.axis=Y'"),
}


@pytest.mark.parametrize("name", IN_VAIN)
def test_what_a_person_says_is_used_or_refused(tmp_path: Path, name: str) -> None:
    said, words = IN_VAIN[name]
    with pytest.raises(ErrpipeError, match=words):
        imported(tmp_path, written(tmp_path, LONG), **said)
    assert not (tmp_path / "rec").exists()


def test_a_person_corrects_unit_and_axis_of_a_file(tmp_path: Path) -> None:
    found = imported(tmp_path, written(tmp_path, LONG), sets=["X.axis=Y", "Dev.unit=mm"])
    (error,) = found.names("error", component="EYY")
    assert found.name("position", axis="Y") == "X"
    np.testing.assert_allclose(found.array(error), [1000 * d for *_, d in long_rows()])


def test_millions_say_which_mark_is_that_of_thousands(tmp_path: Path) -> None:
    """Positions in um beside deviations in whole nm: 50,000 alone may be 50."""
    row = lambda r, x, s, d: f"{r};{mark(s)};{1000 * x + 5e5:,.0f};{1000 * d:.0f}"  # noqa: E731
    found = imported(tmp_path, written(tmp_path, long("Run;Dir;Target X [µm];Dev [nm]", row)))
    np.testing.assert_allclose(found.array("Target_X"), [x + 500 for _, x, _, _ in long_rows()])
    np.testing.assert_allclose(found.array("Dev"), [d for *_, d in long_rows()])


def test_targets_across_with_marks_of_thousands(tmp_path: Path) -> None:
    """The name of the row of targets is no column of readings, whatever its unit."""
    targets = ";".join(f"{1000 * x + 1e6:,.0f}".replace(",", ".") for x in TARGETS)
    rows = ACROSS.replace(".", ",").split("\n")[2:]
    text = "\n".join(["Axis X", "Deviations in um", f"cmd X µm;{targets}", *rows])
    found = imported(tmp_path, written(tmp_path, text))
    (error,) = found.names("error", component="EXX")
    place = found.name("position", axis="X") or ""
    assert set(found.array(place)) == {*(TARGETS + 1000)} and len(found) == 6 * TARGETS.size
    assert np.abs(found.array(error)).max() == np.abs([d for *_, d in long_rows()]).max()


@pytest.mark.parametrize("header", ["Target m", "目标位置_m", "Soll X/m", "X/m"])
@pytest.mark.parametrize("layout", ["down", "across"])
def test_metres_of_targets_are_not_taken_for_millimetres(tmp_path: Path, header: str, layout: str) -> None:
    rows = ACROSS.split("\n")
    rows[1] = ";".join([header, *(str(x / 1000) for x in TARGETS)])
    down = "Axis X\n" + long(f"Run;Dir;{header};Dev [um]", lambda r, x, s, d: f"{r};{mark(s)};{x / 1000};{d}")
    file = written(tmp_path, down if layout == "down" else "\n".join(rows))
    if header.endswith("/m"):
        holds_the_truth(imported(tmp_path, file))
        return
    with pytest.raises(DataError, match="metres, or measured"):
        imported(tmp_path, file)


def test_the_unit_of_positioning_deviations_is_not_that_of_positions(tmp_path: Path) -> None:
    text = ACROSS.replace("Deviations in um", "Positionsabweichung [nm]")
    found = imported(tmp_path, written(tmp_path, text))
    assert found.array(found.names("error")[0]).max() == pytest.approx(max(d for *_, d in long_rows()) / 1000)


def test_sides_that_are_called_plus_and_minus_one_are_no_runs(tmp_path: Path) -> None:
    rows = [f"{x};{a};{b}" for x, a, b in zip(TARGETS, deviation(1, 1.0), deviation(1, -1.0), strict=True)]
    text = "\n".join(f"Run {r}\nX [mm];+1 [um];-1 [um]\n" + "\n".join(rows) + "\n" for r in RUNS)
    assert [*imported(tmp_path, written(tmp_path, text)).run_labels()] == ["Run 1", "Run 2", "Run 3"]


@pytest.mark.parametrize("form", ["{w} (um)", "{w}. [um]", "Abw. {w} [um]"])
def test_pos_with_neg_is_a_side_and_no_position(tmp_path: Path, form: str) -> None:
    header = "Soll X (mm);" + ";".join(form.format(w=w) for w in ("pos", "neg"))
    parts = []
    for r in RUNS:
        rows = [f"{x};{a};{b}" for x, a, b in zip(TARGETS, deviation(r, 1.0), deviation(r, -1.0), strict=True)]
        parts.append("\n".join([str(r), header, *rows]))
    found = imported(tmp_path, written(tmp_path, "\n".join(parts)))
    assert len(found) == 6 * TARGETS.size and found.name("direction", axis="X")
    up = found.array("direction") > 0
    truth = np.concatenate([deviation(r, 1.0) for r in RUNS])
    np.testing.assert_allclose(np.sort(found.array(found.names("error")[0])[up]), np.sort(truth))


def test_whole_thousands_with_a_zero_are_no_fractions(tmp_path: Path) -> None:
    """Nothing but `500,000` and `0` says which mark is which."""
    row = lambda r, x, s, d: f"{r};{mark(s)};{f'{1000 * x:,.0f}' if x else 0};{1000 * d:.0f}"  # noqa: E731
    found = imported(tmp_path, written(tmp_path, long("Run;Dir;Target X [µm];Dev [nm]", row)))
    holds_the_truth(found)


def of_means(*tables: tuple[str, np.ndarray]) -> str:
    """Tables of means below one another, mm, as a program of coordinate measuring machines exports them (`.pos`)."""
    parts = [
        [f"Position\t{name} Avg Error", *(f"{x:.4f}\t{e / 1000:.6f}" for x, e in zip(TARGETS, errors, strict=True))]
        for name, errors in tables
    ]
    return "\n\n".join("\n".join(lines) for lines in parts) + "\n"


UP, DOWN = deviation(1, 1.0), deviation(1, -1.0)


def test_three_tables_of_means_are_two_directions_and_their_mean(tmp_path: Path) -> None:
    tables = ("Bidirectional", (UP + DOWN) / 2), ("Forward Directional", UP), ("Reverse Directional", DOWN)
    file = written(tmp_path, of_means(*tables))
    with pytest.raises(DataError, match="may be deviations or what the control is to add"):
        prepared([file])  # a public reader of such files takes minus them
    recording = imported(tmp_path, file, sign="actual-minus-commanded")
    side = recording.array("direction")
    assert recording.array("EXX")[side > 0] == pytest.approx(UP)
    assert recording.array("EXX")[side < 0] == pytest.approx(DOWN[::-1])
    assert recording.array("Position")[side < 0] == pytest.approx(TARGETS[::-1])


def test_three_tables_of_which_the_first_is_no_mean_are_stated_all(tmp_path: Path) -> None:
    tables = ("Bidirectional", 2.0 * UP), ("Forward Directional", UP), ("Reverse Directional", DOWN)
    proposal, _ = prepared([written(tmp_path, of_means(*tables))], sign="actual-minus-commanded")
    (note,) = [n for n in proposal.notes if "excluded" in n]
    assert note.startswith("2 more tables below ('Position Forward") and "Reverse" in note and "their 26 rows" in note
