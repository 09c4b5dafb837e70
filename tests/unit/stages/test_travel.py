"""How far an axis travels: from the recording or its manifest, never from what a position could be."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from errpipe.cli.app import main
from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.formats import manifest_folder
from errpipe.tables import ect
from errpipe.targets import _sample

ROTARY = ("linuxcnc_hal", "linuxcnc_screw", "iec_st", "c_runtime", "twincat_nc_table", "beckhoff_ssfk", "fanuc_pitch")
TURNING = """
pipeline: 1
stages:
  - {kind: ingest, recording: rows}
  - kind: fit
    components:
      - {component: ECC, terms: [{term: measured_points, axis: C}]}
  - {kind: validate}
  - {kind: export, targets: [%s]}
"""
PIPELINE = """
pipeline: 1
stages:
  - {kind: ingest, recording: rows}
  - kind: fit
    components:
      - {component: EXX, terms: [{term: offset}, {term: backlash, axis: X}]}
  - {kind: validate}
  - {kind: export, targets: [linuxcnc_screw]}
"""


def run(folder, pipeline: str, rows: dict[str, tuple[np.ndarray, dict]], constants: dict[str, dict]) -> int:
    """Exit code of a pipeline on eight runs. rows: values and facts of each column; constants: facts of each axis."""
    columns = {"run": Column(role="run")} | {name: Column(**facts) for name, (_, facts) in rows.items()}
    axes = {name: Constant(role="axis", **facts) for name, facts in constants.items()}
    manifest = Manifest(recording=1, tables=("recording.parquet",), columns=columns, constants=axes)
    frame = pd.DataFrame({name: values for name, (values, _) in rows.items()})
    frame.insert(0, "run", np.repeat(list("12345678"), len(frame) // 8))
    folder.mkdir(exist_ok=True)
    manifest_folder.write(Recording(manifest, frame), folder / "rows")
    (folder / "p.yaml").write_text(pipeline)
    return main(["run", str(folder / "p.yaml"), "--out", str(folder / "out")])


def export(folder, x: np.ndarray, travel: tuple[float, float] | None = None) -> int:
    """Exit code of a run on lost motion of 8 um at positions, each from both sides."""
    side = np.tile([1.0, -1.0], x.size // 2)
    deviation = -4.0 * side + np.random.default_rng(4).normal(0, 0.3, x.size)
    rows = {
        "x": (x, {"role": "position", "axis": "X", "unit": "mm"}),
        "dir": (side, {"role": "direction", "axis": "X"}),
        "EXX": (deviation, {"role": "error", "component": "EXX", "unit": "um"}),
    }
    return run(folder, PIPELINE, rows, {"X": {"kind": "linear", "travel": travel, "unit": "mm"}} if travel else {})


def test_lost_motion_alone_at_one_position_is_refused_without_a_travel(tmp_path, capsys):
    assert export(tmp_path, np.full(160, 450.0)) == 4
    assert "X did not move in the recording, and its travel is not stated" in capsys.readouterr().err
    assert not (tmp_path / "out" / "export" / "table.ect").exists()


@pytest.mark.parametrize("moves", [True, False], ids=["it moves", "it is stated"])
def test_lost_motion_alone_is_exported_over_the_travel(tmp_path, moves):
    x = np.repeat(np.tile(np.linspace(-300, 0, 10), 8), 2) if moves else np.full(160, -120.0)
    assert export(tmp_path, x, None if moves else (-300.0, 0.0)) == 0
    table = ect.read(tmp_path / "out" / "export" / "table.ect")
    assert _sample.span(table, "X") == (-300.0, 0.0)
    rows = np.loadtxt(tmp_path / "out" / "export" / "linuxcnc_screw" / "x.comp")
    np.testing.assert_allclose(rows[:, 0], [-300.0, 0.0])
    np.testing.assert_allclose(rows[:, 1] - rows[:, 2], 0.008, atol=3e-4)


BRIDGED, HELD = "C was not measured from 270 to 360 deg", "C is corrected from 0 to 270 deg and held beyond"


@pytest.mark.parametrize(
    ("last", "travel", "said"),
    [(270.0, (0.0, 360.0), BRIDGED), (270.0, None, HELD), (330.0, (0.0, 360.0), ""), (360.0, None, "")],
)
def test_the_unmeasured_part_of_a_turn_is_reported_everywhere(tmp_path, last, travel, said):
    """Targets every 30 deg: what a last step is short of a turn is no more of a guess than any other step."""
    x = np.tile(np.arange(0.0, last + 1.0, 30.0), 8)
    deviation = 80.0 * np.sin(np.radians(x)) + np.random.default_rng(5).normal(0, 0.3, x.size)
    rows = {
        "c": (x, {"role": "position", "axis": "C", "unit": "deg"}),
        "ECC": (deviation, {"role": "error", "component": "ECC", "unit": "urad"}),
    }
    constants = {"C": {"kind": "rotary", "travel": travel, "unit": "deg"}}
    assert run(tmp_path, TURNING % ", ".join(ROTARY), rows, constants) == 0
    consequences = json.loads((tmp_path / "out" / "export" / "export.json").read_text())["consequences"]
    texts = [path.read_text() for path in (tmp_path / "out" / "export").rglob("CHECKLIST.md")]
    assert len(texts) == len(ROTARY)
    assert all("of a test in workpiece coordinates such as G54, the files act shifted" in text for text in texts)
    for text in (*texts, "\n".join(consequences)):
        assert [sentence for sentence in (BRIDGED, HELD) if sentence in text] == ([said] if said else [])


def turning(folder, x: np.ndarray, deviation: np.ndarray, term: str, turns: int = 1) -> int:
    """Exit code of a run on deviations of a rotary axis that turns on."""
    rows = {
        "c": (x, {"role": "position", "axis": "C", "unit": "deg"}),
        "ECC": (deviation, {"role": "error", "component": "ECC", "unit": "urad"}),
    }
    pipeline = (TURNING % "linuxcnc_hal").replace("{term: measured_points, axis: C}", term)
    return run(folder, pipeline, rows, {"C": {"kind": "rotary", "travel": (0.0, 360.0 * turns), "unit": "deg"}})


def test_turns_that_do_not_repeat_are_refused_and_those_that_do_are_proved(tmp_path, capsys):
    """Two turns of which the second stands 20 urad higher: of a table that repeats its first turn 14 urad were lost."""
    x = np.tile(np.arange(0.0, 711.0, 10.0), 8)
    wave = 30.0 * np.sin(np.radians(x)) + np.random.default_rng(6).normal(0, 0.3, x.size)
    curve, line = "{term: smooth_curve, axis: C}", "{term: harmonics, axis: C, period: 360, orders: [1, 2]}"
    assert turning(tmp_path / "other", x, wave + 20.0 * (x >= 360.0), curve, 2) == 4
    said = capsys.readouterr().err
    assert "measured from 0 to 710 deg and turns on" in said and "harmonics of 360 deg" in said
    assert turning(tmp_path / "same", x, wave, curve, 2) == 0 and turning(tmp_path / "line", x, wave, line, 2) == 0
    (proof,) = json.loads((tmp_path / "same" / "out" / "export" / "export.json").read_text())["proof"]
    assert proof["unguarded_difference_um"] <= proof["bound_um"] < 3.0


def test_what_closing_a_turn_changes_is_in_the_bound(tmp_path):
    """A line over a whole turn: its ends, 8 urad apart, become one place."""
    x = np.tile(np.arange(0.0, 361.0, 30.0), 8)
    deviation = 80.0 * np.sin(np.radians(x)) + 8.0 * x / 360.0 + np.random.default_rng(7).normal(0, 0.1, x.size)
    assert turning(tmp_path, x, deviation, "{term: measured_points, axis: C}") == 0
    (proof,) = json.loads((tmp_path / "out" / "export" / "export.json").read_text())["proof"]
    assert 3.9 < proof["unguarded_difference_um"] <= proof["bound_um"] < 4.2
    assert main(["verify", str(tmp_path / "out" / "export")]) == 0


def test_a_limited_axis_of_almost_a_turn_keeps_the_difference_of_its_ends(tmp_path):
    """A scale error over -179.99 to 179.99 deg, the stated travel: it was closed, 9 urad wrong at either end."""
    x = np.tile(np.linspace(-179.99, 179.99, 13), 8)
    deviation = 0.05 * x + np.random.default_rng(8).normal(0, 0.1, x.size)
    rows = {
        "c": (x, {"role": "position", "axis": "C", "unit": "deg"}),
        "ECC": (deviation, {"role": "error", "component": "ECC", "unit": "urad"}),
    }
    constants = {"C": {"kind": "rotary", "travel": (-179.99, 179.99), "unit": "deg"}}
    assert run(tmp_path, TURNING % "linuxcnc_screw", rows, constants) == 0
    table = ect.read(tmp_path / "out" / "export" / "table.ect")
    assert _sample.span(table, "C") == (-179.99, 179.99)


def with_commands(folder, axis: str, places: np.ndarray, targets: str) -> int:
    """Exit code of a run on actual positions beside commanded ones, the axis up to 12 um (urad) off."""
    unit, component, per_unit = ("deg", f"EC{axis}", 1e6 * np.pi / 180) if axis == "S" else ("mm", "EXX", 1e3)
    x = np.tile(places, 8)
    at = 2 * np.pi * (x - places[0]) / (places[-1] - places[0])
    deviation = 12.0 * np.sin(at + 0.7) + np.random.default_rng(8).normal(0, 0.3, x.size)
    rows = {
        "target": (x, {"role": "command", "axis": axis, "unit": unit}),
        "actual": (x + deviation / per_unit, {"role": "position", "axis": axis, "unit": unit}),
        component: (deviation, {"role": "error", "component": component, "unit": "urad" if axis == "S" else "um"}),
    }
    pipeline = TURNING.replace("component: ECC", f"component: {component}").replace(
        "{term: measured_points, axis: C}",
        f"{{term: harmonics, axis: {axis}, period: 360, orders: [1]}}"
        if axis == "S"
        else "{term: chebyshev, axis: X, degree: 9}",
    )
    return run(folder, pipeline % targets, rows, {})


def test_a_spindle_is_an_axis_in_degrees_that_turns_on(tmp_path, capsys):
    """S was taken for an axis in mm: half an inch apart in a list in inches, and held beyond 360 deg."""
    assert with_commands(tmp_path, "S", np.arange(0.0, 361.0, 15.0), "sinumerik_lec") == 0
    text = (tmp_path / "out" / "export" / "sinumerik_lec" / "AX1_S_EEC.INI").read_text()
    assert "$AA_ENC_COMP_IS_MODULO[0,AX1]=1" in text and "$AA_ENC_COMP_MAX[0,AX1]=360\n" in text
    assert with_commands(tmp_path, "S", np.arange(0.0, 361.0, 15.0), "haas_pitch") == 4
    assert "S: a list in inches holds no rotary axis" in " ".join(capsys.readouterr().err.split())
