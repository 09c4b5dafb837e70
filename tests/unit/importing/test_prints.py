"""Inspection prints of CMMs and probing cycles: nominal and actual places of features, made or measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.domain.protocols import missing_readings, protocol_of
from errpipe.errors import DataError
from tests.unit.importing.known_test import imported, prepared

HOLES = [(x, y) for y in (50.0, 150.0, 250.0) for x in (50.0, 200.0, 350.0)]
MADE, MEASURED = "actual-minus-commanded", "commanded-minus-actual"


def printed(hole: tuple[float, float], made: bool) -> list[tuple[str, float, float]]:
    """(axis, nominal, actual) of a machine that is 10 um too long at X = 350 mm and 4 um too short at Y = 250 mm.

    It drills a hole 10 um too far; at a ball of known place its scales show 10 um less.
    """
    sign = 1.0 if made else -1.0
    off = (0.010 * hole[0] / 350, -0.004 * hole[1] / 250)
    return [(axis, at, round(at + sign * d, 4)) for axis, at, d in zip("XY", hole, off, strict=True)]


def pc_dmis(made: bool, unit: float = 1.0) -> list[str]:
    out = ["PART NAME  : PLATE      November 03, 2025    10:22"]
    for n, hole in enumerate(HOLES):
        out += [f"DIM LOC{n}= LOCATION OF CIRCLE CIR{n}  UNITS={'MM' if unit == 1 else 'IN'} ,$"]
        out += ["AX    NOMINAL       +TOL       -TOL       MEAS        DEV      OUTTOL"]
        for axis, nominal, actual in printed(hole, made):
            at, read = nominal / unit, actual / unit
            out += [f"{axis} {at:12.6f} 0.0100 0.0100 {read:.6f} {read - at:.6f} 0.0000 ---#---"]
        out += ["D    12.0000     0.0100     0.0100   12.0031    0.0031   0.0000 ---#---", f"END OF DIMENSION LOC{n}"]
    return out


def calypso(made: bool) -> list[str]:
    out = ["planid\tpartnb\tid\ttype\tidsymbol\tactual\tnominal\tuppertol\tlowertol\tdeviation\texceed\tunit"]
    for axis in (0, 1):  # all X values, then all Y values
        for n, hole in enumerate(HOLES):
            a, nominal, actual = printed(hole, made)[axis]
            kind = f"{a} Value_Circle{n}\t{a.lower()}Value\t{a}"
            out += [f"Plate\t12\t{kind}\t{actual}\t{nominal}\t0.01\t-0.01\t{actual - nominal:.4f}\t\tmm"]
    return [*out, "END"]


def probing_cycle(made: bool) -> list[str]:
    out = ["INSPECTION REPORT"]
    for n, hole in enumerate(HOLES):
        out += [f"FEATURE NO {n + 1}", "SIZE D12.0000  ACTUAL 12.0031  TOL 0.1000 DEV 0.0031"]
        out += [f"POSN {a}{x:.4f} ACTUAL {y:.4f} TOL TP 0.2000 DEV {y - x:.4f}" for a, x, y in printed(hole, made)]
    return out


def table(made: bool) -> list[str]:
    """Merged cells of the feature; deviations that are nominal less actual, in um."""
    out = ["Merkmal;Achse;Soll [mm];Ist [mm];Abw. [µm];Pass/Fail"]
    for n, hole in enumerate(HOLES):
        for k, (a, x, y) in enumerate(printed(hole, made)):
            out += [f"{'' if k else f'Bohrung {n}'};{a};{x};{y};{1000 * (x - y):.1f};PASS".replace(".", ",")]
    return out


def columns_per_axis(made: bool) -> list[str]:
    rows = [[cell for _, *pair in printed(hole, made) for cell in pair] for hole in HOLES]
    return [
        "Feature,Nominal X,Actual X,Nominal Y,Actual Y",
        *(f"CIR{n},{','.join(map(str, r))}" for n, r in enumerate(rows)),
    ]


PRINTS = [pc_dmis, lambda made: pc_dmis(made, 25.4), calypso, probing_cycle, table, columns_per_axis]


@pytest.mark.parametrize("lines", PRINTS, ids=["PC-DMIS", "inch", "Calypso", "probing cycle", "table", "columns"])
@pytest.mark.parametrize(("made", "protocol"), [(True, "hole_pattern"), (False, "ball_plate")])
def test_a_print_is_a_recording_of_the_machine(tmp_path: Path, lines, made: bool, protocol: str) -> None:
    (tmp_path / "print.txt").write_text("\n".join(lines(made)), "utf-8")
    with pytest.raises(DataError, match="was a part or an artefact measured"):
        prepared([tmp_path / "print.txt"])
    recording = imported(tmp_path, tmp_path / "print.txt", sign=MADE if made else MEASURED)
    assert protocol_of(recording) == protocol and missing_readings(recording) is None
    x, y = (recording.array(recording.name("position", axis=a)) for a in "XY")
    assert sorted(zip(x, y, strict=True)) == sorted(HOLES)
    assert recording.array(recording.name("error", component="E_X")) == pytest.approx(10 * x / 350, abs=0.06)
    assert recording.array(recording.name("error", component="E_Y")) == pytest.approx(-4 * y / 250, abs=0.06)


def test_a_print_of_a_step_gauge_is_positioning(tmp_path: Path) -> None:
    out = ["STEP GAUGE", "UNITS=MM"]
    for n, x in enumerate(np.arange(0.0, 351.0, 50.0)):
        out += [f"DIM LOC{n}= LOCATION OF PLANE PLN{n}", "AX NOMINAL MEAS +TOL -TOL DEV OUTTOL"]
        out += [f"X {x:.4f} {x - 1e-2 * x / 350:.4f} 0.01 0.01 {-1e-2 * x / 350:.4f} 0.0"]
    (tmp_path / "print.txt").write_text("\n".join(out), "utf-8")
    recording = imported(tmp_path, tmp_path / "print.txt", sign=MEASURED)
    x = recording.array(recording.name("position", axis="X"))
    assert recording.array(recording.name("error", component="EXX")) == pytest.approx(10 * x / 350, abs=0.06)


def test_a_plate_that_was_measured_again_is_another_run(tmp_path: Path) -> None:
    (tmp_path / "print.csv").write_text("\n".join([*table(True), *table(True)[1:]]), "utf-8")
    assert imported(tmp_path, tmp_path / "print.csv", sign=MADE).run_labels() == ("1", "2")


@pytest.mark.parametrize(
    ("lines", "match"),
    [
        ([line.replace("Ist", "Tol.").replace("Abw.", "Tol. +") for line in table(True)], "several axes"),
        (
            [table(True)[0], *(line.rsplit(";", 2)[0] + ";7,0;PASS" for line in table(True)[1:])],
            "line 2: X: the deviation 7",
        ),
        (["X50.0031 Y50.0012 Z-10.0000", "X200.0031 Y50.0012 Z-10.0000"], "`Feature;Axis;Nominal;Actual`"),
        (["TCHPR421", "Measuring log Probing Cycle 421", "Center in reference axis: 50.0"], "Feature;Axis;Nominal"),
    ],
)
def test_what_a_print_lacks_is_stated(tmp_path: Path, lines: list[str], match: str) -> None:
    (tmp_path / "print.txt").write_text("\n".join(lines), "utf-8")
    with pytest.raises(DataError, match=match):
        prepared([tmp_path / "print.txt"], sign=MADE)


def test_rows_of_two_axes_below_one_another_are_no_features(tmp_path: Path) -> None:
    rows = [f"{axis};{x};{x + 0.01 * x / 350:.4f}" for axis in "XY" for x in range(0, 351, 50)]
    (tmp_path / "f.csv").write_text("\n".join(["Axis;Nominal [mm];Actual [mm]", *rows]), "utf-8")
    with pytest.raises(DataError, match="rows of several axes"):
        prepared([tmp_path / "f.csv"])
