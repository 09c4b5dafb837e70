"""Files as public recordings hold them: traces of LinuxCNC's halscope, JSON of pandas and databases, dates, names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing import words
from errpipe.importing.readers import halscope
from errpipe.importing.sheet import ReaderOptions
from tests.unit.importing.known_test import holds_the_truth, imported, long_rows, prepared

NAMES = ["run", "direction", "target_X_mm", "deviation_um"]
ROWS: list[list[Any]] = [[r, "+" if s > 0 else "-", float(x), float(d)] for r, x, s, d in long_rows()]
RECORDS = [dict(zip(NAMES, row, strict=True)) for row in ROWS]
COLUMNS = {n: [r[n] for r in RECORDS] for n in NAMES}


@pytest.mark.parametrize("mark", [".", ","])
def test_a_trace_of_halscope(tmp_path: Path, mark: str) -> None:
    """The names of the first line were taken for a header, and its values for columns."""
    x = np.linspace(0, 150, 600)
    pins = ("joint.0.motor-pos-cmd", "joint.0.motor-pos-fb", "joint.0.motor-pos-cmd")
    values = [(a, a - 0.005, a) for a in x]
    lines = [
        " ".join(f"{n} {f'{v:+.14f}'.replace('.', mark)}" for n, v in zip(pins, row, strict=True)) for row in values
    ]
    torn = f"{pins[0]} +5"
    (tmp_path / "halscope.log").write_text("\n".join(["Sampling period is 2000000 nSec ", "", *lines, torn]))
    recording = imported(tmp_path, tmp_path / "halscope.log", axis="X")
    assert recording.array("EXX") == pytest.approx(-5.0, abs=1e-6)
    assert np.diff(recording.time()) == pytest.approx(0.002)


def test_a_sample_of_halscope_that_is_no_number_leaves_the_others_in_their_rows(tmp_path: Path) -> None:
    lines = [f"a {'nan' if i == 3 else f'{i:+.3f}'} b {2 * i:+.3f}" for i in range(6)]
    (tmp_path / "s.log").write_text("\n".join(["Sampling period is 1000000 nSec ", "", *lines]))
    (sheet,) = halscope.read(tmp_path / "s.log", ReaderOptions())
    assert [row[1:] for row in sheet.rows if row[1] is not None] == [[i, 2.0 * i] for i in range(6) if i != 3]
    assert [row[0] for row in sheet.rows] == pytest.approx([1e-3 * i for i in range(6)])
    (tmp_path / "s.log").write_text("\n".join(["Sampling period is 1000000 nSec ", "", *lines[:3], "a +1", lines[4]]))
    with pytest.raises(DataError, match="sample 4 has different names"):
        halscope.read(tmp_path / "s.log", ReaderOptions())


DOCUMENTS: dict[str, Any] = {
    "facts of the set-up beside lists": {"meta": {"axis": "X", "people": ["a", "b"]}, "data": COLUMNS},
    "facts of the set-up beside records": {"meta": {"axis": "X"}, "data": RECORDS},
    "pandas: split": {"columns": NAMES, "index": [*range(len(ROWS))], "data": ROWS},
    "pandas: columns": {n: {str(i): v for i, v in enumerate(c)} for n, c in COLUMNS.items()},
    "pandas: index": {str(i): r for i, r in enumerate(RECORDS)},
    "pandas: table": {"schema": {"fields": [{"name": n, "type": "string"} for n in NAMES]}, "data": RECORDS},
    "a result of InfluxDB": {"results": [{"series": [{"name": "m", "columns": NAMES, "values": ROWS}]}]},
    "rows below their names": [NAMES, *ROWS],
}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_json_of_programs_and_databases(tmp_path: Path, name: str) -> None:
    (tmp_path / "f.json").write_text(json.dumps(DOCUMENTS[name]))
    holds_the_truth(imported(tmp_path, tmp_path / "f.json"))


def test_rows_of_json_without_names_are_columns(tmp_path: Path) -> None:
    """Each row was one cell of text: 28,000 rows took half a minute."""
    rows = [[0.1 * i, 0.5 * i, 0.5 * i + 0.005] for i in range(50)]
    (tmp_path / "f.json").write_text(json.dumps({"data": rows, "dt": 0.1, "units": "mm"}))
    with pytest.raises(DataError, match="column_1"):
        imported(tmp_path, tmp_path / "f.json")


def test_a_date_and_a_clock_joined_by_a_sign_or_in_quotes(tmp_path: Path) -> None:
    for form in ("2021/06/12-12:{:02d}:{:02d}", "2021-06-12_12:{:02d}:{:02d}", "'2021-06-12T12:{:02d}:{:02d}Z'"):
        lines = ["time,Z error [um],T_nut [C]", *(f"{form.format(i // 6, i % 6 * 10)},{i},{20 + i}" for i in range(30))]
        (tmp_path / "f.csv").write_text("\n".join(lines))
        proposal, _ = prepared([tmp_path / "f.csv"], component="E_Z")
        time = proposal.first("time")
        assert time and np.diff(proposal.data[time]) == pytest.approx(10.0), form


def test_the_name_of_a_device_is_no_quantity() -> None:
    assert words.kind_by_name("TARGET_DU:X-PosAct") == "actual"
    assert words.kind_by_name("TARGET_DU:X-PosCmd") == "command"
    assert guessing.axis_in("TARGET_DU:X-PosCmd") == "X"


def test_a_set_point_of_a_temperature_is_no_position(tmp_path: Path) -> None:
    lines = ["time [s],Z error [um],bed_t,bed_target,he_t,he_target"]
    lines += [f"{10 * i},{i},{24 + i / 9:.2f},105.0,{26 + i / 5:.2f},100.0" for i in range(30)]
    (tmp_path / "f.csv").write_text("\n".join(lines))
    recording = imported(tmp_path, tmp_path / "f.csv", component="E_Z")
    assert len(recording.names("temperature")) == 2 and not recording.names("command")


def test_numbered_signals_of_two_quantities_are_no_runs(tmp_path: Path) -> None:
    """It was asked from which side `theta_1` and `tau_1` were approached."""
    lines = ["number,theta_1,theta_2,tau_1,tau_2", *(f"{i},{i / 9},{i / 7},{i % 5},{i % 3}" for i in range(20))]
    (tmp_path / "f.csv").write_text("\n".join(lines))
    with pytest.raises(DataError, match="no column holds a deviation"):
        imported(tmp_path, tmp_path / "f.csv", ReaderOptions())


@pytest.mark.parametrize("unit", ["Âµm", "æm"])
def test_micrometres_in_another_encoding(tmp_path: Path, unit: str) -> None:
    head = f"Run;Direction;Target X [mm];Deviation [{unit}]"
    (tmp_path / "f.csv").write_text("\n".join([head, *(";".join(map(str, row)) for row in ROWS)]), encoding="utf-8")
    holds_the_truth(imported(tmp_path, tmp_path / "f.csv"))
