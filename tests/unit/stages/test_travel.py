"""How far an axis travels: from the recording or its manifest, never from what a position could be."""

from __future__ import annotations

import json
import re

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
    assert "X stood at one position in the recording, and its travel is not stated" in capsys.readouterr().err
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
def test_the_part_of_a_turn_that_nobody_measured_is_named_everywhere(tmp_path, last, travel, said):
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
    for text in (*texts, "\n".join(consequences)):
        assert [sentence for sentence in (BRIDGED, HELD) if sentence in text] == ([said] if said else [])


def test_a_curve_whose_turn_does_not_close_is_verified_as_it_was_closed(tmp_path):
    """A line over a turn steps by 20 urad at 360 = 0: the table spreads it, `verify` knows, and the export says it."""
    x = np.tile(np.arange(0.0, 361.0, 30.0), 8)
    deviation = 80.0 * np.sin(np.radians(x)) + x / 18.0 + np.random.default_rng(5).normal(0, 0.3, x.size)
    rows = {
        "c": (x, {"role": "position", "axis": "C", "unit": "deg"}),
        "ECC": (deviation, {"role": "error", "component": "ECC", "unit": "urad"}),
    }
    terms = "[{term: offset}, {term: chebyshev, axis: C, degree: 5}]"
    pipeline = TURNING.replace("[{term: measured_points, axis: C}]", terms) % "linuxcnc_screw"
    assert run(tmp_path, pipeline, rows, {}) == 0
    folder = tmp_path / "out" / "export"
    assert main(["verify", str(folder)]) == 0
    (said,) = json.loads((folder / "export.json").read_text())["checks"]
    assert re.search(r"two ends of a turn differ by (19|20)\.\d urad", said)
