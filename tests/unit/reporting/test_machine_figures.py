"""Figures of the machine: same bytes for same data, every axis named, what they claim in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from machines import volume_points

from errpipe import yamlfile
from errpipe.domain.machine import Machine
from errpipe.kinematics import synthesis
from errpipe.kinematics.chain import compile_chain
from errpipe.kinematics.errors import MachineErrors
from errpipe.reporting import machine_figures
from errpipe.simulation import metrology

READY = sorted((Path(__file__).parents[3] / "examples" / "machines").glob("*.yaml"))


def ready(name: str):
    return compile_chain(yamlfile.load(next(p for p in READY if p.stem == name), Machine))


def words(svg: str) -> set[str]:
    """All texts of a figure."""
    root = ElementTree.fromstring(svg)
    return {"".join(e.itertext()).strip() for e in root.iter() if e.tag.endswith("text")}


@pytest.mark.parametrize("path", READY, ids=lambda p: p.stem)
def test_a_sketch_names_every_link(path):
    chain = ready(path.stem)
    svg = machine_figures.machine_sketch(chain)
    marks = {n for n in chain.machine.chain if n not in ("workpiece", "bed", "tool")}
    assert marks | {"bed", "tool", "work"} <= words(svg)
    assert svg == machine_figures.machine_sketch(chain)
    assert len(svg) < 40_000


@pytest.fixture(scope="module")
def measured():
    chain = ready("vertical-centre")
    errors = MachineErrors.of(chain, metrology.smooth_machine(chain, 1))
    q = volume_points(chain, [4, 4, 4])
    return chain, errors, q, synthesis.first_order(chain, q, errors.at(q))[:, :3]


def test_vectors_say_before_and_after(measured):
    chain, _, q, deviation = measured
    svg = machine_figures.vectors(chain, q, deviation, deviation / 20)
    largest = np.linalg.norm(deviation, axis=1).max()
    assert any(w.startswith("before:") and f"{largest:.1f} um largest" in w for w in words(svg))
    assert any(w.startswith("after:") and f"{largest / 20:.1f} um largest" in w for w in words(svg))
    assert svg == machine_figures.vectors(chain, q, deviation, deviation / 20)


def test_slices_before_and_after_stand_side_by_side_in_one_scale(measured):
    chain, errors, *_ = measured
    left = replace(errors, tables=tuple(0.1 * t for t in errors.tables), constants=0.1 * errors.constants)
    panels = {n: machine_figures.size_of(chain, e) for n, e in (("before", errors), ("after", left))}
    svg = machine_figures.slices(chain, panels)
    output = words(svg)
    assert {"X mm, at Z -250", "X mm, at Y 250", "Y mm, at X 400", "Y mm", "Z mm"} <= output
    planes = {n: sorted(w for w in output if w.startswith(f"{n}:")) for n in panels}
    assert len(planes["before"]) == len(planes["after"]) == 3
    assert sum(w == "um" for w in output) == 1  # one bar of colours
    assert svg == machine_figures.slices(chain, panels)


def test_a_table_of_two_axes_has_its_plane_before_and_after():
    axes = {"X": {"kind": "linear", "travel": [0, 500]}, "Y": {"kind": "linear", "travel": [0, 400]}}
    links = ["workpiece", "X'", "bed", "Y", "spindle", "tool"]
    chain = compile_chain(Machine.model_validate({"machine": 1, "name": "table", "chain": links, "axes": axes}))
    panels = {"before": lambda q: q[:, 0] / 50, "after": lambda q: 0.1 + 0 * q[:, 0]}
    output = words(machine_figures.slices(chain, panels))
    assert {"X mm", "Y mm", "before: 5.8 um rms, 10.0 largest", "after: 0.10 um rms, 0.10 largest"} <= output


def test_what_is_left_without_a_known_direction_is_drawn_as_balls(measured):
    chain, _, q, deviation = measured
    svg = machine_figures.vectors(chain, q, deviation, np.full(len(q), 2.0))
    assert "after: 2.0 um rms, 2.0 um largest" in words(svg)


def test_components_have_their_iso_names(measured):
    chain, errors, *_ = measured
    band = (np.array([0.0, 800.0]), np.array([-1.0, -1.0]), np.array([1.0, 1.0]))
    assert set(chain.components[:18]) <= words(machine_figures.components(errors, {"EXX": band}))


def test_a_ball_bar_plot_carries_its_reading():
    angle = np.linspace(-np.pi, np.pi, 90)
    svg = machine_figures.ballbar([("ccw", angle, 4 * np.sin(2 * angle))], 150.0, ["C0Y = 20 urad"], "XY")
    assert {"C0Y = 20 urad", "2 um per division, radius 150 mm", "ccw", "XY"} <= words(svg)
