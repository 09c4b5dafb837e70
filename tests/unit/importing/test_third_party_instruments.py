"""Files of trackers, ball bars, rotary tables, historians and loggers, as their own software lays them out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from errpipe.errors import DataError
from errpipe.importing.sheet import ReaderOptions
from tests.unit.importing.known_test import TARGETS, deviation, holds_the_truth, imported, long_rows


def write(tmp_path: Path, text: str, name: str = "f.csv") -> Path:
    (tmp_path / name).write_text(text, "utf-8")
    return tmp_path / name


def test_facts_with_a_number_above_a_wider_table_are_no_rows_of_it(tmp_path: Path) -> None:
    facts = (
        "Ballbar test\nPlane,XY\nNominal radius (mm),150\nFeedrate (mm/min),1000\nCentre X (mm),200\nCentre Y (mm),50"
    )
    rows = [f"{a},{150.0 + a / 1e5:.5f},{150.0 - a / 1e5:.5f}" for a in range(0, 360, 5)]
    text = "\n".join([facts, "Angle (deg),Radius CCW (mm),Radius CW (mm)", *rows])
    frame = imported(tmp_path, write(tmp_path, text)).frame
    assert frame["E_R"].max() == pytest.approx(3.55, abs=0.01)  # um
    assert frame["X"].iloc[0] == pytest.approx(150.0)


def test_names_that_two_blanks_part_may_hold_numbers(tmp_path: Path) -> None:
    head = "AXIS: X\nUNITS: mm\nERROR UNITS: microns\n\nPosition    " + "   ".join(
        f"Run {r} {way}" for r in (1, 2, 3) for way in ("Fwd", "Rev")
    )
    rows = [
        f"{x:8.3f}  " + "  ".join(f"{deviation(r, s)[i]:9.3f}" for r in (1, 2, 3) for s in (1.0, -1.0))
        for i, x in enumerate(TARGETS)
    ]
    holds_the_truth(imported(tmp_path, write(tmp_path, "\n".join([head, *rows]), "f.txt")))


def test_degrees_minutes_and_seconds(tmp_path: Path) -> None:
    """-0 deg 0' 2" keeps its sign."""
    rows = [("0°00'00\"", "-0°00'02.00\""), ("15°00'00\"", "15°00'03.60\""), ("30°00'00\"", "30° 0′ 00.0″")]
    text = "\n".join(["Rotary axis C", "Target;Actual", *(f"{a};{b}" for a, b in rows)])
    recording = imported(tmp_path, write(tmp_path, text))
    arcsec = recording.frame["ECC"].to_numpy() / (np.pi / 180 / 3600 * 1e6)
    assert arcsec == pytest.approx([-2.0, 3.6, 0.0], abs=1e-6)


def test_lengths_read_with_a_rotary_axis_are_no_angle(tmp_path: Path) -> None:
    rows = [f"{b},{c},{c / 100:.2f},1.5,-0.5" for b in (-30, 0, 30) for c in range(0, 360, 60)]
    text = "\n".join(["B [deg],C [deg],U1 [um],U2 [um],U3 [um]", *rows])
    with pytest.raises(DataError, match="which is an angle: declare what was displaced"):
        imported(tmp_path, write(tmp_path, text))


@pytest.mark.parametrize(("said", "scale"), [("// Units: m", 1e-3), ("Units: inch", 1 / 25.4), ("# Unit: mm", 1.0)])
def test_a_unit_above_a_list_of_points_is_that_of_its_places(tmp_path: Path, said: str, scale: float) -> None:
    """A tracker's list along X: the other axes stand still and are not reported."""
    rows = [
        f"P{k};{x * scale:.7f};{100 * scale:.7f};{(x + d / 1e3) * scale:.9f};{100 * scale:.7f}"
        for k, (_, x, _, d) in enumerate(long_rows())
    ]
    text = "\n".join([said, "Name;Nominal X;Nominal Y;Measured X;Measured Y", *rows])
    recording = imported(tmp_path, write(tmp_path, text))
    assert [c.component for c in recording.manifest.columns.values() if c.role == "error"] == ["EXX"]
    assert recording.frame["EXX"].to_numpy() == pytest.approx([d for *_, d in long_rows()], abs=2e-3)


def test_a_place_that_stands_is_in_the_unit_of_those_that_move(tmp_path: Path) -> None:
    rows = [f"{x};100;{x + d / 1e3:.4f};100" for _, x, _, d in long_rows()]
    text = "\n".join(["Nominal X;Nominal Y;Actual X;Actual Y", *rows])
    assert "EXX" in imported(tmp_path, write(tmp_path, text)).frame


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1.0), ("inch", 1 / 25.4)])
def test_a_historian_that_nests_the_values_of_each_signal(tmp_path: Path, unit: str, scale: float) -> None:
    def signal(name: str, values: list[float]) -> dict[str, object]:
        of_time = [
            {"SourceTimestamp": f"2026-11-12T08:{k // 60:02d}:{k % 60:02d}Z", "StatusCode": "Good", "Value": v * scale}
            for k, v in enumerate(values)
        ]
        return {"NodeId": f"ns=2;s=X.{name}", "EngineeringUnits": unit, "DataValues": of_time}

    rows = long_rows()
    places = [signal("SetPos", [x for _, x, _, _ in rows]), signal("ActPos", [x + d / 1e3 for _, x, _, d in rows])]
    recording = imported(tmp_path, write(tmp_path, json.dumps({"Results": places}), "f.json"))
    assert recording.frame["EXX"].to_numpy() == pytest.approx([d for *_, d in rows], abs=1e-3)


