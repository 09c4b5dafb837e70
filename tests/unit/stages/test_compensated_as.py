"""Deviations measured with a controller's files on, which lose part of their table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from errpipe import tables
from errpipe.cli.app import main
from errpipe.domain import driver as d
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.lowered import Lowered
from errpipe.errors import DataError
from errpipe.formats import manifest_folder
from errpipe.stages._uncompensated import uncompensated
from errpipe.stages.targets import write_targets
from errpipe.tables import ect
from tests.unit.tables.made import position, sensor

PLACES = np.arange(0.0, 1001.0, 100.0)
LOST = 6.0  # um: how much further the axis stands when it comes from above
MANIFEST = """recording: 1
tables: [recording.csv]
columns:
  run: {role: run}
  x: {role: command, axis: X, unit: mm}
  dir: {role: direction, axis: X}
  actual: {role: position, axis: X, unit: mm}
  EXX: {role: error, component: EXX, unit: um, derived: {minus: [actual, x]}}
"""


def machine(x: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Deviation, um: 20 um too long at +X = 1000, and lost motion."""
    return 20.0 * x / 1000.0 - LOST / 2 * side


def table_of_the_machine():
    pairs = (
        Lowered(d.ONE, "X", lambda x: 20.0 * x / 1000.0),
        Lowered(d.Affine(weights=(-LOST / 2,), of=(d.Direction(axis="X", threshold=0.001),))),
    )
    source = tables.ComponentSource("EXX", "um", pairs, True)
    return tables.compile_table([source], inputs=[position()], travel={"X": (0.0, 1000.0)})


def measured(where: Path, active, options: str) -> tuple[int, manifest_folder.Recording | None]:
    """Exit code, and the recording after ingest, of the machine while `active` (um) is taken away."""
    x, side = np.r_[PLACES, PLACES[-2::-1]], np.repeat([1.0, -1.0], [PLACES.size, PLACES.size - 1])
    actual = x + 1e-3 * (machine(x, side) - active(x, side))
    (where / "recording").mkdir()
    rows = pd.DataFrame({"run": 1, "x": x, "dir": side.astype(int), "actual": actual})
    rows.to_csv(where / "recording" / "recording.csv", index=False)
    (where / "recording" / "recording.yaml").write_text(MANIFEST, encoding="utf-8")
    ect.write(table_of_the_machine(), where / "table.ect")
    stage = f"{{kind: ingest, recording: recording{options}}}"
    (where / "p.yaml").write_text(f"pipeline: 1\ntitle: on\nstages:\n  - {stage}\n", encoding="utf-8")
    code = main(["run", str(where / "p.yaml"), "--out", str(where / "out")])
    return code, None if code else manifest_folder.read(where / "out" / "ingest")


ACTIVE = {
    "grblhal_backlash": lambda x, side: -LOST / 2 * side,  # lost motion alone
    "ecmc_lut": machine,  # the same
    "sinumerik_lec": machine,  # the mean, and the backlash value of its checklist
    "linuxcnc_screw": machine,
    "c_runtime": machine,
}


@pytest.mark.parametrize("target", ACTIVE)
def test_what_the_files_took_away_is_added(tmp_path: Path, target: str) -> None:
    text = f", compensated_by: table.ect, compensated_as: [{target}]"
    code, recording = measured(tmp_path, ACTIVE[target], text)
    assert code == 0
    x, side = recording.array("x"), recording.array("dir")
    added = recording.array("EXX") - machine(x, side)
    assert np.ptp(added) < 0.4  # um: but for a constant and the rounding of the file
    difference = 1e3 * (recording.array("actual") - x)
    assert recording.array("EXX") == pytest.approx(difference, abs=1e-6), "actual positions with the compensation on"


def test_the_whole_table_is_not_what_a_file_of_lost_motion_took_away(tmp_path: Path) -> None:
    """A file of the mean of both directions was on, its backlash value not entered: lost motion would count twice."""
    _, recording = measured(tmp_path, lambda x, side: 20.0 * x / 1000.0, ", compensated_by: table.ect")
    added = recording.array("EXX") - machine(recording.array("x"), recording.array("dir"))
    assert np.ptp(added) == pytest.approx(LOST, abs=0.1)


ALONE = {
    "sinumerik_lec": lambda x, side: 20.0 * x / 1000.0,  # the mean
    "grblhal_backlash": ACTIVE["grblhal_backlash"],  # its file holds the number
}


@pytest.mark.parametrize("target", ALONE)
def test_numbers_that_were_not_entered_took_nothing_away(tmp_path: Path, target: str) -> None:
    text = f", compensated_by: table.ect, compensated_as: [{target}], compensated_entered: false"
    code, recording = measured(tmp_path, ALONE[target], text)
    assert code == 0
    assert np.ptp(recording.array("EXX") - machine(recording.array("x"), recording.array("dir"))) < 0.4  # um


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (", compensated_by: table.ect, compensated_as: [linuxcnc_screw, ecmc_lut]", "linuxcnc_screw and ecmc_lut"),
        (", compensated_by: table.ect, compensated_entered: false", "needs compensated_as"),
    ],
)
def test_what_no_controller_does_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: str, said: str
) -> None:
    code, _ = measured(tmp_path, machine, options)
    assert code == 2
    assert said in capsys.readouterr().err


