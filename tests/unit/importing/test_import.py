"""Files of many dialects hold one known test: whatever the file, the recording is the same, sign and all."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.errors import DataError, ErrpipeError, UsageError
from errpipe.importing.sheet import ReaderOptions
from errpipe.verbs import import_files
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows, number

WORDS = {"sign": ("+", "-"), "english": ("up", "down"), "german": ("auf", "ab"), "number": ("1", "-1")}


@pytest.mark.parametrize(
    ("separator", "mark", "encoding", "words"),
    [
        *itertools.product((";", "\t", "|"), (",", "."), ("utf-8", "utf-16", "cp1252"), ("sign", "german")),
        (",", ".", "utf-8-sig", "english"),
        (",", ".", "utf-8", "number"),
    ],
)
def test_a_long_table_in_any_dialect(tmp_path: Path, separator: str, mark: str, encoding: str, words: str) -> None:
    lines = ["Messprotokoll Größe 5", "Maschine: VMC 3", "Prüfer: A. Müller", ""]
    lines.append(separator.join(["Lauf", "Soll [mm]", "Richtung", "Abw. Ist-Soll [µm]"]))
    for run, x, s, d in long_rows():
        lines.append(separator.join([run, number(x, mark), WORDS[words][s < 0], number(d, mark)]))
    lines.append(separator.join(["", "Mittel", "", number(3.2, mark)]))
    file = tmp_path / "test.csv"
    file.write_bytes("\r\n".join(lines).encode(encoding, errors="replace"))
    recording = imported(tmp_path, file)
    holds_the_truth(recording)
    assert recording.manifest.machine == "VMC 3"
    assert recording.manifest.constants["operator"].value.endswith("ller")


HEADERS = {
    "lauf auf ab": [f"Lauf {r} {w} [µm]" for r in (1, 2, 3) for w in ("auf", "ab")],
    "run up down": [f"Run {r} {w} (um)" for r in (1, 2, 3) for w in ("up", "down")],
    "1+ 1-": [f"{r}{w}" for r in (1, 2, 3) for w in ("+", "-")],
    "arrows": [f"#{r} {w} µm" for r in (1, 2, 3) for w in ("↑", "↓")],
}


@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS)
@pytest.mark.parametrize("mark", [",", "."])
def test_a_wide_table(tmp_path: Path, header: list[str], mark: str) -> None:
    file = tmp_path / "wide.csv"
    file.write_text("\n".join(wide_lines(["Soll [mm]", *header], mark)), encoding="utf-8")
    holds_the_truth(imported(tmp_path, file))


def wide_lines(header: list[str], mark: str, scale: float = 1.0) -> list[str]:
    lines = ["X-Achse;;;;;;", ";".join(header)]
    for i, x in enumerate(TARGETS):
        cells = [deviation(r, s)[i] * scale for r in (1, 2, 3) for s in (1.0, -1.0)]
        lines.append(";".join([number(x, mark, 1), *(number(c, mark, 5) for c in cells)]))
    return lines


def test_groups_above_the_names_and_a_unit_row(tmp_path: Path) -> None:
    lines = wide_lines(["", "Run 1", "", "Run 2", "", "Run 3", ""], ".")
    lines[2:2] = ["Target;up;down;up;down;up;down", "mm;µm;µm;µm;µm;µm;µm"]
    file = tmp_path / "grouped.csv"
    file.write_text("\n".join(lines), encoding="utf-8")
    holds_the_truth(imported(tmp_path, file))


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1e-3), ("in", 1e-3 / 25.4), ("thou", 1 / 25.4), ("µm", 1.0)])
def test_readings_in_other_units(tmp_path: Path, unit: str, scale: float) -> None:
    header = ["Target [mm]", *(f"Run {r} {w} [{unit}]" for r in (1, 2, 3) for w in ("up", "down"))]
    lines = wide_lines(header, ".")[:2]
    for i, x in enumerate(TARGETS):
        cells = [deviation(r, s)[i] * scale for r in (1, 2, 3) for s in (1.0, -1.0)]
        lines.append(";".join([str(x), *map(repr, map(float, cells))]))
    (tmp_path / "w.csv").write_text("\n".join(lines), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "w.csv"))


@pytest.mark.parametrize(
    "words",
    [
        "Abw. (Soll-Ist) [um]",
        "nominal minus actual [um]",
        "target - measured [um]",
        "set point value less actual value [um]",
    ],
)
def test_a_file_that_says_commanded_minus_actual_is_turned(tmp_path: Path, words: str) -> None:
    lines = [f"Run;Target [mm];Dir;{words}"] + [f"{r};{x};{s:+.0f};{-d}" for r, x, s, d in long_rows()]
    (tmp_path / "s.csv").write_text("\n".join(lines), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "s.csv")
    holds_the_truth(recording)
    text = (tmp_path / "rec" / "recording.yaml").read_text(encoding="utf-8")
    assert "factor: -1.0" in text and "the sign is changed" in text


def test_a_person_says_the_sign(tmp_path: Path) -> None:
    lines = ["Run;Target [mm];Dir;Deviation [um]"] + [f"{r};{x};{s:+.0f};{-d}" for r, x, s, d in long_rows()]
    (tmp_path / "s.csv").write_text("\n".join(lines), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "s.csv", sign="commanded-minus-actual"))


@pytest.mark.parametrize(
    "header", ["commanded;dial reading", "Soll [mm];Ist [mm]", "target_mm;measured_mm", "x_cmd;x_fb"]
)
def test_absolute_readings_are_subtracted_not_exported(tmp_path: Path, header: str) -> None:
    lines = [header] + [f"{x:.3f};{x + d / 1000:.4f}" for _, x, _, d in long_rows()]
    (tmp_path / "dial.csv").write_text("\n".join(lines), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "dial.csv"))


def test_readings_called_errors_are_seen_to_be_readings(tmp_path: Path) -> None:
    lines = ["X;error"] + [f"{x:.3f};{x + d / 1000:.4f}" for _, x, _, d in long_rows()]
    (tmp_path / "dial.csv").write_text("\n".join(lines), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "dial.csv")
    holds_the_truth(recording)
    assert "absolute readings" in (tmp_path / "rec" / "recording.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "stamp", ["12.03.2026 08:{m:02d}:{s:02d}", "2026-03-12T08:{m:02d}:{s:02d}", "08:{m:02d}:{s:02d}"]
)
def test_dates_become_seconds(tmp_path: Path, stamp: str) -> None:
    rows = [stamp.format(m=i // 60, s=i % 60) + f";{r};{x};{s:+.0f};{d}" for i, (r, x, s, d) in enumerate(long_rows())]
    lines = ["Zeit;Lauf;Soll [mm];Richtung;Abw. [um]", *rows]
    (tmp_path / "t.csv").write_text("\n".join(lines), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "t.csv")
    assert recording.time().tolist() == list(range(78))
    holds_the_truth(recording)


# ---------------------------------------------------------------- nothing is written unasked


def test_nothing_is_written_before_someone_says_yes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "w.csv").write_text("\n".join(wide_lines(["Soll [mm]", *HEADERS["1+ 1-"]], ".")))
    line = ["import", str(tmp_path / "w.csv"), "--out", str(tmp_path / "rec")]
    assert main(line) == 2
    heard = capsys.readouterr()
    assert "guess: " in heard.err and "nothing was written" in heard.err and not (tmp_path / "rec").exists()
    assert main([*line, "--yes"]) == 0
    assert "guess, confirmed" in (tmp_path / "rec" / "recording.yaml").read_text(encoding="utf-8")
    assert main(["check", str(tmp_path / "rec")]) == 0


@pytest.mark.parametrize(
    ("name", "data", "code"),
    [
        ("a.csv", b"", 3),
        ("a.csv", b"\n\n\n", 3),
        ("a.csv", b"hello world\n", 3),
        ("a.csv", b"a,b,c\n", 3),
        ("a.csv", b"a;b\n1;x\n2;y\n", 3),
        ("a.csv", b"\x00\x01\x02" * 50, 3),
        ("a.csv", b"\xff\xfe\x00", 3),
        ("a.csv", b"x" * 100_000, 3),
        ("a.csv", b"x [mm],err [um]\n" + b"nan,inf\n" * 20, 3),
        ("a.csv", b'x [mm],err [um]\n"1,2\n' * 5, 3),
        ("a.csv", b"x [mm];T [degC]\n" + b"1;2\n2;3\n3;4\n", 3),
        ("a.xlsx", b"PK\x03\x04broken", 3),
        ("a.xls", b"\xd0\xcf\x11\xe0" + b"0" * 600, 3),
        ("a.tdms", b"TDSm" + b"\xff" * 100, 3),
        ("a.h5", b"\x89HDF\r\n\x1a\n" + b"\0" * 200, 3),
        ("a.mat", b"MATLAB 5.0 MAT-file" + b"\0" * 300, 3),
        ("a.mat", b"MATLAB 7.3 MAT-file" + b"\0" * 300, 3),
        ("a.xml", b"<MTConnectStreams><a></MTConnectStreams>", 3),
        ("a.xml", b"<MTConnectStreams></MTConnectStreams>", 3),
        ("a.log", b"1 2 3\n" * 10 + b"1 2\n", 3),
    ],
)
def test_a_hostile_file_is_refused_in_a_sentence(
    tmp_path: Path, name: str, data: bytes, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_bytes(data)
    assert main(["import", str(tmp_path / name), "--out", str(tmp_path / "rec"), "--yes"]) == code
    heard = capsys.readouterr()
    assert name in heard.err and "internal error" not in heard.err
    assert not (tmp_path / "rec").exists()


@pytest.mark.parametrize("count", [20, pytest.param(60, marks=pytest.mark.slow)])
def test_damaged_files_never_raise_anything_else(tmp_path: Path, count: int) -> None:
    """Whole files cut and garbled at random: every outcome is a recording or an ErrpipeError."""
    from scipy.io import savemat

    (tmp_path / "w.csv").write_text("\n".join(wide_lines(["Soll [mm]", *HEADERS["1+ 1-"]], ",")), encoding="utf-16")
    savemat(tmp_path / "w.mat", {"x_target": TARGETS, "error_um": deviation(1, 1.0)})
    rng = np.random.default_rng(7)
    for seed in ("w.csv", "w.mat"):
        whole = (tmp_path / seed).read_bytes()
        for _ in range(count):
            data = bytearray(whole[: rng.integers(1, len(whole) + 1)])
            for place in rng.integers(0, len(data), 8):
                data[place] = rng.integers(0, 256)
            file = tmp_path / f"damaged{Path(seed).suffix}"
            file.write_bytes(bytes(data))
            try:
                import_files.prepare([file], ReaderOptions(), import_files.options_of(sets=[]))
            except ErrpipeError:
                continue


FORMATS = Path(__file__).parents[2] / "data" / "formats"


def test_the_axis_of_a_vendor_file_is_the_stated_one(tmp_path: Path) -> None:
    """A file that names no axis was imported as X whatever --axis stated."""
    assert imported(tmp_path, FORMATS / "ecmc_dat.dat", axis="Y").components() == ("EYY",)
    proposal, _ = import_files.prepare([FORMATS / "ecmc_dat.dat"], ReaderOptions(), import_files.options_of(sets=[]))
    assert any("names no axis: taken as X" in note for note in proposal.notes)


@pytest.mark.parametrize(
    "said", [{"sign": "commanded-minus-actual"}, {"unit": "mm"}, {"component": "EYX"}, {"sets": ["EXX.unit=mm"]}]
)
def test_an_option_for_what_a_vendor_file_states_itself_is_refused(tmp_path: Path, said: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="would be ignored"):
        imported(tmp_path, FORMATS / "renishaw_rtl.rtl", **said)


def test_a_remark_above_that_says_commanded_minus_measured_turns_the_sign(tmp_path: Path) -> None:
    lines = ["Axis X", "# error = commanded position minus measured position", "Run;Target [mm];Dir;Error [um]"]
    lines += [f"{r};{x};{s:+g};{-d}" for r, x, s, d in long_rows()]
    (tmp_path / "s.csv").write_text("\n".join(lines))
    holds_the_truth(imported(tmp_path, tmp_path / "s.csv"))


@pytest.mark.parametrize("falling", [False, True])
def test_the_way_back_in_a_table_below_belongs_to_the_test(tmp_path: Path, falling: bool) -> None:
    """It was left out, and with it the lost motion."""
    lines = ["Axis: X"]
    for side, word in ((1.0, "Forward"), (-1.0, "Reverse")):
        lines.append(",".join(["Target (mm)", *(f"{word} {run} (um)" for run in range(1, 4))]))
        order = range(12, -1, -1) if falling and side < 0 else range(13)
        lines += [",".join([f"{TARGETS[i]}", *(f"{deviation(run, side)[i]}" for run in range(1, 4))]) for i in order]
        lines.append("")
    file = tmp_path / "blocks.csv"
    file.write_text("\n".join(lines))
    recording = imported(tmp_path, file)
    holds_the_truth(recording)
    assert len(recording.frame) == 2 * 3 * 13


@pytest.mark.parametrize(
    ("above", "header", "axis"),
    [
        ("Axis: C2", "Target (deg),Dir,Error (arcsec)", "C2"),
        ("", 'Winkel C (°),Dir,Abweichung (")', "C"),
        ("C轴", "目标位置(°),方向,偏差(arcsec)", "C"),
        ("", "X2 target (mm),dir,X2 error (um)", "X2"),
        ("Asse Z1", "Target (mm),dir,error (um)", "Z"),
    ],
)
def test_an_axis_with_a_number_and_angles_in_seconds(tmp_path: Path, above: str, header: str, axis: str) -> None:
    """X2 was imported as X; a quotation mark behind angles was taken for inches."""
    rows = [f"{x},{side},{d}" for x, side, d in ((0, "+", 1.5), (90, "+", 2.5), (180, "+", -3.5), (270, "+", 4.25))]
    file = tmp_path / "angles.csv"
    file.write_text("\n".join([above, header, *rows, *(row.replace("+", "-") for row in reversed(rows))]))
    recording = imported(tmp_path, file)
    (component,) = recording.components()
    assert component == f"E{axis[0]}{axis}"
    expected = np.array([1.5, 2.5, -3.5, 4.25]) * (np.pi / 648000e-6 if axis[0] == "C" else 1.0)
    (error,) = recording.names("error")
    np.testing.assert_allclose(recording.array(error)[:4], expected, rtol=1e-9)
    assert recording.manifest.columns[recording.names("position")[0]].axis == axis


def test_angles_without_a_unit_are_not_taken_as_urad(tmp_path: Path) -> None:
    file = tmp_path / "angles.csv"
    file.write_text("Axis C\nTarget (deg),Error\n" + "".join(f"{x},{x / 40:.2f}\n" for x in range(0, 361, 30)))
    with pytest.raises(DataError, match=r"no unit is stated for the angles of ECC: declare it with --unit \(arcsec"):
        imported(tmp_path, file)
    assert imported(tmp_path, file, unit="arcsec").components() == ("ECC",)


def table_of(tmp_path: Path, above: str, header: str) -> Path:
    file = tmp_path / "other.csv"
    file.write_text("\n".join([above, header, *(f"{r},{x},{d}" for r, x, _, d in long_rows())]))
    return file


def test_a_diameter_along_z_is_no_positioning_of_z(tmp_path: Path) -> None:
    """It became EZZ, and Z was to be moved by it."""
    file = table_of(tmp_path, "", "Run,Z position (mm),diameter deviation (um)")
    assert imported(tmp_path, file).components() == ("E_D",)


@pytest.mark.parametrize(
    ("above", "header"),
    [
        ("Test: Geradheit Y, Achse X", "Run,Target (mm),Deviation (um)"),
        ("Straightness in the vertical plane", "Run,X (mm),Deviation (um)"),
        ("", "Run,X (mm),flatness deviation (um)"),
        ("", "Run,X (mm),Rundlauf Abw. (um)"),
    ],
)
def test_another_quantity_is_not_taken_for_positioning(tmp_path: Path, above: str, header: str) -> None:
    file = table_of(tmp_path, above, header)
    with pytest.raises(DataError, match="--component"):
        imported(tmp_path, file)
    assert imported(tmp_path, file, component="EYX").components() == ("EYX",)
    straight = table_of(
        tmp_path, "Squareness compensation: off\nStraightness: not measured", "Run,X (mm),Deviation (um)"
    )
    assert imported(tmp_path, straight).components() == ("EXX",)


def test_diameters_of_a_turned_part_along_z_are_no_positioning_of_z(tmp_path):
    """Nominal and measured diameter beside the place along the part; the error was EZZ, which moves Z."""
    rows = [(z, 40.0, 40.0 + z * 1e-4, z / 10) for z in (20, 60, 100, 140, 180)]
    pair, alone = tmp_path / "pair.csv", tmp_path / "alone.csv"
    pair.write_text("Z_mm,dia_nominal_mm,dia_actual_mm\n" + "".join(f"{z},{n},{a:.4f}\n" for z, n, a, _ in rows))
    alone.write_text("Z_mm,dia_dev_um\n" + "".join(f"{z},{d}\n" for z, _, _, d in rows))
    for file in (pair, alone):
        recording = imported(tmp_path / file.stem, file, sign="actual-minus-commanded" if file == alone else None)
        assert recording.components() == ("E_D",)
        (name,) = recording.names("error")
        assert recording.array(name) == pytest.approx([d for *_, d in rows], abs=1e-6)


@pytest.mark.parametrize("letter", ["J2", "E", "x"])
def test_an_axis_without_components_is_refused(tmp_path: Path, letter: str) -> None:
    """`--axis J2`, a joint of a robot, ended as an internal error: EJJ2 is no component."""
    with pytest.raises(UsageError, match=f"--axis {letter}: not an axis"):
        imported(tmp_path, table_of(tmp_path, "", "Run,Target [mm],Error [um]"), axis=letter)
