# ruff: noqa: E501  (a table of files, one a line)
"""More third-party files, in seven languages and by independent writers: the same known test, sign and all."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.importing import words
from errpipe.importing.sheet import ReaderOptions
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows

RUNS, SIDES = (1, 2, 3), (1.0, -1.0)
PAIRS = [deviation(r, s) for r in RUNS for s in SIDES]  # run 1 up, run 1 down, run 2 up, ...
HALVES = [deviation(r, s) for s in SIDES for r in RUNS]  # up of all runs, then down


def de(value: float, digits: int = 2) -> str:
    """1.234,50"""
    return f"{value:,.{digits}f}".translate(str.maketrans(",.", ".,"))


def long(header: str, line: Callable[..., str], above: str = "", below: str = "") -> str:
    """A row per reading. line: of run, target, side and deviation."""
    return "\n".join(
        [*([above] if above else []), header, *(line(*row) for row in long_rows()), *([below] if below else [])]
    )


def wide(
    header: str, columns: Iterable[np.ndarray] = PAIRS, sign: float = 1.0, digits: int = 1, after: Iterable[str] = ()
) -> str:
    """A row per target with decimal commas."""
    rows = [";".join([de(x, digits), *(de(sign * c[i]) for c in columns)]) for i, x in enumerate(TARGETS)]
    return "\n".join([header, *rows, *after])


def headers(form: str, up: str, down: str) -> str:
    return ";".join(form.format(r=r, w=w) for r in RUNS for w in (up, down))


def across(label: Callable[[int, float], str]) -> list[str]:
    """A row per run and side, its readings at the targets."""
    return [";".join([label(r, s), *map(de, deviation(r, s))]) for r in RUNS for s in SIDES]


def blocks(sides: bool) -> str:
    lines = []
    for r in RUNS:
        if not sides:
            rows = [f"{x};{a};{b}" for x, a, b in zip(TARGETS, deviation(r, 1.0), deviation(r, -1.0), strict=True)]
            lines += [f"Run {r}", "Target [mm];Up [um];Down [um]", *rows, ""]
            continue
        for s, word in zip(SIDES, ("Forward", "Reverse"), strict=True):
            rows = [f"{x};{d}" for x, d in zip(TARGETS, deviation(r, s), strict=True)][:: int(s)]
            lines += [f"Run {r} {word}", "Target (mm);Error (um)", *rows, ""]
    return "\n".join(lines)


def mark(side: float, up: str = "+", down: str = "-") -> str:
    return up if side > 0 else down


def trace_time(run: str, x: float, side: float) -> float:
    """s: a target every 50 s."""
    return 1300 * int(run) + (x if side > 0 else 1250 - x)


MEANS = [np.mean(HALVES[:3], 0), np.mean(HALVES[3:], 0)]
TARGETS_ACROSS = ";".join(de(x, 1) for x in TARGETS)
SUMMARY = [
    *("", "Analysis to ISO 230-2", "Accuracy A;14,6;um", "Reversal B;4,0;um", "Target;Mean +;Mean -;2s +"),
    *(f"{de(x, 1)};{de(MEANS[0][i])};{de(MEANS[1][i])};0,20" for i, x in enumerate(TARGETS)),
]
FILES: dict[str, str | bytes] = {
    "groups, names, a row of units, thousands": wide(
        "Messbericht\nZielposition;Vorwärts;;;Rückwärts;;\n;Lauf 1;Lauf 2;Lauf 3;Lauf 1;Lauf 2;Lauf 3\n" + ";".join(["[mm]"] + ["[µm]"] * 6),
        HALVES,
        digits=4,
    ).encode("cp1252"),
    "groups above numbers of runs": wide("Ziel [mm];Vorwärts [µm];;;Rückwärts [µm];;\n;1;2;3;1;2;3", HALVES),
    "targets across in decimal commas": "\n".join(
        ["Achse X;Abweichung in µm", f"Lauf;Richtung;{TARGETS_ACROSS}", *across(lambda r, s: f"{r};{mark(s, 'Vorwärts', 'Rückwärts')}")]
    ),
    "run and direction in one word": "\n".join(
        [f"Messung;{TARGETS_ACROSS}", *across(lambda r, s: f"Lauf {r} {mark(s, 'vorwärts', 'rückwärts')}")]
    ),
    "a summary table below": wide("Axis:X\nTarget (mm);" + headers("Run {r} {w} (um)", "+ve", "-ve"), after=SUMMARY),
    "statistics below": wide("Pos;" + headers("{w}{r}", "V", "R"), after=["Mittel;" + ";".join(["1,0"] * 6), "+2s;" + ";".join(["1,2"] * 6)]),
    "a block per run": blocks(sides=False),
    "a block per run and side": blocks(sides=True),
    "falling targets": "\n".join(["Pos mm;" + headers("{w}{r}", "up", "dn"), *wide("").split("\n")[:0:-1]]),
    "french, wide": wide("Position cible (mm);" + headers("Essai {r} {w} (µm)", "aller", "retour"), after=["Moyenne" + ";1,0" * 6]).encode("cp1252"),
    "french, long": long("Essai;Sens;Position théorique (mm);Écart (µm)", lambda r, x, s, d: f"{r};{mark(s, 'montée', 'descente')};{de(x)};{de(d)}"),
    "french, two positions": long("Passe;Consigne (mm);Mesure (mm)", lambda r, x, s, d: f"{r};{de(x)};{de(x + d / 1000, 5)}"),
    "french, of the other sign": long("Essai;Position (mm);Ecart consigne - mesure (µm)", lambda r, x, s, d: f"{r};{de(x)};{de(-d)}"),
    "italian, wide": wide("Quota [mm];" + headers("Corsa {r} {w} [µm]", "andata", "ritorno")),
    "italian, long": long("Prova;Direzione;Posizione nominale [mm];Scostamento [µm]", lambda r, x, s, d: f"{r};{mark(s, 'avanti', 'indietro')};{de(x)};{de(d)}"),
    "spanish": long("Ensayo;Sentido;Posición objetivo (mm);Desviación (µm)", lambda r, x, s, d: f"{r};{mark(s, 'ida', 'vuelta')};{de(x)};{de(d)}"),
    "japanese in Shift JIS": long("回数,方向,目標位置[mm],偏差[um]", lambda r, x, s, d: f"{r},{mark(s, '往', '復')},{x},{d}", "軸,X").encode("cp932"),
    "japanese, two positions": long("回数,指令位置[mm],実測位置[mm]", lambda r, x, s, d: f"{r},{x},{x + d / 1000:.5f}"),
    "chinese in GB 18030": long("次数,方向,目标位置(mm),误差(um)", lambda r, x, s, d: f"{r},{mark(s, '正向', '反向')},{x},{d}").encode("gb18030"),
    "comp. value": long("Run,Axis position [mm],Comp. value [um]", lambda r, x, s, d: f"{r},{x},{-d}"),
    "compensation": long("Run,Axis position [mm],Compensation (um)", lambda r, x, s, d: f"{r},{x},{-d}"),
    "Korrektur in every header": wide("Pos. [mm];" + headers("Korrektur {r}{w} [µm]", "+", "-"), sign=-1.0),
    "Korrekturwerte in the title": wide("Korrekturwerte in µm (Achse X)\nPos. [mm];" + headers("{r}{w}", "+", "-"), sign=-1.0),
    "the sign in the preamble": wide("Abweichung = Sollwert − Istwert\nPos. [mm];" + headers("{r}{w} [µm]", "+", "-"), sign=-1.0),
    "the sign below the table": long("Run,Target (mm),Error (um)", lambda r, x, s, d: f"{r},{x},{-d}", below="\nNote: error = target - actual"),
    "an error after correction": long("Run,Target (mm),Error after correction (um)", lambda r, x, s, d: f"{r},{x},{d}"),
    "a correction beside the deviation": long("Run,Target (mm),Correction (um),Deviation (um)", lambda r, x, s, d: f"{r},{x},{-d},{d}"),
    "a switch called compensation": long("Run,Target (mm),Compensation,Deviation (um)", lambda r, x, s, d: f"{r},{x},1,{d}"),
    "mm beside inch": long("Pass,Position (mm),Error (in)", lambda r, x, s, d: f"{r},{x},{float(d) / 25400!r}"),
    "metres": long("run;position [m];deviation [m]", lambda r, x, s, d: f"{r};{x / 1000:.6E};{d * 1e-6:.9E}"),
    "apostrophes of thousands": long("Lauf;Soll [um];Abw [um]", lambda r, x, s, d: f"{r};{x * 1000:,.1f};{d}".replace(",", "'")),
    "the minus behind": long("Run;Target [mm];Deviation [um]", lambda r, x, s, d: f"{r};{x};{abs(d)}{'-' if d < 0 else ''}"),
    "units in the cells": long("Soll;Lauf;Abw.", lambda r, x, s, d: f"{de(x)} mm;{r};{de(d)} µm"),
    "an index and names with underscores": long("Sample,Run,X_soll,X_ist", lambda r, x, s, d: f"7,{r},{x},{x + d / 1000:.5f}"),
    "a controller's trace": long(
        "Zeit [s];Lagesollwert X1 [mm];Lageistwert X1 Messsystem 1 [mm];Schleppabstand X1 [mm]",
        lambda r, x, s, d: f"{trace_time(r, x, s)};{x};{x + d / 1000:.5f};0.0",
        "'Trace';V2",
    ),
    "dial readings by direction": "\n".join(
        ["Lauf;Soll;Messuhr vor;Messuhr zurück"]
        + [f"{r};{x};{x + deviation(r, 1.0)[i] / 1000:.5f};{x + deviation(r, -1.0)[i] / 1000:.5f}" for r in RUNS for i, x in enumerate(TARGETS)]
    ),
    "gaps, an empty column, remarks, a signature": long(
        "Run;;Target [mm];Deviation [um];Bemerkung;", lambda r, x, s, d: f"{r};;{x};{d};{'Tür offen' if x == 50 else ''};\n;;;;;", below="Geprüft: A. Müller;;;;;"
    ),
    "degrees Fahrenheit": long("Run,Target (mm),Deviation (um),Air temp (°F)", lambda r, x, s, d: f"{r},{x},{d},{68 + x / 600:.1f}"),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_third_party_text(tmp_path: Path, name: str) -> None:
    text = FILES[name]
    (tmp_path / "f.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))


def report_sheet(sheet, two_columns: bool) -> None:
    """ISO 230-2: targets across, runs down; both directions side by side or in blocks; figures over the runs below."""
    places = [v for x in TARGETS for v in ((float(x), None) if two_columns else (float(x),))]
    for row in (["ISO 230-2:2014", "Axis X"], ["i", *range(1, 14)], ["Target position Pi (mm)", *places]):
        sheet.append(row)
    if two_columns:
        sheet.append(["Approach", *["↑", "↓"] * 13])
        sheet.append(["Deviation (µm)"])
        for r in RUNS:
            sheet.append([f"j={r}", *(float(deviation(r, s)[i]) for i in range(13) for s in SIDES)])
    for s in () if two_columns else SIDES:
        sheet.append([f"Positional deviation (µm), approach {mark(s, '↑', '↓')}"])
        for r in RUNS:
            sheet.append([f"j = {r}", *map(float, deviation(r, s))])
    sheet.append(["Mean unidirectional deviation", *[1.0] * len(places)])
    sheet.append(["2s", *[0.2] * len(places)])
    sheet.append(["x bar", *[0.3] * len(places)])


def dated(sheet) -> None:
    start = datetime.datetime(2026, 3, 12, 8)
    sheet.append(["Zeitstempel", "Lauf", "Soll", "Ist"])
    sheet.append([None, None, "mm", "mm"])
    for i, (r, x, _, d) in enumerate(long_rows()):
        sheet.append([start + datetime.timedelta(seconds=10 * i), int(r), float(x), round(float(x + d / 1000), 6)])


def side_by_side(sheet) -> None:
    sheet.append(["Forward", None, None, None, None, "Backward"])
    sheet.append([*["Pos [mm]", "1 [µm]", "2 [µm]", "3 [µm]", None] * 2][:-1])
    for i, x in enumerate(TARGETS):
        row = [[float(x), *(float(deviation(r, s)[i]) for r in RUNS)] for s in SIDES]
        sheet.append([*row[0], None, *row[1]])


def merged(sheet) -> None:
    """Directions merged over numbers of runs, with the unit of the targets beside the numbers."""
    sheet.append(["Position", "Vorwärts", None, None, "Rückwärts"])
    sheet.merge_cells("B1:D1")
    sheet.merge_cells("E1:G1")
    sheet.append(["mm", 1, 2, 3, 1, 2, 3])
    for i, x in enumerate(TARGETS):
        sheet.append([float(x), *(float(c[i]) for c in HALVES)])
    sheet.append(["Mittelwert", *(float(c.mean()) for c in HALVES)])


SHEETS = {
    "a report with blocks of directions": lambda s: report_sheet(s, two_columns=False),
    "a report with two columns a target": lambda s: report_sheet(s, two_columns=True),
    "dates of Excel": dated,
    "tables side by side": side_by_side,
    "merged directions": merged,
}


@pytest.mark.parametrize("name", SHEETS)
def test_a_third_party_workbook(tmp_path: Path, name: str) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="the samples are made by openpyxl")
    pytest.importorskip("python_calamine", reason="the extra `excel` is not installed")
    book = openpyxl.Workbook()
    SHEETS[name](book.active)
    book.save(tmp_path / "f.xlsx")
    holds_the_truth(imported(tmp_path, tmp_path / "f.xlsx"))


def test_sheets_are_axes_and_the_others_are_named(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl", reason="the sample is made by openpyxl")
    pytest.importorskip("python_calamine", reason="the extra `excel` is not installed")
    book = openpyxl.Workbook()
    book.active.title = "Y"
    for sheet in (book.active, book.create_sheet("X")):
        sheet.append(["Target [mm]", *headers("Run {r} {w} [µm]", "up", "down").split(";")])
        for i, x in enumerate(TARGETS):
            sheet.append([float(x), *(float(c[i]) * (1 if sheet.title == "X" else 2) for c in PAIRS)])
    book.save(tmp_path / "f.xlsx")
    assert imported(tmp_path, tmp_path / "f.xlsx").components() == ("EYY",)
    assert "other sheets hold measurements too: X" in (tmp_path / "rec" / "recording.yaml").read_text()
    holds_the_truth(imported(tmp_path, tmp_path / "f.xlsx", ReaderOptions(sheet="X")))


def test_matrices_with_the_targets(tmp_path: Path) -> None:
    """Readings of all runs as one matrix a direction, by h5py and by scipy."""
    h5py = pytest.importorskip("h5py", reason="the extra `hdf` is not installed")
    from scipy.io import savemat

    up, down = (np.array([deviation(r, s) for r in RUNS]) for s in SIDES)
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["targets_mm"], file["forward_um"], file["reverse_um"] = TARGETS, up.T, down
    savemat(tmp_path / "f.mat", {"pos": TARGETS[:, None], "fwd_um": up.T, "rev_um": down.T})
    holds_the_truth(imported(tmp_path, tmp_path / "f.h5"))
    holds_the_truth(imported(tmp_path, tmp_path / "f.mat"))


def test_numbers_in_brackets_are_asked_about(tmp_path: Path) -> None:
    """`(5.2)` may be a negative number or a doubtful one: left empty, the errors below zero would be missing."""
    text = long("Run;Target [mm];Deviation [um]", lambda r, x, s, d: f"{r};{x};{d if d > -1 else f'({-d})'}")
    (tmp_path / "f.csv").write_text(text)
    with pytest.raises(DataError, match="negative, or doubtful"):
        imported(tmp_path, tmp_path / "f.csv")


def test_two_errors_of_one_component_are_refused(tmp_path: Path) -> None:
    text = long("Run;Target [mm];Error before [um];Error after [um]", lambda r, x, s, d: f"{r};{x};{d};{d / 9}")
    (tmp_path / "f.csv").write_text(text)
    with pytest.raises(DataError, match="are both deviations of EXX"):
        imported(tmp_path, tmp_path / "f.csv")


@pytest.mark.parametrize(
    ("header", "correction"),
    [("Korrekturwert", True), ("Comp. value [um]", True), ("Fehler nach Korrektur", False), ("component", False)],
)
def test_names_of_corrections(header: str, correction: bool) -> None:
    assert words.is_correction(header) == correction
