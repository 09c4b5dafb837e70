"""Units that others wrote in words, or as parts of a unit: in a header, or in a line above the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.importing.units import split_header
from errpipe.importing.wide import unit_above
from tests.unit.importing.known_test import TARGETS, deviation, imported, long_rows, number


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("Error (micrometres)", "um"),
        ("Erreur en micromètres", "um"),
        ("Errores (micras)", "um"),
        ("Błąd [mikrometry]", "um"),
        ("Target (millimetres)", "mm"),
        ("Error (nanometres)", "nm"),
        ("Fehler in hundertstel mm", "0.01 mm"),  # was mm
        ("Fehler in 1/100mm", "0.01 mm"),
        ("Error 0.001 mm", "0.001 mm"),  # was mm
        ("Error (hundredths of a millimetre)", "0.01 mm"),
        ("Error (ten-thousandths of an inch)", "0.0001 inch"),  # was um, by the size of the readings
        ("Error (tenths of a thou)", "0.0001 inch"),
        ("Error [10^-6 m]", "0.000001 m"),
        ('Error "', "inch"),
        ("Error, seconds of arc", "arcsec"),
        ("Abweichung Winkelsekunden", "arcsec"),
        ("Fehler (µ)", "um"),
    ],
)
def test_a_unit_in_words(header: str, unit: str) -> None:
    assert split_header(header)[1] == unit
    assert split_header(header)[0] in ("Error", "Abweichung", "Erreur en", "Errores", "Błąd", "Target", "Fehler")


@pytest.mark.parametrize(
    ("line", "unit"),
    [
        ("Deviations in micrometres", "um"),  # was inch: the word `in`
        ("All deviations in Mikrometern", "um"),
        ("Error values in in", "inch"),
        ("Errors in hundredths of a millimetre", "0.01 mm"),
        ("Abweichungen in 1/100 mm", "0.01 mm"),
        ("Deviations in µm, resolution 0.1 µm", "um"),
        ("deviations in 0.1 µm, positions in mm", "0.1 um"),
        ("Error limit 0.02 mm", None),
        ("Error limits in force", None),
    ],
)
def test_a_unit_in_a_line_above(line: str, unit: str | None) -> None:
    assert unit_above([line], np.array([0.1])) == unit


def test_a_table_in_micrometres_is_not_in_inches(tmp_path: Path) -> None:
    """Each reading was multiplied by 25400."""
    head = "Axis X\nDeviations in micrometres\nTarget mm;Up 1;Up 2;Down 1;Down 2\n"
    rows = [
        ";".join([f"{t:g}", *(number(deviation(r, s)[i], ",") for s in (1.0, -1.0) for r in (1, 2))])
        for i, t in enumerate(TARGETS)
    ]
    (tmp_path / "f.csv").write_text(head + "\n".join(rows), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.array("EXX").max() == pytest.approx(max(deviation(2, -1.0)))


def test_a_long_table_has_the_unit_of_the_line_above(tmp_path: Path) -> None:
    """It was asked about, or taken as um by the size of its readings."""
    rows = [f"{run};{'+' if side > 0 else '-'};{x:g};{d / 2.54:.2f}" for run, x, side, d in long_rows()]
    head = "Axis X\nErrors in ten-thousandths of an inch\nRun;Dir;Target [mm];Error\n"
    (tmp_path / "f.csv").write_text(head + "\n".join(rows), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.array("Error") == pytest.approx([d for *_, d in long_rows()], abs=0.02)


@pytest.mark.parametrize("measured", [True, False])
def test_units_of_a_line_are_those_of_the_positions(tmp_path: Path, measured: bool) -> None:
    """`Units: inch` was asked about all the same."""
    rows = [
        f"{run};{'+' if side > 0 else '-'};{x / 25.4:.4f};{(x if measured else 0) / 25.4 + d / 25400:.6f}"
        for run, x, side, d in long_rows()
    ]
    head = f"Axis X\nUnits: inch\nRun;Dir;Target;{'Measured' if measured else 'Error'}\n"
    (tmp_path / "f.csv").write_text(head + "\n".join(rows), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    (error,) = recording.names("error", component="EXX")
    assert recording.array(error) == pytest.approx([d for *_, d in long_rows()], abs=3.0 if measured else 0.05)


def test_units_of_positions_are_not_those_of_large_readings() -> None:
    """12 mm are no error of an axis."""
    assert unit_above(["Units: mm"], np.array([0.012])) == "mm"
    assert unit_above(["Units: mm"], np.array([12.0])) is None
    assert unit_above(["Errors in mm"], np.array([12.0])) == "mm"


@pytest.mark.parametrize("ending", ["_m", " m"])
def test_two_columns_that_end_so_are_in_metres(tmp_path: Path, ending: str) -> None:
    """Asked whether `m` is metres or measured where their names have blanks."""
    rows = [f"{run};{x / 1000:g};{(x + d / 1000) / 1000:.7f}" for run, x, _, d in long_rows()]
    head = f"Axis X\nRun;Target position{ending};Actual position{ending}\n"
    (tmp_path / "f.csv").write_text(head + "\n".join(rows), encoding="utf-8")
    recording = imported(tmp_path, tmp_path / "f.csv")
    assert recording.array("EXX") == pytest.approx([d for *_, d in long_rows()], abs=0.06)


@pytest.mark.parametrize("header", ["Temp °", "T1 °", "Temperature (°)"])
def test_degrees_of_a_temperature_are_degrees_celsius(header: str) -> None:
    assert split_header(header)[1] == "degC"
    assert split_header("Target °")[1] == "deg"