def test_a_sheet_that_names_the_channels_of_another(tmp_path: Path) -> None:
    book = openpyxl.Workbook()
    legend = book.active
    for row in [
        ("Channel", "Sensor", "Unit"),
        ("CH1", "Front bearing", "°C"),
        ("CH2", "Deviation Z (actual - commanded)", "µm"),
    ]:
        legend.append(row)
    data = book.create_sheet("Data")
    data.append(["Time (min)", "CH1", "CH2"])
    for k in range(12):
        data.append([k, 20 + k / 10, 1.25 * k])
    book.save(tmp_path / "f.xlsx")
    columns = imported(tmp_path, tmp_path / "f.xlsx").manifest.columns
    assert [(c.role, c.unit) for c in columns.values()][-2:] == [("temperature", "degC"), ("error", "um")]


def test_divisions_of_a_dial_with_a_unit_are_deviations(tmp_path: Path) -> None:
    rows = [f"{x:.0f}  {deviation(1, 1.0)[i]:.1f}  {deviation(1, -1.0)[i]:.1f}" for i, x in enumerate(TARGETS)]
    text = "\n".join(["X(mm)  up(div)  down(div)", *rows])
    recording = imported(tmp_path, write(tmp_path, text, "f.txt"), sets=["up_div.unit=um", "down_div.unit=um"])
    assert recording.frame["EXX"].abs().max() == pytest.approx(np.abs([deviation(1, s) for s in (1.0, -1.0)]).max())


@pytest.mark.parametrize(("said", "role"), [("Spindle speed 8000 rpm", "spindle_speed"), ("Spindle test", "ignore")])
def test_a_spindle_that_is_on_or_off_has_the_speed_that_a_line_states(tmp_path: Path, said: str, role: str) -> None:
    """Nothing is taken for a speed where no line states one: a table that reads rpm would take 1 for on."""
    rows = [f"{k},{'ON' if k % 4 < 2 else 'off'},{20 + k / 10},{k / 4}" for k in range(16)]
    text = "\n".join([said, "Time [min],Spindle,T_bearing [°C],Z displacement [µm]", *rows])
    recording = imported(tmp_path, write(tmp_path, text))
    assert recording.manifest.columns["Spindle"].role == role
    if role == "spindle_speed":
        assert recording.frame["Spindle"].tolist() == [8000.0, 8000.0, 0.0, 0.0] * 4


def test_commands_and_readings_that_are_exchanged_in_one_run_are_refused(tmp_path: Path) -> None:
    rows = [(r, *((x + d / 1e3, x) if r == "2" else (x, x + d / 1e3))) for r, x, _, d in long_rows() if d != 0.0 != x]
    text = "\n".join(["Run;X target [mm];X actual [mm]", *(f"{r};{a:.4f};{b:.4f}" for r, a, b in rows)])
    with pytest.raises(DataError, match="has the targets of the other rows"):
        imported(tmp_path, write(tmp_path, text))


def test_the_unit_above_rows_without_a_header_is_that_of_columns_that_a_person_names(tmp_path: Path) -> None:
    rows = [f"{x / 25.4:.7f}, {(x + d / 1e3) / 25.4:.9f}" for _, x, _, d in long_rows()]
    reader = ReaderOptions(names=("x_target", "x_actual"))
    file = write(tmp_path, "\n".join(['"Optodyne"', '"Unit: inch"', *rows]), "f.dat")
    assert imported(tmp_path, file, reader).frame["EXX"].abs().max() == pytest.approx(
        max(abs(d) for *_, d in long_rows()), abs=0.01
    )


def test_a_load_in_percent_is_no_humidity(tmp_path: Path) -> None:
    rows = [f"{x:.1f},{d:.2f},{30 + k % 5}%" for k, (_, x, _, d) in enumerate(long_rows())]
    text = "\n".join(["X axis", "Target mm,Dev um,Spindle load %", *rows])
    assert not imported(tmp_path, write(tmp_path, text)).names("humidity")


def test_places_as_designed_and_as_built(tmp_path: Path) -> None:
    rows = [f"{x / 1e3:.6f},0.1,{(x + d / 1e3) / 1e3:.8f},0.1" for _, x, _, d in long_rows()]
    text = "\n".join(["Design_X(m),Design_Y(m),AsBuilt_X(m),AsBuilt_Y(m)", *rows])
    frame = imported(tmp_path, write(tmp_path, text)).frame
    assert frame["EXX"].to_numpy() == pytest.approx([d for *_, d in long_rows()], abs=2e-2)
