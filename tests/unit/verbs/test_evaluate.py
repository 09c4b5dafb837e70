"""`errpipe eval`: a reading beyond what was measured, or that the table rejects, is reported."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from errpipe.cli.app import main
from errpipe.tables import ect
from tests.unit.stages.test_acts_on import diameter
from tests.unit.targets import machines


@pytest.mark.parametrize(
    ("at", "deviation", "says"),
    [
        ("x=500", 10.0, []),
        ("X=500", 10.0, []),
        ("x=520", 10.0, ["x = 520 lies outside what was measured (0 .. 500)"]),
        ("x=1e6", 0.0, ["x = 1e+06 counts as no reading (allowed: -50 .. 550)"]),
        ("x=nan", 0.0, ["x = nan counts as no reading (allowed: -50 .. 550)"]),
    ],
)
def test_a_reading_outside_is_reported(tmp_path: Path, capsys: Any, at: str, deviation: float, says: list[str]) -> None:
    ect.write(machines.too_long_at_plus_x(), tmp_path / "t.ect")
    assert main(["eval", str(tmp_path / "t.ect"), "--at", at, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)["result"]
    assert result["outside"] == says and result["deviation"]["EXX"] == pytest.approx(deviation, abs=0.01)


def test_what_stands_for_an_input_that_was_not_given_is_reported(tmp_path: Path, capsys: Any) -> None:
    """Without `--at` the deviation of the middle of the axis was printed, and nothing said so."""
    table = machines.too_long_at_plus_x()
    (x,) = (i for i in table.inputs if i.name == "x")
    ect.write(table, tmp_path / "t.ect")
    assert main(["eval", str(tmp_path / "t.ect")]) == 0
    assert f"not given, so at its default: x = {x.default:g}" in capsys.readouterr().out
    assert main(["eval", str(tmp_path / "t.ect"), "--at", "x=1"]) == 0
    assert "not given" not in capsys.readouterr().out


def test_a_table_of_measurements_instead_of_a_recording_is_referred_to_import(tmp_path: Path, capsys: Any) -> None:
    ect.write(machines.too_long_at_plus_x(), tmp_path / "t.ect")
    file = tmp_path / "x.csv"
    file.write_text("X [mm];Dev [um]\n0;0\n500;10\n")
    for words in (["predict", str(tmp_path / "t.ect"), str(file)], ["diagnose", str(file)]):
        assert main([*words, "--out", str(tmp_path / "out.csv")]) in (2, 3)
        assert f"errpipe import {file} --out FOLDER" in capsys.readouterr().err


def test_a_diameter_is_stated_as_one_beside_the_motion_of_the_axis(tmp_path: Path, capsys: Any) -> None:
    """10 um too large at 25 degC, for which X goes 5 um in; the deviation was stated as 5 um."""
    ect.write(diameter(E_D={"axis": "X", "factor": 0.5}), tmp_path / "t.ect")
    assert main(["eval", str(tmp_path / "t.ect"), "--at", "T=25"]) == 0
    assert "E_D: deviation +10.0000 um, correction of X -0.0050000 mm" in capsys.readouterr().out
