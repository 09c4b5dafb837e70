"""A machine of rotary axes only: its errors are identified; a volumetric table could move nothing and is refused."""

from __future__ import annotations

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from errpipe import jsonfile
from errpipe.cli._verbs import app

MACHINE = """machine: 1
name: index
chain: [workpiece, "C'", bed, tool]
axes: {C: {kind: rotary, travel: [0, 360]}}
spindle: {position: [0, 0, 200]}
tool: {length: 100}
"""
RECORDING = """recording: 1
tables: [balls.csv]
constants:
  protocol: {value: r_test}
  tool_offset_X@1: {value: 80, unit: mm}
  tool_offset_Y@2: {value: 60, unit: mm}
columns:
  run: {role: run}
  c: {role: position, axis: C, unit: deg}
  ex: {role: error, component: E_X, unit: um}
  ey: {role: error, component: E_Y, unit: um}
  ez: {role: error, component: E_Z, unit: um}
"""
PIPELINE = """pipeline: 1
title: index table under a probe
stages:
  - {kind: ingest, recording: balls}
  - {kind: identify, machine: machine.yaml}
  - {kind: validate}
  - {kind: export_volumetric, ungated: %s}
"""


@pytest.mark.parametrize("ungated", ["false", "true"])
def test_errors_of_an_index_table_are_identified_and_no_table_is_exported(tmp_path, ungated) -> None:
    (tmp_path / "machine.yaml").write_text(MACHINE)
    (tmp_path / "balls").mkdir()
    (tmp_path / "balls/recording.yaml").write_text(RECORDING)
    c = np.radians(np.arange(0, 360, 10))
    rows = [(run, np.degrees(a), 9 * np.sin(a), 9 * np.cos(2 * a), 3 * np.sin(a)) for run in (1, 2) for a in c]
    np.savetxt(tmp_path / "balls/balls.csv", rows, fmt="%.4g", delimiter=",", header="run,c,ex,ey,ez", comments="")
    (tmp_path / "p.yaml").write_text(PIPELINE % ungated)
    done = CliRunner().invoke(app, ["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")])
    assert "no linear axis with a fixed direction" in str(done.exception), done.output
    volumetric = jsonfile.read(tmp_path / "out/identify/identification.json")["volumetric"]
    assert volumetric["axes"] == {} and volumetric["rms_um"] > 0.0
    assert volumetric["left_rms_um"] == volumetric["before_rms_um"] > volumetric["rms_um"] / 2
    assert volumetric["effect_rms_um"] == 0.0
    assert not list((tmp_path / "out").glob("export_volumetric/*.ect"))


def test_a_table_of_a_rotary_axis_differs_from_its_model_by_an_angle(tmp_path) -> None:
    (tmp_path / "c").mkdir()
    columns = "  c: {role: position, axis: C, unit: deg}\n  e: {role: error, component: ECC, unit: urad}\n"
    (tmp_path / "c/recording.yaml").write_text(f"recording: 1\ntables: [c.csv]\ncolumns:\n{columns}")
    c = np.tile(np.arange(0.0, 361.0, 10.0), 2)
    rows = np.column_stack([c, 20 * np.sin(np.radians(c))])
    np.savetxt(tmp_path / "c/c.csv", rows, fmt="%.4g", delimiter=",", header="c,e", comments="")
    stages = "  - {kind: ingest, recording: c}\n  - kind: fit\n    components:\n"
    stages += "      - {component: ECC, terms: [{term: measured_points, axis: C}]}\n  - {kind: export, ungated: true}\n"
    (tmp_path / "p.yaml").write_text(f"pipeline: 1\ntitle: index table\nstages:\n{stages}")
    done = CliRunner().invoke(app, ["run", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")])
    (line,) = [line for line in done.output.splitlines() if "largest difference from the model" in line]
    assert re.search(r"largest difference from the model \S+ urad,", line)