def test_a_format_named_twice_counts_once(tmp_path: Path) -> None:
    text = ", compensated_by: table.ect, compensated_as: [linuxcnc_screw, linuxcnc_screw]"
    _, recording = measured(tmp_path, machine, text)
    assert np.ptp(recording.array("EXX") - machine(recording.array("x"), recording.array("dir"))) < 0.4  # um


def test_a_format_without_its_table_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _ = measured(tmp_path, machine, ", compensated_as: [linuxcnc_screw]")
    assert code == 2
    assert "compensated_as needs compensated_by" in capsys.readouterr().err


def test_the_checklist_states_how_such_a_measurement_is_declared(tmp_path: Path) -> None:
    write_targets(table_of_the_machine(), ["grblhal_backlash", "c_runtime", "sinumerik_lec"], tmp_path)
    pages = {
        name: (tmp_path / name / "CHECKLIST.md").read_text()
        for name in ("grblhal_backlash", "c_runtime", "sinumerik_lec")
    }
    assert "compensated_entered: false" in pages["sinumerik_lec"]
    assert "compensated_entered: false" not in pages["grblhal_backlash"], "its number stands in the file"
    assert "compensated_by: table.ect, compensated_as: [grblhal_backlash]" in pages["grblhal_backlash"]
    assert "compensated_by: table.ect}" in pages["c_runtime"]


@pytest.mark.parametrize("target", ["sinumerik_temperature", "beckhoff_temperature"])
def test_files_of_a_line_per_kelvin_alone_act_at_the_position_of_each_row(tmp_path: Path, target: str) -> None:
    """10 um/m per kelvin: no curve of these files names the axis, and its position was taken as the line's zero."""
    x, warm = np.r_[PLACES, PLACES[-2::-1]], np.linspace(0.0, 8.0, 2 * PLACES.size - 1)
    driver = d.Affine(weights=(1.0,), offset=-20.0, of=(d.Input(name="nut"),))
    source = tables.ComponentSource("EXX", "um", (Lowered(driver, "X", lambda x: 0.01 * x),), True)
    ect.write(
        tables.compile_table([source], inputs=[position(), sensor("nut")], travel={"X": (0.0, 1000.0)}),
        tmp_path / "table.ect",
    )
    columns = {
        "run": Column(role="run"),
        "x": Column(role="command", axis="X", unit="mm"),
        "nut": Column(role="temperature", unit="degC"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    frame = pd.DataFrame({"run": "1", "x": x, "nut": 20.0 + warm, "EXX": np.zeros(x.size)})
    recording = Recording(Manifest(recording=1, tables=("recording.csv",), columns=columns), frame)
    machine_itself, _ = uncompensated(recording, tmp_path / "table.ect", [target], None)
    assert machine_itself.array("EXX") == pytest.approx(0.01 * x * warm, abs=0.1)


def test_export_folders_are_compared_and_what_lies_next_to_their_files_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two folders were `nothing to compare`, and a copied screw file of another axis went unseen."""
    ect.write(table_of_the_machine(), tmp_path / "table.ect")
    for name in ("old", "new"):
        assert (
            main(["export", str(tmp_path / "table.ect"), "--target", "linuxcnc_screw", "--out", str(tmp_path / name)])
            == 0
        )
    file = tmp_path / "new" / "linuxcnc_screw" / "x.comp"
    (file.parent / "y.comp").write_bytes(file.read_bytes())
    capsys.readouterr()
    assert main(["verify", str(tmp_path / "new")]) == 0
    assert "linuxcnc_screw/y.comp: NOT of this export" in capsys.readouterr().out
    assert main(["verify", str(tmp_path / "old")]) == 0
    assert "NOT of this export" not in capsys.readouterr().out
    file.write_text(file.read_text() + "\n")
    assert main(["compare", str(tmp_path / "old"), str(tmp_path / "new")]) == 0
    said = capsys.readouterr().out
    assert "EXX: the same" in said and "file changed: linuxcnc_screw/x.comp" in said and "y.comp" in said
    assert main(["whatis", str(tmp_path / "new")]) == 3
    assert "an export folder" in capsys.readouterr().err


def test_a_straightness_that_the_controller_synthesises_is_refused(tmp_path: Path) -> None:
    """Nothing was added for it, as if the controller had not corrected it: the next table held the remainder alone."""
    source = tables.ComponentSource("EYX", "um", (Lowered(d.ONE, "X", lambda x: 20.0 * np.sin(x / 300.0)),), True)
    ect.write(tables.compile_table([source], inputs=[position()], travel={"X": (0.0, 1000.0)}), tmp_path / "table.ect")
    columns = {
        "run": Column(role="run"),
        "x": Column(role="command", axis="X", unit="mm"),
        "EYX": Column(role="error", component="EYX", unit="um"),
    }
    frame = pd.DataFrame({"run": "1", "x": PLACES, "EYX": np.zeros(PLACES.size)})
    recording = Recording(Manifest(recording=1, tables=("recording.csv",), columns=columns), frame)
    with pytest.raises(DataError, match="EYX is corrected by the controller's own kinematics"):
        uncompensated(recording, tmp_path / "table.ect", ["beckhoff_volumetric"], None)
    whole, _ = uncompensated(recording, tmp_path / "table.ect", [], None)
    assert whole.array("EYX") == pytest.approx(20.0 * np.sin(PLACES / 300.0), abs=0.1)
