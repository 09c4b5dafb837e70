"""`errpipe check` asks a recording which test of a machine it is, before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from errpipe.domain.protocols import PROTOCOLS
from errpipe.kinematics.protocols import READERS
from errpipe.pipeline.spec import load_pipeline
from errpipe.stages import STAGES
from errpipe.verbs import check

MANIFEST = """\
recording: 1
tables: [t.csv]
{constants}columns:
  run: {{role: run}}
  x: {{role: position, axis: X, unit: mm}}
  e: {{role: error, component: {component}, unit: um}}
"""
PIPELINE = """\
pipeline: 1
title: a machine
stages:
  - {kind: ingest, recording: .}
  - {kind: identify, machine: machine.yaml}
"""
MACHINE = """\
machine: 1
name: one axis
chain: [workpiece, bed, X, spindle, tool]
axes:
  X: {kind: linear, travel: [0, 100]}
"""


def problems(folder: Path, component: str, protocol: str | None) -> list[str]:
    constants = "" if protocol is None else f"constants: {{protocol: {{value: {protocol}}}}}\n"
    (folder / "recording.yaml").write_text(MANIFEST.format(constants=constants, component=component))
    (folder / "t.csv").write_text("run,x,e\n1,0,0\n1,50,1\n")
    (folder / "machine.yaml").write_text(MACHINE)
    (folder / "p.yaml").write_text(PIPELINE)
    return [str(problem) for problem in check.problems(load_pipeline(folder / "p.yaml", STAGES))]


def test_every_protocol_has_a_reader():
    assert list(READERS) == list(PROTOCOLS)


@pytest.mark.parametrize(
    "component, protocol, said",
    [
        ("E_X", None, "does not state which test it is"),
        ("E_X", "point_clouds", "Did you mean point_cloud?"),
        ("E_X", "ballbar_circle", "needs an error column of component E_R (the recording has: E_X)"),
    ],
)
def test_a_recording_that_cannot_be_read_as_its_test_is_refused_with_its_line(tmp_path, component, protocol, said):
    (problem,) = problems(tmp_path, component, protocol)
    assert said in problem
    assert "p.yaml:5:5" in problem


@pytest.mark.parametrize("component, protocol", [("E_X", "point_cloud"), ("E_R", "laser"), ("EXX", None)])
def test_what_can_be_read_is_not_refused(tmp_path, component, protocol):
    assert problems(tmp_path, component, protocol) == []
