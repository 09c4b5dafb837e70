"""One known test in layouts, words, units and signs that people use: the same recording, or a refusal that says why."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows

Rows = list[tuple[str, float, float, float]]


def long_table(header: str, line: Callable[[str, float, float, float], str]) -> str:
    return "\n".join([header, *(line(*row) for row in long_rows())])


def wide_table(header: str, cell: Callable[[float, float], float], order: tuple[float, ...] = (1.0, -1.0)) -> str:
    """A row per target. cell: what stands there, from target and deviation."""
    lines = [header]
    for i, x in enumerate(TARGETS):
        cells = [cell(x, deviation(r, s)[i]) for r in (1, 2, 3) for s in order]
        lines.append(";".join([f"{x:.1f}", *(f"{c:.7g}" for c in cells)]))
    return "\n".join(lines)


def both(form: str) -> str:
    return ";".join(form.format(r=r, w=w) for r in (1, 2, 3) for w in ("+", "-"))


def per_run(words: tuple[str, str]) -> str:
    lines = ["Run;Dir;" + ";".join(f"{x:g}" for x in TARGETS)]
    for r in (1, 2, 3):
        lines += [";".join([str(r), w, *map(str, deviation(r, s))]) for w, s in zip(words, (1.0, -1.0), strict=True)]
    return "\n".join(lines)


def sided(forward: str, reverse: str) -> str:
    """A run column, and one column of readings for each direction."""
    lines = [f"run;target [mm];{forward};{reverse}"]
    for r in (1, 2, 3):
        up, down = deviation(r, 1.0), deviation(r, -1.0)
        lines += [f"{r};{x};{a};{b}" for x, a, b in zip(TARGETS, up, down, strict=True)]
    return "\n".join(lines)


def with_statistics() -> str:
    head = ["Position [mm]", *(f"Lauf {r} {w} [um]" for r in (1, 2, 3) for w in ("vor", "rück"))]
    lines = [";".join([*head, "Mittelwert vor", "Mittelwert rück", "Umkehrspanne", "s vor"])]
    for i, x in enumerate(TARGETS):
        cells = [deviation(r, s)[i] for r in (1, 2, 3) for s in (1.0, -1.0)]
        lines.append(";".join(map(str, [x, *cells, np.mean(cells[0::2]), np.mean(cells[1::2]), -4.0, 0.3])))
    return "\n".join(lines)


FILES = {
    "zurueck": wide_table("mm;" + both("{r} {w}").replace("+", "hin").replace("-", "zurueck"), lambda x, d: d),
    "up1 down1": wide_table("x;" + both("{w}{r}").replace("+", "up").replace("-", "down"), lambda x, d: d / 1000),
    "1u 1d": wide_table("x;" + both("{r}{w}").replace("+", "u").replace("-", "d"), lambda x, d: d / 1000),
    "F1 R1": wide_table("Target;" + both("{w}{r}").replace("+", "F").replace("-", "R"), lambda x, d: d),
    "V1 R1": wide_table("Soll;" + both("{w}{r}").replace("+", "V").replace("-", "R"), lambda x, d: d),
    "statistics beside the runs": with_statistics(),
    "readings of a wide table": wide_table("Nominal [mm];" + both("Run {r} {w} [mm]"), lambda x, d: x + d / 1000),
    "a row per run": per_run(("+", "-")),
    "a row per run, in words": per_run(("fwd", "rev")),
    "a column per direction": sided("fwd_um", "rev_um"),
    "a column per direction, in words": sided("forward error (um)", "reverse error (um)"),
    "from below, from above": long_table(
        "run;approach;target;error [um]", lambda r, x, s, d: f"{r};from {'below' if s > 0 else 'above'};{x};{d}"
    ),
    "a correction": long_table(
        "Run;Dir;Target;Correction [um]", lambda r, x, s, d: f"{r};{'+' if s > 0 else '-'};{x};{-d}"
    ),
    "Korrektur": long_table("Lauf;Richtung;Soll;Korrektur µm", lambda r, x, s, d: f"{r};{s:+.0f};{x};{-d}"),
    "an error that is minus the difference of its positions": long_table(
        "Run;Dir;Commanded (mm);Measured (mm);Error (um)",
        lambda r, x, s, d: f"{r};{s:+.0f};{x};{x + d / 1000:.5f};{-d}",
    ),
    "a laser that counts the other way": long_table(
        "Run;Commanded;Measured", lambda r, x, s, d: f"{r};{x};{-(x + d / 1000):.5f}"
    ),
    "tenths of a thou": long_table(
        "Run;Dir;X (in);error (tenths)", lambda r, x, s, d: f"{r};{s:+.0f};{float(x) / 25.4!r};{float(d) / 2.54!r}"
    ),
    "hundredths of a mm": long_table(
        "Run;Dir;X (mm);error (1/100 mm)", lambda r, x, s, d: f"{r};{s:+.0f};{x};{d / 10:.3f}"
    ),
    "thousands with a comma": long_table(
        "Run;Dir;X (um);error (um)", lambda r, x, s, d: f"{r};{s:+.0f};{x * 1000:,.1f};{d}"
    ),
    "rows of two axes": long_table("axis;Run;Dir;pos;error_um", lambda r, x, s, d: f"X;{r};{s:+.0f};{x};{d}")
    + "\n"
    + "\n".join(f"Y;{r};{s:+.0f};{x};{-3 * d}" for r, x, s, d in long_rows()),
    "no header, and names": long_table("", lambda r, x, s, d: f"{x} {d}").lstrip(),
}


@pytest.mark.parametrize("name", FILES)
def test_a_third_party_file(tmp_path: Path, name: str) -> None:
    (tmp_path / "f.csv").write_text(FILES[name], encoding="utf-8")
    from errpipe.importing.sheet import ReaderOptions

    reader = ReaderOptions(names=("target", "error") if "names" in name else ())
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv", reader, axis="X" if "two axes" in name else None))


REFUSED = {
    "rows of several axes": (FILES["rows of two axes"], r"several axes \(X, Y\): select one with --axis"),
    "sides that no header says": (
        FILES["1u 1d"].replace("u;", "a;").replace("d\n", "b\n").replace("d;", "b;"),
        "both of one run, but neither states from which side",
    ),
    "no header": (FILES["no header, and names"], "give them with --names"),
    "a straightness across nothing": (
        long_table("x [mm];straightness [um]", lambda r, x, s, d: f"{x};{d}"),
        "straightness in which direction",
    ),
    "a pitch of a vertical axis": (
        long_table("Z [mm];pitch [urad]", lambda r, x, s, d: f"{x};{d}"),
        "about which axis",
    ),
    "readings no machine can make": (
        long_table("x [mm];error [mm]", lambda r, x, s, d: f"{x};{2000 + d}"),
        "nothing was written",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_guessed_is_asked(tmp_path: Path, name: str) -> None:
    text, says = REFUSED[name]
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=says):
        imported(tmp_path, tmp_path / "f.csv")
    assert not (tmp_path / "rec").exists()


@pytest.mark.parametrize(
    ("header", "component"),
    [("straightness Y [um]", "EYX"), ("Geradheit Z [µm]", "EZX"), ("Yaw [arcsec]", "ECX"), ("Nicken [urad]", "EBX")],
)
def test_other_components_by_their_usual_names(tmp_path: Path, header: str, component: str) -> None:
    (tmp_path / "f.csv").write_text(long_table(f"X [mm];{header}", lambda r, x, s, d: f"{x};{d}"), encoding="utf-8")
    assert imported(tmp_path, tmp_path / "f.csv").components() == (component,)


def test_a_number_that_says_no_reading_is_an_empty_cell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """SCPI instruments write 9.91e37 where they have no reading."""
    rows = long_table("run;target [mm];error [um]", lambda r, x, s, d: f"{r};{x};{9.91e37 if x == TARGETS[2] else d}")
    (tmp_path / "f.csv").write_text(rows, encoding="utf-8")
    assert main(["import", str(tmp_path / "f.csv"), "--out", str(tmp_path / "rec"), "--yes", "--axis", "X"]) == 0
    assert "6 values are treated as missing (the first: 9.91e+37)" in capsys.readouterr().out
    assert "e+37" not in (tmp_path / "rec" / "recording.csv").read_text()


@pytest.mark.parametrize("size", [1e-310, 1e-200, 1e29])
def test_readings_of_any_size_meet_no_division_by_zero(tmp_path: Path, size: float) -> None:
    rows = long_table(
        "target [mm];error [um];T nut [degC]", lambda r, x, s, d: f"{x * size};{d * size};{20 + x * size}"
    )
    (tmp_path / "f.csv").write_text(rows, encoding="utf-8")
    options = ["--axis", "X", "--unit", "um", "--sign", "actual-minus-commanded", "--component", "EXX"]
    assert main(["import", str(tmp_path / "f.csv"), "--out", str(tmp_path / "rec"), "--yes", *options]) in (0, 3)


def test_lost_directions_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = sorted(long_rows(), key=lambda row: row[1])
    (tmp_path / "f.csv").write_text("\n".join(["run;target;error_um", *(f"{r};{x};{d}" for r, x, _, d in rows)]))
    assert main(["import", str(tmp_path / "f.csv"), "--out", str(tmp_path / "rec"), "--yes", "--axis", "X"]) == 0
    assert "backlash cannot be distinguished from scatter" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("word", "side"),
    [
        ("+", 1),
        ("−", -1),
        ("fwd", 1),
        ("REV", -1),
        ("hin", 1),
        ("zurück", -1),
        ("from above", -1),
        ("Vor.", 1),
        ("aus", None),
    ],
)
def test_words_of_a_direction(word: str, side: float | None) -> None:
    assert guessing.side(word) == side


def test_numbers_of_targets_are_no_positions(tmp_path: Path) -> None:
    number = {x: n for n, x in enumerate(TARGETS, start=1)}
    file = tmp_path / "laser.txt"
    file.write_text(long_table("Run;Target;Nominal;Error (um)", lambda r, x, s, e: f"{r};{number[x]};{x:.3f};{e:.4f}"))
    recording = imported(tmp_path, file)
    assert recording.manifest.columns["Target"].role == "ignore"
    assert recording.name("position", axis="X") == "Nominal"
    holds_the_truth(recording)


def test_japanese_signs_and_french_runs(tmp_path: Path) -> None:
    header, signs = "Passage;方向;指令位置(mm);誤差(μm)", {1.0: "正", -1.0: "負"}
    file = tmp_path / "jp.csv"
    file.write_text(long_table(header, lambda r, x, s, e: f"{r};{signs[s]};{x};{e:.7g}"), encoding="utf-8")
    recording = imported(tmp_path, file)
    roles = [column.role for column in recording.manifest.columns.values()]
    assert sorted(roles) == ["direction", "error", "position", "run"]
    holds_the_truth(recording)
