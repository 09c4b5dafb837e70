"""A machine measured component by component, as a user runs it: from a laser's file to the controller's."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from errpipe.cli.app import main
from errpipe.tables import ect
from errpipe.tables.reference import Evaluator

ROOT = Path(__file__).parents[2]
MACHINE = """machine: 1
name: three-axes
chain: [workpiece, "X'", bed, Y, Z, spindle, tool]
axes:
  X: {kind: linear, travel: [0, 500]}
  Y: {kind: linear, travel: [0, 400]}
  Z: {kind: linear, travel: [-300, 0]}
"""
PIPELINE = """pipeline: 1
title: A machine 10 um too long at +X, read by a laser
stages:
  - {kind: ingest, recording: x.rtl}
  - {kind: identify_direct, machine: machine.yaml, modes: 8}
  - {kind: validate}
  - {kind: export_volumetric, name: volumetric, targets: [linuxcnc_screw, sinumerik_lec]}
  - {kind: export, targets: [linuxcnc_screw, smoothie_pitch]}
  - {kind: report}
"""


def laser_file(runs: int = 6, gap: float = 4.0) -> str:
    """Five cycles would be usual; `runs` go up and down in turn. +10 um at X 500, and `gap` more when going down."""
    rng = np.random.default_rng(3)
    x = np.linspace(0, 500, 11)
    lines = ["HEADER::", "File type  : rtl", "", "TARGET DATA::", "Target-count: 11", "Targets :"]
    lines += [" ".join(f"{v:.6f}" for v in x), "", "USER-TEXT::", "Machine: three-axes", "Axis:X", "", "DEVIATIONS::"]
    for run in range(runs):
        order = range(11) if run % 2 == 0 else range(10, -1, -1)
        side = gap / 2 if run % 2 else -gap / 2
        lines += [f"{run + 1} {i + 1} {10.0 * x[i] / 500.0 + side + rng.normal(0, 0.05):.3f}" for i in order]
    return "\n".join([*lines, "", "EOF::", ""])


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("direct")
    for name, text in (("machine.yaml", MACHINE), ("p.yaml", PIPELINE), ("x.rtl", laser_file())):
        (folder / name).write_text(text)
    assert main(["run", str(folder / "p.yaml"), "--out", str(folder / "out")]) == 0
    return folder / "out"


def rows(path: Path) -> np.ndarray:
    return np.array([[float(v) for v in line.split()] for line in path.read_text().splitlines() if line.strip()])


@pytest.mark.parametrize("stage", ["volumetric", "export"])
def test_the_controller_commands_10_um_less(out, stage):
    """LinuxCNC reads nominal, forward and reverse corrections: 10 um less at the far end, 4 um between the ways."""
    table_rows = rows(out / stage / "linuxcnc_screw" / "x.comp")
    assert table_rows[-1, 1] - table_rows[0, 1] == pytest.approx(-0.010, abs=2e-4)
    assert table_rows[-1, 2] - table_rows[0, 2] == pytest.approx(-0.010, abs=2e-4)
    assert_gap = table_rows[:, 1] - table_rows[:, 2]  # going up the machine is 4 um short of where it is going down
    np.testing.assert_allclose(assert_gap, 0.004, atol=2e-4)
    assert main(["verify", str(out / stage)]) == 0


def test_the_volumetric_table_moves_the_tool_back(out):
    evaluator = Evaluator(ect.read(out / "volumetric" / "table.ect"))
    for x in (0.0, 250.0, 500.0):
        cycle = evaluator.cycle({"X": x})
    assert cycle.deviation["E_X"] == pytest.approx(10.0 - 2.0, abs=0.15)  # came from below
    cycle = evaluator.cycle({"X": 400.0})
    assert cycle.deviation["E_X"] == pytest.approx(8.0 + 2.0, abs=0.15)  # came from above


def test_an_assumed_sign_is_marked_on_every_path(out, tmp_path, capsys):
    """Both tables, the files that hold comments, checklists, models, pages and `compare`."""
    stated = shutil.copytree(out / "ingest", tmp_path / "x")
    manifest = (stated / "recording.yaml").read_text()
    (stated / "recording.yaml").write_text(manifest + "constants:\n  sign: {value: assumed}\n")
    (tmp_path / "machine.yaml").write_text(MACHINE)
    (tmp_path / "p.yaml").write_text(PIPELINE.replace("x.rtl", "x"))
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 0
    for stage, target in (("volumetric", "sinumerik_lec"), ("export", "linuxcnc_screw")):
        assert ect.read(tmp_path / "out" / stage / "table.ect").title.startswith("Sign assumed: ")
        assert not ect.read(out / stage / "table.ect").title.startswith("Sign assumed: ")
        assert "**The sign of the readings" in (tmp_path / "out" / stage / target / "CHECKLIST.md").read_text()
        assert main(["verify", str(tmp_path / "out" / stage)]) == 0
        capsys.readouterr()
        assert main(["compare", *(str(side / stage / "table.ect") for side in (out, tmp_path / "out"))]) == 0
        assert "the new one: The sign of the readings was assumed" in capsys.readouterr().out
    files = [*(tmp_path / "out" / "volumetric" / "sinumerik_lec").glob("*.[A-Z]*")]
    assert any("errpipe remark: The sign of the readings" in f.read_text() for f in files)
    for page in ("identify_direct/identification.html", "report/report.html"):
        assert "The sign of the readings was assumed" in (tmp_path / "out" / page).read_text()
        assert "The sign of the readings was assumed" not in (out / page).read_text()


def test_rows_that_sat_out_are_left_with_the_noise(out):
    document = json.loads((out / "validate" / "validation.json").read_text())
    (exx,) = document["components"]
    assert document["scheme"] == "leave-one-run-out"
    assert exx["component"] == "EXX" and exx["rms_after"] < 0.07 and exx["rms_before"] > 5.0
    assert "EXX" in (out / "report" / "report.html").read_text()


def test_the_error_model_and_the_table_predict_the_same(out, tmp_path):
    recording = str(out / "ingest")
    for name in ("table.ect", "error_model.json"):
        assert main(["predict", str(out / "export" / name), recording, "--out", str(tmp_path / f"{name}.csv")]) == 0
    one, two = ((tmp_path / n).read_text().splitlines() for n in ("table.ect.csv", "error_model.json.csv"))
    assert len(one) == len(two) == 67
    a, b = (np.array([float(line.split(",")[1]) for line in lines[1:]]) for lines in (one, two))
    np.testing.assert_allclose(a, b, atol=0.02)


def test_what_was_not_measured_is_reported(out):
    document = json.loads((out / "identify_direct" / "identification.json").read_text())
    assert {c for u in document["unseen"] for c in u["components"]} >= {"EYY", "EBX", "C0Y"}
    assert document["reversal"]["EXX"]["value"] == pytest.approx(-4.0, abs=0.1)
    assert len(document["would_show"]) > 3


def test_a_ball_bar_is_not_a_record_of_components(tmp_path, capsys):
    (tmp_path / "machine.yaml").write_text(MACHINE)
    (tmp_path / "p.yaml").write_text(
        "pipeline: 1\nstages:\n  - {kind: simulate_test, machine: machine.yaml, protocol: ballbar_circle}\n"
        "  - {kind: ingest}\n  - {kind: identify_direct, machine: machine.yaml}\n"
    )
    assert main(["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]) == 3
    assert "holds no error motion such as EXX or EBX" in capsys.readouterr().err


@pytest.mark.slow
def test_all_components_of_a_simulated_machine(tmp_path, monkeypatch):
    """Beams beside their points, dead paths, cosines, squares that are not square: what is truly left is noise."""
    monkeypatch.chdir(ROOT)
    out = tmp_path / "out"
    assert main(["run", "pipelines/vertical-centre-direct.yaml", "--out", str(out)]) == 0
    document = json.loads((out / "identify_direct" / "identification.json").read_text())
    truth = document["simulated_truth"]
    assert (
        truth["before_rms_um"] > 20 and truth["after_rms_um"] < 1.2 * document["volumetric"]["standard_error_um"] < 0.6
    )
    assert document["unseen"] == []
    page = (out / "identify_direct" / "identification.html").read_text()
    assert "before: " in page and "after: " in page and "what compensation by the identified" in page
    for component in json.loads((out / "validate" / "validation.json").read_text())["components"]:
        assert component["rms_after"] < 0.5, component["component"]
    for stage in ("export", "export_volumetric"):
        assert main(["verify", str(out / stage)]) == 0


@pytest.mark.slow
def test_lasers_and_a_ball_bar_are_solved_as_one_machine(tmp_path, monkeypatch):
    """What the lasers leave open, the squareness, the circles show; and the circles are drawn with their reading."""
    monkeypatch.chdir(ROOT)
    out = tmp_path / "out"
    assert main(["run", "pipelines/vertical-centre-ballbar.yaml", "--out", str(out)]) == 0
    document = json.loads((out / "identify" / "identification.json").read_text())
    assert document["unseen"] == [] and document["simulated_truth"]["after_rms_um"] < 0.6
    page = (out / "identify" / "identification.html").read_text()
    for output in ("Circular test XY", "G both ways", "servo mismatch XY", "Read off the plot"):
        assert output in page
    assert main(["verify", str(out / "export_volumetric")]) == 0
