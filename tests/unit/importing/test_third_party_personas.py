"""Files of a laboratory with Python, a robot, a rotary table, a lathe in Japan, a printer, a shop with a database."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from errpipe.errors import DataError, UsageError
from tests.unit.importing.known_test import holds_the_truth, imported, long_rows, prepared

ROWS = [(int(run), side, target, d) for run, target, side, d in long_rows()]
TARGETS = [*enumerate((0, 100, 200, 300))]
NAMES = ("run", "direction", "x_cmd_mm", "exx_um")


def structured() -> np.ndarray:
    return np.array(ROWS, dtype=[("run", "i4"), ("direction", "f8"), ("x_cmd_mm", "f8"), ("exx_um", "f8")])


def written(file: Path, lines: list[str], encoding: str = "utf-8") -> Path:
    file.write_bytes(("\n".join(lines) + "\n").encode(encoding))
    return file


@pytest.mark.parametrize("name", ["vectors.npz", "rows.npy", "rows.mat"])
def test_arrays_of_numpy_and_structures_of_single_values(tmp_path: Path, name: str) -> None:
    file, array = tmp_path / name, structured()
    if name.endswith(".npz"):
        words = np.where(array["direction"] > 0, "up", "down")  # texts stand beside numbers
        np.savez(file, **{n: array[n] if n != "direction" else words for n in NAMES})
    elif name.endswith(".npy"):
        np.save(file, array)
    else:
        scipy.io.savemat(file, {"data": array})
    holds_the_truth(imported(tmp_path, file))


def test_objects_of_numpy_are_not_loaded(tmp_path: Path) -> None:
    np.save(tmp_path / "o.npy", np.array([{"a": 1}, None], dtype=object), allow_pickle=True)
    with pytest.raises(DataError, match="without running code"):
        prepared([tmp_path / "o.npy"])


def test_an_array_that_states_more_than_memory_holds_is_refused(tmp_path: Path) -> None:
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': ({1 << 44},), }}".ljust(117) + "\n"
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode())
    with pytest.raises(DataError, match="of memory"):
        prepared([tmp_path / "a.npy"])


def test_a_table_of_a_database(tmp_path: Path) -> None:
    file = tmp_path / "shop.db"
    with sqlite3.connect(file) as database:
        database.execute("create table readings (run int, direction int, [x_cmd_mm] real, [exx_um] real)")
        database.execute("create view readings_2 as select * from readings")
        database.executemany("insert into readings values (?, ?, ?, ?)", ROWS)
    database.close()
    holds_the_truth(imported(tmp_path, file))
    Path(f"{file}-wal").write_bytes(b"rows")
    with pytest.raises(DataError, match="close it there first"):
        prepared([file])
    Path(f"{file}-wal").unlink()
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(DataError, match="export the table as CSV"):
        prepared([file])


def test_the_unit_of_a_field_of_parquet_stands_in_its_metadata(tmp_path: Path) -> None:
    units = {"run": b"", "direction": b"", "x": b"m", "error": b"nm"}
    columns = [[r[0] for r in ROWS], [r[1] for r in ROWS], [r[2] / 1000 for r in ROWS], [r[3] * 1000 for r in ROWS]]
    schema = pa.schema([pa.field(n, pa.float64(), metadata={b"unit": u}) for n, u in units.items()])
    pq.write_table(pa.table([pa.array(c, pa.float64()) for c in columns], schema=schema), tmp_path / "t.parquet")
    holds_the_truth(imported(tmp_path, tmp_path / "t.parquet"))


def test_angles_without_a_unit_that_may_be_radians_are_asked_about(tmp_path: Path) -> None:
    angles = np.round(np.linspace(-1.5, 1.5, 31), 4)
    lines = ["A_cmd,A_act", *(f"{a},{a + 5e-5 * np.sin(a):.9f}" for a in [*angles, *angles[::-1]])]
    file = written(tmp_path / "joint.csv", lines)
    with pytest.raises(DataError, match=r"rad, or deg\? Declare it with --set A_cmd\.unit=rad"):
        prepared([file])
    recording = imported(tmp_path, file, sets=["A_cmd.unit=rad", "A_act.unit=rad"])
    assert np.max(recording.array(recording.names("error")[0])) == pytest.approx(50 * np.sin(1.5), abs=0.01)


def test_a_rotary_axis_may_pass_zero_within_a_run(tmp_path: Path) -> None:
    way_up, way_down = range(0, 360, 30), range(360, 0, -30)
    lines = ["Run;C nominal [°];C deviation [arcsec]"]
    lines += [f"{run};{a % 360};{a / 90 + 0.1 * run}" for run in (1, 2) for a in (*way_up, *way_down)]
    recording = imported(tmp_path, written(tmp_path / "table.csv", lines))
    side = recording.array(recording.name("direction", axis="C") or "")
    # The turning point, reached from 330, is of the way up; the second run begins with its own way up.
    assert side.tolist() == 2 * (13 * [1.0] + 11 * [-1.0])


def test_diameters_with_japanese_signs_are_asked_about(tmp_path: Path) -> None:
    lines = ["X軸(直径)位置決め測定", "指令値X(直径mm),測定値(直径mm)"]
    lines += [f"{x},{x + 0.004 * x / 100:.4f}" for x in (0, 50, 100, 150, 200, 150, 100, 50, 0)]
    file = written(tmp_path / "lathe.csv", lines, "cp932")
    with pytest.raises(DataError, match="says diameters"):
        prepared([file])
    with pytest.raises(DataError, match="says diameters"):  # a unit says nothing on them
        prepared([file], sets=["指令値X(直径mm).unit=mm", "測定値(直径mm).unit=mm"])


def test_what_a_refusal_of_diameters_proposes_is_accepted(tmp_path: Path) -> None:
    """A commanded position beside a reading stays the command: as plain position nothing would hold a deviation."""
    way = [*range(0, 160, 10), *range(150, -10, -10)]
    for name, read, role in (("X reading [mm]", lambda x: x + 1e-4 * x, "command"), ("dev [um]", abs, "position")):
        lines = [f"X commanded diameter [mm],{name}", *(f"{x},{read(x):.4f}" for x in way)]
        file = written(tmp_path / "lathe.csv", lines)
        with pytest.raises(DataError, match=f"use --set 'X commanded diameter.role={role}'"):
            prepared([file])
        prepared([file], sets=[f"X commanded diameter.role={role}"])


def test_a_column_that_a_person_left_out_is_not_asked_about_again(tmp_path: Path) -> None:
    lines = [
        "min,X1 (µm),X2 (µm),T nose (°C)",
        *(f"{k},{k / 20:.2f},{k / 30:.2f},{20 + k / 50:.2f}" for k in range(60)),
    ]
    file = written(tmp_path / "five.csv", lines)
    with pytest.raises(DataError, match=r"second probe along X\? Use --set X2\.role=ignore"):
        prepared([file])
    proposal, _ = prepared([file], sets=["X2.role=ignore"])
    assert proposal.entries["X1"]["component"] == "E_X"
    assert proposal.entries["min"]["unit"] == "min"  # a clock called by its unit


def test_what_a_printer_writes_is_named(tmp_path: Path) -> None:
    spectrum = ["freq,psd_x,psd_y,mzv(58.0)", *(f"{f}.0,{f * f}.5,{f}.25,0.5" for f in range(60))]
    with pytest.raises(DataError, match="frequency response"):
        prepared([written(tmp_path / "shaper.csv", spectrum)])
    saved = ["#*# [bed_mesh default]", "#*# points =", "#*#   0.0125, 0.0100", "#*#   0.0225, 0.0150"]
    with pytest.raises(DataError, match="Klipper"):
        prepared([written(tmp_path / "printer.cfg", saved)])


def test_runs_and_other_tables_of_one_json(tmp_path: Path) -> None:
    parts = [[r for r in ROWS if r[0] == run] for run in (1, 2, 3)]
    runs = [{"x_cmd_mm": [r[2] for r in p], "direction": [r[1] for r in p], "EXX_um": [r[3] for r in p]} for p in parts]
    file = tmp_path / "test.json"
    file.write_text(json.dumps({"run": runs, "air": {"hour": [1, 2, 3, 4], "degC": [20.1, 20.2, 20.1, 20.3]}}))
    assert imported(tmp_path, file).frame.shape[0] == len(ROWS)  # the first run alone was taken
    proposal, _ = prepared([file])
    assert any("excluded: air" in note for note in proposal.notes)
    facts = {"Axis": "X", "Note": "error = commanded - actual"}
    table = {"target_mm": [r[2] for r in ROWS], "error_um": [-r[3] for r in ROWS], "dir": [r[1] for r in ROWS]}
    file.write_text(json.dumps({**facts, "readings": table}))  # the texts beside a table were not read
    read = imported(tmp_path / "facts", file)
    assert read.array("error").tolist() == pytest.approx([r[3] for r in ROWS])
    file.write_text(json.dumps({"before": runs[0], "later": runs[1]}))
    with pytest.raises(DataError, match=r"which one is meant|several states"):
        prepared([file])


@pytest.mark.parametrize("said", ["EXX.role=actual", "EXX.unit=um", "Run 1 +.role=actual"])
def test_what_a_person_says_of_a_column_that_is_made_is_not_ignored(tmp_path: Path, said: str) -> None:
    lines = ["Axis X", "Target mm;Run 1 + [mm];Run 1 - [mm]", *(f"{x};0.00{k};0.00{k + 2}" for k, x in TARGETS)]
    file = written(tmp_path / "wide.csv", lines)
    assert prepared([file], sets=["EXX.unit=mm"])[0].rows == 8
    with pytest.raises(UsageError, match="would be ignored"):
        prepared([file], sets=[said])


def test_the_end_of_summer_time_in_a_row_per_value_is_asked_about(tmp_path: Path) -> None:
    """Values of the second hour fell on those of the first: 36 of 126 readings were lost, the others mixed."""
    lines = ["Tag;Zeitstempel;Wert"]
    for k, (_, _, x, d) in enumerate(ROWS):
        minute = 140 + k  # from 2:20 in summer time
        clock = f"25.10.2026 {(minute if minute < 180 else minute - 60) // 60:02d}:{minute % 60:02d}:00"
        lines += [f"X.Soll;{clock};{x:.3f}", f"X.Ist;{clock};{x + d / 1000:.4f}"]
    with pytest.raises(DataError, match="the end of summer time"):
        prepared([written(tmp_path / "historian.csv", lines)])
