"""First contact: what a third-party file says of signs, sides, axes and units is taken, or asked about."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.errors import DataError
from errpipe.importing.controller_files import ECT
from errpipe.importing.sheet import ReaderOptions
from errpipe.verbs import import_files
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows

Row = tuple[str, float, float, float]
SEVEN = TARGETS[::2]


def mark(side: float) -> str:
    return "+" if side > 0 else "-"


def long(header: str, row: Callable[[str, float, float, float], str], above: str = "", below: str = "") -> str:
    return "\n".join([*([above] if above else []), header, *(row(*r) for r in long_rows()), below])


def signed(sign: float = 1.0, above: str = "", below: str = "", header: str = "Run;Dir;X [mm];Error [um]") -> str:
    return long(header, lambda r, x, s, d: f"{r};{mark(s)};{x};{sign * d}", above, below)


def refused(tmp_path: Path, text: str | bytes, match: str, name: str = "f.csv", **said: object) -> None:
    """A file is asked about and nothing is written."""
    (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode("utf-8"))
    with pytest.raises(DataError, match=match):
        options = import_files.options_of(sets=[], **said)
        import_files.prepare([tmp_path / name], ReaderOptions(), options)


ON_THE_SIGN = {
    "plus is short": signed(-1.0, above="+ = axis stops short of target"),
    "German, above": signed(-1.0, above="positiv = Achse fährt zu kurz"),
    "German, below": signed(-1.0, below="Hinweis: Pluswerte bedeuten Weg zu klein"),
    "a footnote": signed(-1.0, below="* sign: + means correction must be added"),
    "French": signed(-1.0, above="Remarque: + signifie trop court"),
}


@pytest.mark.parametrize("name", ON_THE_SIGN)
def test_a_line_that_says_which_way_readings_count_is_asked_about(tmp_path: Path, name: str) -> None:
    """Each of them was imported as actual minus commanded: the machine would have been driven the wrong way."""
    refused(tmp_path, ON_THE_SIGN[name], "--sign")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv", sign="commanded-minus-actual"))


TITLES = ["Sign reversed for controller input", "ready to enter (sign already changed)", "Inverse error values"]
TITLES += [
    "Error multiplied by -1",
    "Values are corrections to be added",
    "These are compensation values",
    "E = Tp - Rp",
]


@pytest.mark.parametrize("line", TITLES)
def test_a_title_on_the_sign_is_asked_about(tmp_path: Path, line: str) -> None:
    refused(tmp_path, signed(-1.0, above=line), "--sign")
    refused(tmp_path, signed(-1.0, below=line), "--sign")


HEADERS = ["Abweichung (Soll zu Ist) [µm]", "Abw. Ist/Soll [µm]", "Error x(-1) [um]", "Error N-M [um]"]


@pytest.mark.parametrize("header", HEADERS)
def test_a_header_that_may_say_either_sign_is_asked_about(tmp_path: Path, header: str) -> None:
    refused(tmp_path, signed(-1.0, header=f"Run;Dir;X [mm];{header}"), "--sign")


def test_a_line_with_the_letters_of_the_axis_is_understood(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(signed(-1.0, above="E = Xnom - Xact"), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


def test_a_pitch_error_in_um_is_that_of_a_screw(tmp_path: Path) -> None:
    (tmp_path / "f.csv").write_text(signed(header="Run;Dir;X [mm];Pitch error [um]"), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


@pytest.mark.parametrize(
    "line",
    [
        "+ = approached from below",
        "Directions: + up, - down",
        "Temperature +20 = reference",
        "Error: X-axis, bi-directional",
        "Sign-off: Maier",
    ],
)
def test_a_line_with_a_plus_that_is_no_sign_of_readings(tmp_path: Path, line: str) -> None:
    (tmp_path / "f.csv").write_text(signed(above=line), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


DOUBTS = {
    "diameters by a line": (signed(above="Lathe X axis, diameter programming"), "diameters"),
    "diameters by a header": (signed(header="Run;Dir;X (dia) [mm];Error [um]"), "diameters"),
    "signs in a column": (
        long("Run;Dir;X [mm];Error [um];L/S", lambda r, x, s, d: f"{r};{mark(s)};{x};{abs(d)};{'L' if d > 0 else 'S'}"),
        "signs of readings",
    ),
    "a column called sign": (
        long("Run;X [mm];Error [um];Sign", lambda r, x, s, d: f"{r};{x};{abs(d)};{'+' if d > 0 else '-'}"),
        "signs of readings",
    ),
    "a gauge read by the machine": (
        "Step gauge nominal [mm];X deviation [um]\n" + "\n".join(f"{x};{-x / 60}" for x in SEVEN),
        "--sign",
    ),
    "a gauge and a probe": (
        "Gauge block X [mm];Measured X [mm]\n" + "\n".join(f"{x};{x - x / 6e4:.4f}" for x in SEVEN),
        "gauge|Gauge",
    ),
    "before and after": (
        "X [mm];Error before comp [um];Error after comp [um]\n" + "\n".join(f"{x};{x / 60};{x / 600}" for x in SEVEN),
        "which one is meant",
    ),
    "numbers of points": (
        "X axis;\nNo.;Error [um]\n" + "\n".join(f"{i};{x / 60}" for i, x in enumerate(SEVEN, 1)),
        "no position of X",
    ),
    "torn decimal commas": (
        "Run,X mm,Error um\n" + "\n".join(f"1,{x:.1f},{x / 60:.1f}".replace(".", ",") for x in SEVEN),
        "decimal marks and separators",
    ),
    "no axis": (signed(header="Run;Dir;Target [mm];Error [um]"), "--axis"),
    "one row": ("X [mm];Error [um]\n500;9.5\n", "1 row with"),
    "two rows": ("X [mm];Error [um]\n0;1.5\n500;9.5\n", "2 rows with"),
    "angles as an error": ("X [mm];Error [arcsec]\n" + "\n".join(f"{x};{x / 60}" for x in SEVEN), "--component"),
    "angles as a reading": ("X [mm];Reading [arcsec]\n" + "\n".join(f"{x};{x / 60}" for x in SEVEN), "--component"),
    "two probes along X": (
        "t [s];T [°C];X1 [um];X2 [um];Z [um]\n"
        + "\n".join(f"{60 * i};{20 + i};{i};{2 * i};{3 * i}" for i in range(20)),
        "second probe",
    ),
}


@pytest.mark.parametrize("name", DOUBTS)
def test_what_a_table_cannot_do_without_is_asked_for(tmp_path: Path, name: str) -> None:
    refused(tmp_path, *DOUBTS[name])


@pytest.mark.parametrize("said", [{"axis": "X"}, {"axis": "X", "title": "a mill"}])
def test_the_axis_that_a_person_says(tmp_path: Path, said: dict[str, str]) -> None:
    (tmp_path / "f.csv").write_text(DOUBTS["no axis"][0], encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv", **said))


FROM_ABOVE = [
    "Approach from above (-)",
    "Approach direction: -",
    "unidirectional, negative approach",
    "Anfahrt von oben",
]
FROM_ABOVE += ["all targets approached from +", "Approach from the positive side", "Only reverse runs"]


@pytest.mark.parametrize("line", FROM_ABOVE)
@pytest.mark.parametrize("listed", [1, -1])
def test_a_line_on_the_approach_says_the_side(tmp_path: Path, line: str, listed: int) -> None:
    rows = [f"{r};{x};{d}" for r in (1, 2) for x, d in list(zip(TARGETS, deviation(r, -1.0), strict=True))[::listed]]
    (tmp_path / "f.csv").write_text("\n".join(["X axis", line, "Run;X [mm];Error [um]", *rows]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert (recording.array("direction") == -1.0).all()
    at = dict(zip(recording.array("X"), recording.array("Error"), strict=True))
    assert at[600.0] == pytest.approx(deviation(2, -1.0)[-1])


@pytest.mark.parametrize("line", ["all targets approached from -", "Approach from the negative side"])
def test_a_sign_from_which_targets_were_approached_is_the_other_side(tmp_path: Path, line: str) -> None:
    rows = [f"{r};{x};{d}" for r in (1, 2) for x, d in zip(TARGETS, deviation(r, 1.0), strict=True)]
    (tmp_path / "f.csv").write_text("\n".join(["X axis", line, "Run;X [mm];Error [um]", *rows]), encoding="utf-8")
    assert (imported(tmp_path, tmp_path / "f.csv").array("direction") == 1.0).all()


@pytest.mark.parametrize("line", ["Approach from below and above", "Approach speed: -1000 mm/min", "Beam direction: -"])
def test_a_line_that_says_no_side(tmp_path: Path, line: str) -> None:
    rows = [f"{r};{x};{d}" for r in (1, 2) for x, d in zip(TARGETS, deviation(r, 1.0), strict=True)]
    (tmp_path / "f.csv").write_text("\n".join(["X axis", line, "Run;X [mm];Error [um]", *rows]), encoding="utf-8")
    assert imported(tmp_path, tmp_path / "f.csv").name("direction") is None


def test_positions_that_fall_are_approached_from_above(tmp_path: Path) -> None:
    """Files that rise and files that fall, without a word: lost motion became scatter between the runs."""
    files = []
    for r in range(1, 4):
        for side, name in ((1.0, f"a{2 * r}"), (-1.0, f"a{2 * r + 1}")):
            rows = list(zip(TARGETS, deviation(r, side), strict=True))[:: int(side)]
            text = "\n".join(["Axis;X", "Target [mm];Error [um]", *(f"{x};{d}" for x, d in rows)])
            files.append(tmp_path / f"{name}.csv")
            files[-1].write_text(text, encoding="utf-8")
    recording = imported(tmp_path, files)
    up = recording.array("direction") > 0
    assert up.sum() == 39 and {*recording.frame["run"][up]} == {"a2", "a4", "a6"}
    only = imported(tmp_path / "one", files[1], title="falls")
    assert (only.array("direction") == -1.0).all()


@pytest.mark.parametrize("remark", ["# measured at 20 °C", "measured today", "; laser warm, run 1 starts here"])
def test_a_remark_between_header_and_data(tmp_path: Path, remark: str) -> None:
    (tmp_path / "f.csv").write_text(signed().replace("[um]\n", f"[um]\n{remark}\n", 1), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


def test_a_fact_above_two_columns_is_no_group_of_columns(tmp_path: Path) -> None:
    rows = [f"{x};{d}" for x, d in zip(TARGETS, deviation(1, 1.0), strict=True)]
    (tmp_path / "f.csv").write_text("\n".join(["Axis;Y", "Target [mm];Error [um]", *rows]), encoding="utf-8")
    assert [*imported(tmp_path, tmp_path / "f.csv").manifest.columns] == ["Target", "Error"]


def test_the_mean_of_each_target_is_no_run(tmp_path: Path) -> None:
    """The mean and sigma of each target stood among the readings, in long and in wide tables."""
    rows, two = ["X [mm];Run;Dir;Error [um]"], ["X [mm];Run;Error up [um];Error down [um]"]
    for i, x in enumerate(TARGETS):
        for run in ("1", "2", "3", "Mean", "Sigma"):
            up, down = (deviation(int(run) if run.isdigit() else 2, s)[i] for s in (1.0, -1.0))
            rows += [f"{x};{run};+;{up}", f"{x};{run};-;{down}"]
            two.append(f"{x};{run};{up};{down}")
    for text in (rows, two):
        (tmp_path / "f.csv").write_text("\n".join(text), encoding="utf-8")
        recording = imported(tmp_path, tmp_path / "f.csv")
        assert len(recording) == 78
        holds_the_truth(recording)


def test_a_run_called_by_its_load_is_no_figure(tmp_path: Path) -> None:
    names = {"1": "max load", "2": "no load", "3": "min load"}
    text = long("Run;Dir;X [mm];Error [um]", lambda r, x, s, d: f"{names[r]};{mark(s)};{x};{d}")
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    assert {*imported(tmp_path, tmp_path / "f.csv").frame["Run"]} == {*names.values()}


RUSSIAN = "Проход;Направление;Позиция X [мм];Погрешность [мкм]"
KOREAN = "회차;방향;목표위치 X(mm);오차(um)"
ENCODED = [(RUSSIAN, "cp1251"), (RUSSIAN, "koi8-r"), (RUSSIAN, "cp866"), (KOREAN, "cp949")]


@pytest.mark.parametrize(("header", "encoding"), ENCODED, ids=[e for _, e in ENCODED])
def test_letters_of_russia_and_korea(tmp_path: Path, header: str, encoding: str) -> None:
    (tmp_path / "f.csv").write_bytes(signed(header=header).encode(encoding))
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


@pytest.mark.parametrize(("there", "back"), [("прямой", "обратный"), ("heen", "terug"), ("fram", "tillbaka")])
def test_words_for_there_and_back(tmp_path: Path, there: str, back: str) -> None:
    rows = sorted(long_rows(), key=lambda row: (row[1], row[0]))  # not in the order of motion: the words alone say it
    lines = [f"{r};{there if s > 0 else back};{x};{d}" for r, x, s, d in rows]
    (tmp_path / "f.csv").write_text("\n".join(["Run;Dir;X [mm];Error [um]", *lines]), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


ANGLES = [
    ('"', 4.84813681),
    ("arc-sec", 4.84813681),
    ("arc seconds", 4.84813681),
    ("mdeg", 17.4532925),
    ("°", 17453.2925),
]


@pytest.mark.parametrize(("unit", "urad"), ANGLES)
def test_units_of_a_pitch(tmp_path: Path, unit: str, urad: float) -> None:
    rows = [f"{x};{x / urad:.9f}" for x in SEVEN]
    (tmp_path / "f.csv").write_text("\n".join([f"X (mm);Pitch ({unit})", *rows]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.components() == ("EBX",)
    np.testing.assert_allclose(recording.array("Pitch"), SEVEN, atol=1e-2)


CLOCKS = {
    "a logger's milliseconds": lambda s: f"05/03/2024 08:{s // 60:02d}:{s % 60:02d}:000",
    "days of a spreadsheet": lambda s: f"{45425 + s / 86400:.8f}",
}


@pytest.mark.parametrize("name", CLOCKS)
def test_dates_of_a_drift(tmp_path: Path, name: str) -> None:
    rows = [f"{CLOCKS[name](60 * i)};{20 + i};{3 * i}" for i in range(20)]
    (tmp_path / "f.csv").write_text("\n".join(["Date/Time;T spindle (C);102 <Z drift> (um)", *rows]), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.components() == ("E_Z",)
    np.testing.assert_allclose(recording.time(), 60.0 * np.arange(20), atol=1e-3)


OF_CONTROLS = {
    "X.COM": "BEGIN X.COM MM DATUM: -10 DIST: 100\n0 AXISPOS BACKLASH 1\n1 +100.000 +0.0010\n[END]\n",
    "CNC-PARA.TXT": "%\nN1851 Q1 A1 P5\nN3620 Q1 A1 P40\nN3621 Q1 A1 P10\n%\n",
    "PITCH.TXT": "%\n" + "\n".join(f"N{10000 + i} P{i - 3}" for i in range(7)) + "\n%\n",
    "xcomp.comp": "\n".join(f"{100 * i} {100 * i + 0.001 * i:.4f} {100 * i:.4f}" for i in range(7)),
    "x.comp": "#nominal fwd rev\n" + "\n".join(f"{100 * i} {0.001 * i:.4f} {0.001 * i:.4f}" for i in range(7)),
    "ScrewMapX.dat": "\n".join(f"{100 * i},{100 * i + 0.001 * i:.4f}" for i in range(7)),
    "pitch.txt": "OKUMA PITCH ERROR COMPENSATION DATA X\n" + "\n".join(f"NO{i} {100 * i} {i}" for i in range(7)),
}


@pytest.mark.parametrize("name", OF_CONTROLS)
def test_a_compensation_file_of_a_control_is_named(tmp_path: Path, name: str) -> None:
    """A `.comp` of LinuxCNC was imported as deviations: corrections are minus those."""
    refused(tmp_path, OF_CONTROLS[name], "not a measurement. Import the deviations", name)


def test_a_table_of_errpipe_is_named(tmp_path: Path) -> None:
    refused(tmp_path, ECT + bytes(80), "compensated_by", "table.ect")


KEPT = Path(__file__).parents[2] / "golden" / "targets"
OF_NO_KNOWN_FORM = ("volumetric.csv", "X_lut.dat", "PRG_Backlash.st", "backlash.gcode", "temp_comp.lis")


@pytest.mark.parametrize("file", [f for f in sorted(KEPT.glob("*/*")) if f.name not in OF_NO_KNOWN_FORM], ids=str)
def test_what_errpipe_exports_is_no_measurement(tmp_path: Path, file: Path) -> None:
    refused(tmp_path, file.read_bytes(), "not a measurement", file.name)


def test_a_folder_of_init_takes_an_imported_recording(tmp_path: Path) -> None:
    """`import --out work/recording` after `init work` asked for --overwrite; what a person changed is kept still."""
    (tmp_path / "f.csv").write_text(signed(), encoding="utf-8")
    folder = tmp_path / "work"
    assert main(["init", "--template", "laser-iso230", str(folder)]) == 0
    command = ["import", str(tmp_path / "f.csv"), "--out", str(folder / "recording"), "--yes"]
    assert main(command) == 0
    with (folder / "recording" / "recording.csv").open("a") as stream:
        stream.write("9,+,0,1\n")
    assert main(command) == 2


def test_a_line_and_a_column_that_name_two_axes(tmp_path: Path) -> None:
    refused(tmp_path, signed(above="Y axis"), "names the axis Y, a column X")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv", axis="X"))
    refused(tmp_path, signed(), "names the axis Y, a column X", "laser_Y.csv")


@pytest.mark.parametrize("names", [("before", "after"), ("X_comp_off", "X_comp_on"), ("vorher", "nachher")])
def test_files_of_two_states_are_no_runs(tmp_path: Path, names: tuple[str, str]) -> None:
    """Before and after a compensation became runs of one test, and the table half of it."""
    files = [tmp_path / f"{name}.csv" for name in names]
    for file, factor in zip(files, (1.0, 0.1), strict=True):
        file.write_text(signed(factor), encoding="utf-8")
    with pytest.raises(DataError, match="several states"):
        imported(tmp_path, files)
    renamed = [file.rename(tmp_path / f"{n}.csv") for n, file in enumerate(files)]
    assert len(imported(tmp_path, renamed)) == 156


LINES_ON = {"Pitch error compensation ON": True, "Mit Kompensation": True, "Compensation: OFF": False}
LINES_ON |= {"Laser air compensation: on": False, "Temperature compensation is on": False}


@pytest.mark.parametrize("line", LINES_ON)
def test_a_compensation_that_was_active_is_reported(tmp_path: Path, line: str) -> None:
    (tmp_path / "f.csv").write_text(signed(above=line), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))
    assert (
        "residual deviations with compensation" in (tmp_path / "rec" / "recording.yaml").read_text("utf-8")
    ) == LINES_ON[line]


def test_a_sheet_with_a_question_is_not_passed_over(tmp_path: Path) -> None:
    """The sheet of the readings asked for its axis, and that of a summary was imported instead, in silence."""
    openpyxl = pytest.importorskip("openpyxl", reason="the sample is made by openpyxl")
    book = openpyxl.Workbook()
    for sheet, place in ((book.active, "Target [mm]"), (book.create_sheet("Summary"), "X [mm]")):
        sheet.append(["Run", "Dir", place, "Error [um]"])
        for r, x, s, d in long_rows():
            sheet.append([r, mark(s), x, d])
    book.save(tmp_path / "f.xlsx")
    with pytest.raises(DataError, match=r"along which axis.*--sheet 'Summary'"):
        import_files.prepare([tmp_path / "f.xlsx"], ReaderOptions(), import_files.options_of(sets=[]))
    holds_the_truth(imported(tmp_path, tmp_path / "f.xlsx", axis="X"))
