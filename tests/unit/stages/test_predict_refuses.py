"""`errpipe predict` refuses a recording whose columns have the right names and are something else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from errpipe.cli.app import main
from errpipe.tables import ect
from tests.unit.targets import machines

MANIFEST = """recording: 1
tables: [x.csv]
constants:
  {axis}: {{role: axis, kind: linear, travel: [0, 500], unit: mm}}
columns:
  run: {{role: run}}
  x: {{role: {role}, axis: {axis}, unit: {unit}}}
"""


def record(folder: Path, axis: str = "X", role: str = "position", unit: str = "mm", per_mm: float = 1.0) -> Path:
    folder.mkdir()
    (folder / "recording.yaml").write_text(MANIFEST.format(axis=axis, role=role, unit=unit), encoding="utf-8")
    rows = [f"1,{per_mm * x}" for x in (0.0, 250.0, 500.0)]
    (folder / "x.csv").write_text("\n".join(["run,x", *rows, ""]), encoding="utf-8")
    return folder


@pytest.fixture
def table(tmp_path: Path) -> Path:
    ect.write(machines.too_long_at_plus_x(), tmp_path / "t.ect")
    return tmp_path / "t.ect"


def test_a_position_of_another_axis_under_the_same_name(tmp_path: Path, table: Path, capsys: Any) -> None:
    code = main(["predict", str(table), str(record(tmp_path / "y", axis="Y")), "--out", str(tmp_path / "p.csv")])
    assert code == 3 and not (tmp_path / "p.csv").exists()
    assert "column x is not what the compensation was made for (axis Y here, axis X there)" in capsys.readouterr().err


def test_another_quantity_under_the_same_name(tmp_path: Path, table: Path, capsys: Any) -> None:
    folder = record(tmp_path / "v", role="velocity", unit="mm/s")
    assert main(["predict", str(table), str(folder), "--out", str(tmp_path / "p.csv")]) == 3
    assert "velocity here, position or command or actual there" in capsys.readouterr().err


def test_other_units_of_the_same_quantity_are_converted(tmp_path: Path, table: Path) -> None:
    metres = record(tmp_path / "m", unit="m", per_mm=1e-3)
    for folder, out in ((record(tmp_path / "mm"), "a.csv"), (metres, "b.csv")):
        assert main(["predict", str(table), str(folder), "--out", str(tmp_path / out)]) == 0
    assert (tmp_path / "a.csv").read_text() == (tmp_path / "b.csv").read_text()


@pytest.mark.parametrize(
    ("name", "output"), [("mm/x.csv", "would replace a file of the recording"), ("p.xlsx", ".csv or .parquet")]
)
def test_a_prediction_replaces_nothing_measured(
    tmp_path: Path, table: Path, capsys: Any, name: str, output: str
) -> None:
    folder = record(tmp_path / "mm")
    before = (folder / "x.csv").read_bytes()
    assert main(["predict", str(table), str(folder), "--out", str(tmp_path / name)]) == 2
    assert output in capsys.readouterr().err and (folder / "x.csv").read_bytes() == before


def test_a_prediction_of_before_is_replaced(tmp_path: Path, table: Path) -> None:
    folder = record(tmp_path / "mm")
    for _ in range(2):
        assert main(["predict", str(table), str(folder), "--out", str(folder / "p.csv")]) == 0
